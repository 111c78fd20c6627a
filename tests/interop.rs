//! Programs that are independent of this code and use the transports' public packages, as nodes of a bench.

use std::path::Path;

use crate::support::{FAULTS_ALLOWED, json, run};
use whirlstand_test_harness::{Outcome, python};

/// Flies with the example as controller, which needs only the public package of its transport.
fn fly(transport: &str, mode: &str) -> Outcome {
    let python = python()?;
    let example =
        Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("examples/python/estimate_{transport}.py"));
    let dir = tempfile::tempdir().unwrap();
    let exec = format!("nodes.controller.exec=[{python:?}, {example:?}, \"--control\"]");
    let out = dir.path().to_str().unwrap();
    let end = run(["run", "quadrotor-lqr", "--transport", transport, "--mode", mode, "--out", out]
        .into_iter()
        // The example has a gain of its own, and Python is occasionally late.
        .chain(["--set", &exec, "--set", FAULTS_ALLOWED]))
    .success();
    let summary = json(dir.path().join("summary.json"));
    let run = &summary["runs"][0];
    assert_eq!(run["ended"]["how"], "complete", "{}", end.stderr);
    // 12 s at 200 Hz; with the commands of the example, the vehicle recovered from the gust at 6 s.
    assert_eq!(run["steps"], 2400);
    let roll = &run["outputs"]["roll"];
    assert_eq!(roll["recovered"], true, "{roll}");
    assert!(roll["peak"].as_f64().unwrap() < 0.35, "{roll}");
    // The example reads the estimates live and prints some.
    assert!(end.stderr.contains("step 2300"), "{}", end.stderr);
    Ok(())
}

fn a_python_program_with_the_iceoryx2_package_is_the_controller() -> Outcome {
    fly("iceoryx2", "lockstep")?;
    fly("iceoryx2", "realtime")
}

fn a_python_program_with_the_zenoh_package_is_the_controller() -> Outcome {
    fly("zenoh", "lockstep")?;
    fly("zenoh", "realtime")
}

/// The controller runs out of memory in flight: it is restarted, the flight continues from there, and no message is
/// missing in the log. In lockstep, so that the load of the machine has no effect.
fn a_node_that_runs_out_of_memory_in_flight_is_started_again() -> Outcome {
    let python = python()?;
    let place = Path::new(env!("CARGO_MANIFEST_DIR"));
    let (hungry, example) =
        (place.join("tests/interop/hungry.py"), place.join("examples/python/estimate_zenoh.py"));
    let dir = tempfile::tempdir().unwrap();
    let lives = dir.path().join("lives");
    let exec =
        format!("nodes.controller.exec=[{python:?}, {hungry:?}, {lives:?}, {example:?}, \"--control\"]");
    let out = dir.path().join("out");
    let restart = "nodes.controller.restart=on-failure";
    let end = run([
        "run",
        "quadrotor-lqr",
        "--transport",
        "zenoh",
        "--mode",
        "lockstep",
        "--out",
        out.to_str().unwrap(),
    ]
    .into_iter()
    .chain(["--set", &exec, "--set", restart, "--set", FAULTS_ALLOWED]))
    .success();
    assert!(end.stderr.contains("MemoryError"), "{}", end.stderr);
    let summary = json(out.join("summary.json"));
    let flight = &summary["runs"][0];
    assert_eq!(flight["ended"]["how"], "complete", "{}", end.stderr);
    assert_eq!(flight["ended"]["restarts"]["controller"], 1, "{flight}");
    assert_eq!(flight["steps"], 2400);
    assert_eq!(flight["outputs"]["roll"]["recovered"], true, "{}", end.stderr);
    let info = run(["log", "info", out.join("log.mcap").to_str().unwrap(), "--json"]).success().stdout;
    let info: serde_json::Value = serde_json::from_str(&info).unwrap();
    let topics = info["topics"].as_array().unwrap();
    let count = |name: &str| {
        topics.iter().find(|t| t["name"] == name).unwrap_or_else(|| panic!("{name}: {info}"))["messages"]
            .as_u64()
    };
    assert!(count("/imu") >= Some(2400) && count("/truth") >= Some(2400), "{info}");
    Ok(())
}

whirlstand_test_harness::listed!(
    a_node_that_runs_out_of_memory_in_flight_is_started_again,
    a_python_program_with_the_iceoryx2_package_is_the_controller,
    a_python_program_with_the_zenoh_package_is_the_controller
);
