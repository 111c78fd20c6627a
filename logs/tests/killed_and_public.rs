//! A recorder that is killed, and logs as the public Python packages read them.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Command as Process, ExitCode, Stdio};
use std::time::{Duration, Instant};

use whirlstand_logs::{BenchInfo, Ending, Log, LogWriter, SignalInfo};
use whirlstand_msgs::{Head, Health, Imu, MAX_STATES, Message, Truth};
use whirlstand_test_harness::{Outcome, Test, python, run};

/// Where the process that will be killed writes.
const LOG_OF_THE_CHILD: &str = "WHIRLSTAND_TEST_LOG_OF_THE_CHILD";

fn start(path: &Path) -> LogWriter {
    let info = BenchInfo {
        version: "0.1.0".into(),
        vehicle: "quadrotor".into(),
        seed: 3,
        period_ns: 1_000_000,
        states: vec![SignalInfo::new("roll", "rad")],
        inputs: vec![SignalInfo::new("u_roll", "")],
        ..BenchInfo::default()
    };
    let mut log = LogWriter::create(path, &info).unwrap();
    log.attach("launch.toml", "application/toml", b"name = \"killed\"").unwrap();
    log.attach("vehicle.toml", "application/toml", b"name = \"quadrotor\"").unwrap();
    log
}

fn messages(step: u64) -> (Imu, Truth, Health) {
    let head = Head { seq: step, step, stamp_ns: step * 1_000_000 };
    let imu = Imu { head, roll: step as f64 * 0.5, valid: 3, ..Imu::zeroed() };
    let mut x = [0.0; MAX_STATES];
    x[0] = 0.25;
    let wall = Head { stamp_ns: 1_700_000_000_000_000_000 + step, ..head };
    let mut health = Health { head: wall, ..Health::zeroed() };
    health.set_node_name("plant");
    (imu, Truth { head, x, ..Truth::zeroed() }, health)
}

/// The process that is killed.
fn write_until_killed(path: &Path) {
    let mut log = start(path);
    let channel = log.channel::<Imu>().unwrap();
    let begin = Instant::now();
    let mut out = std::io::stdout().lock();
    for step in 0.. {
        log.write(&channel, &messages(step).0).unwrap();
        if step % 10 == 0 {
            // A bench at 10 kHz.
            std::thread::sleep(Duration::from_millis(1));
            let now = Instant::now();
            log.flush_if_due(now).unwrap();
            writeln!(out, "wrote {step} {}", now.duration_since(begin).as_nanos()).unwrap();
        }
    }
}

/// Lets a process write a log and kills it. Returns the step that it must not have lost.
fn kill_a_recorder(path: &Path) -> u64 {
    let mut child = Process::new(std::env::current_exe().unwrap())
        .env(LOG_OF_THE_CHILD, path)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut told: Vec<(u64, Duration)> = Vec::new();
    let mut killed = false;
    for line in BufReader::new(child.stdout.take().unwrap()).lines() {
        let Ok(line) = line else { break };
        let mut words = line.split(' ');
        // The line at the kill may be cut short: only a whole one counts.
        if let (Some("wrote"), Some(step), Some(ns)) = (words.next(), words.next(), words.next())
            && let (Ok(step), Ok(ns)) = (step.parse(), ns.parse())
        {
            told.push((step, Duration::from_nanos(ns)));
            if !killed && Duration::from_nanos(ns) > Duration::from_millis(1700) {
                child.kill().unwrap();
                killed = true;
            }
        }
    }
    child.wait().unwrap();
    assert!(killed);
    // What was in the pipe when the child died is read too; the last line but one is surely whole.
    let (_, last) = told[told.len() - 2];
    let (due, _) = *told.iter().rev().find(|(_, t)| *t + Duration::from_secs(1) <= last).unwrap();
    due
}

fn a_killed_recorder_loses_less_than_a_second() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    let due = kill_a_recorder(&path);
    let log = Log::open(&path).unwrap();
    assert_eq!(log.launch_text(), Some("name = \"killed\""));
    let read: Vec<Imu> = log.messages().unwrap().map(Result::unwrap).collect();
    assert!(read.len() as u64 > due, "{} of at least {due}", read.len());
    assert!(read.iter().enumerate().all(|(k, m)| *m == messages(k as u64).0));
    let mut stream = log.stream().unwrap();
    while stream.next().unwrap().is_some() {}
    assert_eq!(stream.endings()[0].1, Ending::Truncated);
}

fn the_public_packages_read_a_killed_recorders_log() -> Outcome {
    let python = python()?;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    kill_a_recorder(&path);
    let read = Log::open(&path).unwrap().messages::<Imu>().unwrap().count();
    let found = check_with_python(&python, &path, &["--truncated"]);
    assert_eq!(found["topics"]["/imu"]["count"].as_u64().unwrap(), read as u64);
    assert_eq!(found["metadata"]["seed"], "3");
    assert_eq!(found["attached"]["launch.toml"], 15);
    Ok(())
}

fn the_public_packages_read_a_finished_log() -> Outcome {
    let python = python()?;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    let mut log = start(&path);
    let (imus, truths) = (log.channel::<Imu>().unwrap(), log.channel::<Truth>().unwrap());
    let healths = log.channel::<Health>().unwrap();
    for step in 0..5000 {
        let (imu, truth, health) = messages(step);
        log.write(&truths, &truth).unwrap();
        log.write(&imus, &imu).unwrap();
        if step % 100 == 0 {
            log.write(&healths, &health).unwrap();
        }
        if step % 1000 == 0 {
            log.flush().unwrap();
        }
    }
    log.finish().unwrap();
    let found = check_with_python(&python, &path, &[]);
    let topics = &found["topics"];
    assert_eq!(topics["/imu"]["count"], 5000);
    assert_eq!(topics["/imu"]["last_step"], 4999);
    assert_eq!(topics["/imu"]["sum"], 0.5 * (4999.0 * 5000.0 / 2.0));
    assert_eq!(topics["/truth"]["sum"], 1250.0);
    assert_eq!(topics["/health"]["count"], 50);
    assert_eq!(found["attached"]["vehicle.toml"], 18);
    Ok(())
}

/// What `reference/check_mcap.py` found.
fn check_with_python(python: &Path, path: &Path, options: &[&str]) -> serde_json::Value {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("reference/check_mcap.py");
    assert!(fs::metadata(path).is_ok());
    let output = Process::new(python).arg(script).arg(path).args(options).output().unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {errors}"))
}

/// This program is also the process that its tests kill.
fn main() -> ExitCode {
    if let Some(path) = std::env::var_os(LOG_OF_THE_CHILD) {
        write_until_killed(Path::new(&path));
        return ExitCode::FAILURE;
    }
    run(vec![
        Test::new("a_killed_recorder_loses_less_than_a_second", a_killed_recorder_loses_less_than_a_second),
        Test::new(
            "the_public_packages_read_a_killed_recorders_log",
            the_public_packages_read_a_killed_recorders_log,
        ),
        Test::new("the_public_packages_read_a_finished_log", the_public_packages_read_a_finished_log),
    ])
}
