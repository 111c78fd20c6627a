//! Controllers that are not nodes of a bench fly through a relay: one in C over UDP, one as it would be in ROS 2.

use std::net::{TcpListener, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{FAULTS_ALLOWED, json, refused, run, spawn, whirlstand};
use whirlstand_test_harness::{Missing, Outcome, python_with};

const WHIRLSTAND: &str = env!("CARGO_BIN_EXE_whirlstand");

fn free_port() -> u16 {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// Builds the example as its header comment says, with warnings as errors.
fn c_controller(folder: &Path) -> Result<PathBuf, Missing> {
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/c/controller.c");
    let program = folder.join("controller");
    let strict = ["-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-o"];
    let built = Command::new("cc").args(strict).args([&program, &example]).status();
    let built = built
        .map_err(|_| Missing::installable("no C compiler", "install it, on Debian: apt-get install gcc"))?;
    assert!(built.success(), "the example does not compile");
    Ok(program)
}

/// Arguments of a run whose controller is behind a relay.
fn flight(mode: &str, transport: &str, out: &Path, sets: &[String]) -> Vec<String> {
    let out = out.display().to_string();
    let fixed = ["run", "quadrotor-lqr", "--mode", mode, "--transport", transport, "--out", &out];
    let mut arguments: Vec<String> = fixed.map(String::from).to_vec();
    for set in sets.iter().map(String::as_str).chain([FAULTS_ALLOWED]) {
        arguments.extend(["--set".into(), set.into()]);
    }
    arguments
}

/// Asserts that the run was flown to its end, and that the vehicle recovered from the gust at 6 s.
#[track_caller]
fn flown(out: &Path, stderr: &str) {
    let run = &json(out.join("summary.json"))["runs"][0];
    assert_eq!(run["ended"]["how"], "complete", "{stderr}");
    assert_eq!(run["steps"], 2400);
    let roll = &run["outputs"]["roll"];
    assert_eq!(roll["recovered"], true, "{roll}");
    let peak = roll["peak"].as_f64().unwrap();
    assert!((0.02..0.35).contains(&peak), "the gust was felt and held: {roll}");
}

fn relay_to(port: u16) -> String {
    let (peer, own) = (format!("127.0.0.1:{port}"), format!("127.0.0.1:{}", free_port()));
    format!("nodes.controller.exec=[{WHIRLSTAND:?}, 'relay', 'udp', '--peer', {peer:?}, '--listen', {own:?}]")
}

fn a_c_program_is_the_controller() -> Outcome {
    let dir = tempfile::tempdir().unwrap();
    let (program, out, port) = (c_controller(dir.path())?, dir.path().join("out"), free_port());
    let beside = format!("nodes.own={{exec=[{program:?}, '{port}'], ready='start'}}");
    let end = run(flight("lockstep", "iceoryx2", &out, &[relay_to(port), beside])).success();
    flown(&out, &end.stderr);
    assert!(end.stderr.contains("step 2300"), "{}", end.stderr);
    Ok(())
}

fn a_controller_may_come_after_the_bench() -> Outcome {
    let dir = tempfile::tempdir().unwrap();
    let (program, out, port) = (c_controller(dir.path())?, dir.path().join("out"), free_port());
    let mut bench = spawn(whirlstand(flight("lockstep", "zenoh", &out, &[relay_to(port)])));
    bench.wait_for_stderr("waiting for the first command");
    let mut late = Command::new(program);
    late.arg(port.to_string());
    let controller = spawn(late);
    let end = bench.finish().success();
    flown(&out, &end.stderr);
    drop(controller);
    Ok(())
}

/// Flies under the controller in ROS 2; returns the number of messages that it received of each topic.
fn fly_ros_2(mode: &str, duration: &str, out: &Path) -> Result<(serde_json::Value, String), Missing> {
    let python = python_with("rosbags")?;
    let report = out.with_extension("report.json");
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/ros2/controller.py");
    let relay = format!("{WHIRLSTAND:?}, 'relay', 'ros2', '--domain', '7', '--connect', {endpoint:?}");
    let sets = [
        format!("nodes.controller.exec=[{relay}]"),
        format!("nodes.viewer.exec=[{relay}, '--namespace', '/viewer']"),
        format!(
            "nodes.own={{exec=[{python:?}, {script:?}, '--listen', {endpoint:?}, '--report', {report:?}], ready='start'}}"
        ),
    ];
    let mut arguments = flight(mode, "iceoryx2", out, &sets);
    arguments.extend(["--duration".into(), duration.into()]);
    let end = run(arguments).success();
    let report = json(&report);
    assert_eq!(report["faults"], serde_json::json!([]), "{report}");
    Ok((report["counts"].clone(), end.stderr))
}

fn a_program_of_ros_2_is_the_controller() -> Outcome {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let (counts, stderr) = fly_ros_2("lockstep", "12", &out)?;
    flown(&out, &stderr);
    for topic in ["imu", "odom", "tf", "viewer/imu", "viewer/odom"] {
        // A viewer is not waited for: it may be discovered some steps after the first.
        assert!(counts[topic].as_u64().unwrap_or(0) > 1000, "{topic}: {counts}");
    }
    assert!(stderr.contains("cannot be used"), "nonsense is told: {stderr}");
    Ok(())
}

/// The quality of the flight depends on the load of the machine; that the clock starts and that commands act does not.
fn a_program_of_ros_2_is_the_controller_in_real_time() -> Outcome {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let (counts, stderr) = fly_ros_2("realtime", "3", &out)?;
    let run = &json(out.join("summary.json"))["runs"][0];
    assert_eq!(run["ended"]["how"], "complete", "{stderr}");
    assert_eq!(run["steps"], 600);
    assert!(counts["imu"].as_u64().unwrap_or(0) > 0, "{counts}");
    Ok(())
}

fn what_a_relay_cannot_be_told_is_refused() {
    refused(
        &["relay", "udp", "--peer", "127.0.0.1:1"],
        &["WHIRLSTAND_BENCH is not set", "[nodes.controller]"],
    );
    refused(&["relay", "udp", "--peer", "here"], &["--peer"]);
}

whirlstand_test_harness::listed!(
    a_c_program_is_the_controller,
    a_controller_may_come_after_the_bench,
    a_program_of_ros_2_is_the_controller,
    a_program_of_ros_2_is_the_controller_in_real_time,
    what_a_relay_cannot_be_told_is_refused
);
