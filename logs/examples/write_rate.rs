//! How fast a log is written, read and compared, on one core: `cargo run --release -p whirlstand-logs --example write_rate [steps]`.
//!
//! Each step has the recorder's four messages (Truth, Imu, Estimate, Command) with noise in every used value, so
//! that compression has the work that it has on a bench.

use std::time::Instant;

use whirlstand_logs::{BenchInfo, Log, LogWriter};
use whirlstand_msgs::{Command, Estimate, Head, Imu, Message, Truth};

/// Xorshift (Marsaglia 2003): noise that costs next to nothing.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0 as f64 / u64::MAX as f64 - 0.5
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let steps: u64 = std::env::args().nth(1).map_or(Ok(500_000), |n| n.parse())?;
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("log.mcap");
    let mut log = LogWriter::create(&path, &BenchInfo::default())?;
    let truths = log.channel::<Truth>()?;
    let imus = log.channel::<Imu>()?;
    let estimates = log.channel::<Estimate>()?;
    let commands = log.channel::<Command>()?;
    let mut noise = Noise(1);
    let (mut truth, mut imu) = (Truth::zeroed(), Imu::zeroed());
    let (mut estimate, mut command) = (Estimate::zeroed(), Command::zeroed());
    let start = Instant::now();
    for step in 0..steps {
        let head = Head { seq: step, step, stamp_ns: step * 1_000_000 };
        (truth.head, imu.head, estimate.head, command.head) = (head, head, head, head);
        for i in 0..8 {
            truth.x[i] = noise.next();
            estimate.x[i] = noise.next();
            estimate.std[i] = 0.01;
        }
        (imu.roll, imu.pitch) = (noise.next(), noise.next());
        (imu.roll_rate, imu.pitch_rate) = (noise.next(), noise.next());
        estimate.nis = noise.next();
        (command.u[0], command.u[1]) = (noise.next(), noise.next());
        truth.u = command.u;
        log.write(&truths, &truth)?;
        log.write(&imus, &imu)?;
        log.write(&estimates, &estimate)?;
        log.write(&commands, &command)?;
        if step % 64 == 0 {
            log.flush_if_due(Instant::now())?;
        }
    }
    let loop_s = start.elapsed().as_secs_f64();
    let written = log.finish()?;
    let all_s = start.elapsed().as_secs_f64();
    println!(
        "written: {} messages, {:.1} MB, {:.0} messages/s ({:.0} with the final sync to disk), {:.0} steps/s",
        written.messages,
        written.bytes as f64 / 1e6,
        written.messages as f64 / loop_s,
        written.messages as f64 / all_s,
        steps as f64 / loop_s
    );
    let start = Instant::now();
    let read = Log::open(&path)?.messages::<Truth>()?.map_while(Result::ok).count();
    println!(
        "read: {} of {} truths, {:.0} messages/s over all topics",
        read,
        steps,
        4.0 * read as f64 / start.elapsed().as_secs_f64()
    );
    let start = Instant::now();
    let same = whirlstand_logs::diff(&path, &path)?.identical;
    println!(
        "diff: identical {same}, {:.0} messages/s",
        written.messages as f64 / start.elapsed().as_secs_f64()
    );
    Ok(())
}
