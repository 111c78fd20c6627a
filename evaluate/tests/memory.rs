//! The memory that it takes to evaluate a run does not grow with the run.

use std::fs;
use std::path::Path;

use whirlstand_evaluate::Run;
use whirlstand_logs::{BenchInfo, LogWriter};
use whirlstand_msgs::{Command, Disturbance, Estimate, Head, Imu, Message, Setpoint, Truth, flags};
use whirlstand_vehicle::Vehicle;

const PERIOD_NS: u64 = 1_000_000;

/// Writes the log of a run of so many steps: a step of roll every 20 s, a gust every 50 s, turbulence throughout.
fn write_log(path: &Path, steps: u64) {
    let vehicle = Vehicle::builtin("quadrotor").unwrap();
    let info = BenchInfo { vehicle: vehicle.name.clone(), period_ns: PERIOD_NS, ..BenchInfo::default() };
    let mut log = LogWriter::create(path, &info).unwrap();
    log.attach("vehicle.toml", "application/toml", vehicle.to_toml().as_bytes()).unwrap();
    let (imu, truth) = (log.channel::<Imu>().unwrap(), log.channel::<Truth>().unwrap());
    let (estimate, command) = (log.channel::<Estimate>().unwrap(), log.channel::<Command>().unwrap());
    let (setpoint, disturbance) = (log.channel::<Setpoint>().unwrap(), log.channel::<Disturbance>().unwrap());
    let mut roll = 0.0;
    for k in 0..steps {
        let head = Head { seq: k, step: k, stamp_ns: k * PERIOD_NS };
        let wanted = f64::from((k / 20_000) as u32 % 2) * 0.1;
        let gust = if k % 50_000 < 200 { 3.0 } else { 0.0 };
        // Numbers without a pattern.
        let noise = (k.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as f64 / (1u64 << 24) as f64 - 0.5;
        roll += 0.01 * (wanted - roll) + 1e-3 * gust;
        let mut truth_k = Truth { head, states: 4, inputs: 2, ..Truth::zeroed() };
        truth_k.x[0] = roll;
        truth_k.u[0] = noise;
        truth_k.flags = if k % 7 == 0 { flags::HELD } else { 0 };
        log.write(&truth, &truth_k).unwrap();
        let mut disturbance_k = Disturbance { head, count: 4, ..Disturbance::zeroed() };
        disturbance_k.dx[1] = gust + 0.1 * noise;
        log.write(&disturbance, &disturbance_k).unwrap();
        log.write(&imu, &Imu { head, valid: 3, roll: roll + 0.01 * noise, ..Imu::zeroed() }).unwrap();
        let mut estimate_k = Estimate { head, count: 4, dof: 4, nis: 4.0 + noise, ..Estimate::zeroed() };
        estimate_k.x[0] = roll + 0.001 * noise;
        estimate_k.std[..4].fill(1e-3);
        log.write(&estimate, &estimate_k).unwrap();
        let mut setpoint_k = Setpoint { head, tracked: 1, ..Setpoint::zeroed() };
        setpoint_k.x[0] = wanted;
        log.write(&setpoint, &setpoint_k).unwrap();
        log.write(&command, &Command { head, count: 2, ..Command::zeroed() }).unwrap();
    }
    log.finish().unwrap();
}

/// The greatest resident memory of this process since [`forget_peak`], kB.
fn peak_kb() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmHWM:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

/// Lets the kernel count the peak anew (proc(5), `clear_refs`).
fn forget_peak() {
    fs::write("/proc/self/clear_refs", "5").unwrap();
}

#[test]
fn a_run_ten_times_as_long_takes_no_more_memory() {
    let folder = tempfile::tempdir().unwrap();
    let (short, long) = (folder.path().join("short.mcap"), folder.path().join("long.mcap"));
    write_log(&short, 60_000);
    write_log(&long, 600_000);
    let evaluated = |path: &Path| {
        forget_peak();
        let run = Run::open(path, "run", None).unwrap();
        (run, peak_kb())
    };
    let (first, short_kb) = evaluated(&short);
    let (run, long_kb) = evaluated(&long);
    println!("60 s: {short_kb} kB, 600 s: {long_kb} kB");
    // Before, each step was held with 1.2 kB: 650 MB more.
    assert!(long_kb < short_kb + 12_000, "{short_kb} kB, then {long_kb} kB");
    assert_eq!((first.figures.duration_s, run.figures.duration_s), (59.999, 599.999));
    let roll = &run.figures.outputs["roll"];
    assert_eq!((roll.steps.len(), run.figures.timing.held_steps), (29, 600_000 / 7 + 1));
    assert!(run.lines.outputs[0].truth.points().0.len() < 8_200);
}
