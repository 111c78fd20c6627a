//! What the bus adds to bare iceoryx2: the same ring of three processes, measured in turn.
//!
//! `cargo run --release -p whirlstand-bus --example ring -- [LAPS [ROUNDS]]`
//!
//! Last, the same lap in one thread of one process.

use std::error::Error;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use whirlstand_bus::ring::{POSITIONS, Ring};
use whirlstand_bus::{Bus, BusConfig, Transport, WaitStrategy, remove_residue};
use whirlstand_msgs::{Command as Action, Estimate, Imu, Message};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [position, kind, bench, laps, connect] = arguments.as_slice() {
        return member(position.parse()?, kind, bench, laps.parse()?, connect);
    }
    let laps: u64 = arguments.first().map_or(Ok(200_000), |a| a.parse())?;
    let rounds: usize = arguments.get(1).map_or(Ok(5), |a| a.parse())?.max(1);
    let mut laps_of = [const { Vec::new() }; 3];
    for _ in 0..rounds {
        for (kind, times) in ["bare", "iceoryx2", "zenoh"].into_iter().zip(&mut laps_of) {
            let laps = if kind == "zenoh" { laps / 20 } else { laps };
            let lap = ring(kind, laps)? / u32::try_from(laps)?;
            println!("{kind:>9} {:8.3} us a lap", lap.as_secs_f64() * 1e6);
            times.push(lap);
        }
    }
    println!("   inproc {:8.3} us a lap", one_thread(10 * laps)?.as_secs_f64() * 1e6 / (10 * laps) as f64);
    // The median: where the scheduler puts three processes on few cores differs from run to run.
    let [bare, bus, _] = laps_of.map(|mut times| {
        times.sort_unstable();
        times[times.len() / 2].as_secs_f64()
    });
    println!("bus over iceoryx2 / bare, medians: {:.2}", bus / bare);
    Ok(())
}

/// The three positions in turn, in this thread.
fn one_thread(laps: u64) -> Result<Duration, Box<dyn Error>> {
    let buses: Vec<Bus> = (0..POSITIONS)
        .map(|i| Bus::open(&BusConfig::new("ring", format!("member-{i}"), Transport::Inproc)))
        .collect::<Result<_, _>>()?;
    let (mut imu_out, mut imu_in) = (buses[0].publisher::<Imu>()?, buses[1].subscriber::<Imu>(8)?);
    let (mut estimate_out, mut estimate_in) =
        (buses[1].publisher::<Estimate>()?, buses[2].subscriber::<Estimate>(8)?);
    let (mut command_out, mut command_in) =
        (buses[2].publisher::<Action>()?, buses[0].subscriber::<Action>(8)?);
    let (mut imu, mut estimate, mut command) = (Imu::zeroed(), Estimate::zeroed(), Action::zeroed());
    let start = Instant::now();
    for lap in 0..laps {
        imu.head.step = lap;
        imu_out.send(&imu)?;
        estimate.head.step = imu_in.try_recv()?.ok_or("no Imu")?.head.step;
        estimate_out.send(&estimate)?;
        command.head.step = estimate_in.try_recv()?.ok_or("no Estimate")?.head.step;
        command_out.send(&command)?;
        assert_eq!(command_in.try_recv()?.ok_or("no Command")?.head.step, lap);
    }
    Ok(start.elapsed())
}

/// Runs one ring; position 0 is a child as well, and prints the time.
fn ring(kind: &str, laps: u64) -> Result<Duration, Box<dyn Error>> {
    let bench = format!("ring-{kind}-{}", std::process::id());
    let ports: Vec<String> = (0..POSITIONS)
        .map(|_| Ok(format!("tcp/{}", std::net::TcpListener::bind("127.0.0.1:0")?.local_addr()?)))
        .collect::<std::io::Result<_>>()?;
    let mut members: Vec<Child> = (0..POSITIONS)
        .rev()
        .map(|position| {
            Command::new(std::env::current_exe()?)
                .args([&position.to_string(), kind, &bench, &laps.to_string(), &ports.join(",")])
                .stdout(Stdio::piped())
                .spawn()
        })
        .collect::<std::io::Result<_>>()?;
    let lead = members.pop().ok_or("no lead")?.wait_with_output()?;
    for mut member in members {
        member.wait()?;
    }
    remove_residue(&bench)?;
    let nanoseconds = String::from_utf8(lead.stdout)?.trim().parse()?;
    Ok(Duration::from_nanos(nanoseconds))
}

fn member(position: usize, kind: &str, bench: &str, laps: u64, ports: &str) -> Result<(), Box<dyn Error>> {
    let transport = if kind == "zenoh" { Transport::Zenoh } else { Transport::Iceoryx2 };
    let mut bus = BusConfig::new(bench, format!("member-{position}"), transport);
    let ports: Vec<String> = ports.split(',').map(Into::into).collect();
    bus.zenoh.listen = vec![ports[position].clone()];
    bus.zenoh.connect = ports[..position].to_vec();
    bus.wait = WaitStrategy::lockstep();
    let ring = Ring { bus, bare: kind == "bare", laps };
    if let Some(elapsed) = ring.run(position)? {
        println!("{}", elapsed.as_nanos());
    }
    Ok(())
}
