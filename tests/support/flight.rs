//! A flight of the quadrotor under a stand-in for an autopilot, which is a further node of the bench.

use std::net::{TcpListener, UdpSocket};
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde_json::Value;
use whirlstand_test_harness::{Missing, python};

use super::{FAULTS_ALLOWED, Finished, Running, json, spawn, whirlstand};

/// Upper bound on the peak of roll from the gust, rad.
const PEAK: f64 = 0.35;

/// A finished flight.
pub struct Flight {
    pub summary: Value,
    pub report: Value,
    pub stderr: String,
}

impl Flight {
    pub fn roll(&self) -> &Value {
        &self.summary["runs"][0]["outputs"]["roll"]
    }

    /// Asserts that the vehicle recovered from the gust, no node was lost, and the stand-in found no error.
    #[track_caller]
    pub fn well(self) -> Self {
        assert_eq!(self.report["faults"], serde_json::json!([]), "{}", self.stderr);
        let run = &self.summary["runs"][0];
        assert_eq!(run["ended"]["how"], "complete", "{}", self.stderr);
        let roll = self.roll();
        assert_eq!(roll["recovered"], true, "{roll}\n{}", self.stderr);
        let peak = roll["peak"].as_f64().unwrap();
        assert!((0.02..PEAK).contains(&peak), "the gust was felt and held: {roll}\n{}", self.stderr);
        self
    }

    /// Number of messages that the bridge refused.
    pub fn rejected(&self) -> u64 {
        self.summary["runs"][0]["timing"]["nodes"]["controller"]["rejected"].as_u64().unwrap_or(0)
    }
}

/// A flight under way.
pub struct Flying {
    bench: Running,
    started: Instant,
    dir: tempfile::TempDir,
    report: PathBuf,
}

impl Flying {
    /// Waits until the bench prints `words`, and shows (`--nocapture`) when it did.
    #[track_caller]
    pub fn wait_for(&mut self, words: &str) {
        self.bench.wait_for_stderr(words);
        eprintln!("{words}: {:.1} s after the bench was started", self.started.elapsed().as_secs_f64());
    }

    /// Waits until the bench prints `words`, which must be before the line with `mark`.
    #[track_caller]
    pub fn wait_for_before(&mut self, words: &str, mark: &str) {
        let line = self.bench.wait_for_stderr_of(&[words, mark]);
        assert!(line.contains(words), "not before {line:?}: {words}");
    }

    /// Waits for the end of a bench that fails.
    #[track_caller]
    pub fn fail(self) -> Finished {
        failed(self.bench)
    }

    /// As [`Flying::fail`], with the report of the stand-in.
    #[track_caller]
    pub fn fail_with_report(self) -> (Finished, Value) {
        let end = failed(self.bench);
        (end, json(&self.report))
    }

    /// Waits for the end.
    #[track_caller]
    pub fn finish(self) -> Flight {
        let Finished { stderr, .. } = self.bench.finish().success();
        let summary = json(self.dir.path().join("out/summary.json"));
        Flight { summary, report: json(&self.report), stderr }
    }
}

#[track_caller]
fn failed(bench: Running) -> Finished {
    let end = bench.finish();
    assert_eq!(end.code(), 1, "{}\n{}", end.stdout, end.stderr);
    end
}

pub fn free_tcp() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

pub fn free_udp() -> u16 {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// Starts a flight of the quadrotor with a stand-in; `options` are settings, `rest` are further arguments.
pub fn take_off(
    bridge: &str,
    program: &str,
    arguments: &[String],
    options: &[String],
    rest: &[&str],
) -> Result<Flying, Missing> {
    let python = python()?;
    let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/autopilots").join(program);
    let dir = tempfile::tempdir().unwrap();
    let report: PathBuf = dir.path().join("report.json");
    let mut exec = vec![python.display().to_string(), program.display().to_string()];
    exec.extend(
        arguments.iter().map(|a| if a == "REPORT" { report.display().to_string() } else { a.clone() }),
    );
    let mut args: Vec<String> = ["run", "quadrotor", "--duration", "10"].map(Into::into).to_vec();
    let mut set = |assignment: String| args.extend(["--set".to_string(), assignment]);
    set(format!("nodes.controller.bridge={bridge}"));
    set(format!("nodes.autopilot.exec={exec:?}"));
    set("nodes.autopilot.ready=start".into());
    set("setpoint=[]".into());
    // Deadlines of a busy test machine are not tested here, nor is a stand-in that restarts on purpose.
    set(if rest.contains(&"lockstep") { "expect={}" } else { FAULTS_ALLOWED }.into());
    options.iter().cloned().for_each(&mut set);
    args.extend(rest.iter().map(ToString::to_string));
    args.extend(["--out".into(), dir.path().join("out").display().to_string()]);
    Ok(Flying { bench: spawn(whirlstand(&args)), started: Instant::now(), dir, report })
}

/// Runs a whole flight.
#[track_caller]
pub fn fly(
    bridge: &str,
    program: &str,
    arguments: &[String],
    options: &[String],
    rest: &[&str],
) -> Result<Flight, Missing> {
    take_off(bridge, program, arguments, options, rest).map(Flying::finish)
}

/// Arguments of the stand-in for Betaflight at these ports, and keys of a launch file that arms it after a short while.
pub fn betaflight(ports: [u16; 4]) -> (Vec<String>, [String; 5]) {
    let mut arguments: Vec<String> = ports.iter().map(ToString::to_string).collect();
    arguments.push("REPORT".into());
    let options = [
        format!("bridge.betaflight.ports={ports:?}"),
        "bridge.rc.arm=true".into(),
        "bridge.rc.grace_s=2.0".into(),
        "bridge.rc.arming_s=0.3".into(),
        "bridge.rc.throttle=0.4".into(),
    ];
    (arguments, options)
}
