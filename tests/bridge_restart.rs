//! The process of a bridge to a vehicle dies in flight, and the launcher starts it again: it is not in charge until the
//! vehicle was disarmed and armed again.

use std::path::Path;
use std::process::Command;

use crate::support::bridged::Bridged;
use crate::support::flight::free_udp;
use crate::support::{bench, json, spawn, whirlstand};
use serde_json::{Value, json as value};
use whirlstand_test_harness::{Outcome, python};

/// Overrides for which the vehicle stays armed under the bridge that came back: a second and a half.
const ARMED_STILL: u32 = 75;

fn a_bridge_that_was_killed_in_flight_comes_back_neutral_until_the_vehicle_is_armed_again() -> Outcome {
    let python = python()?;
    let dir = tempfile::tempdir().unwrap();
    let (port, report) = (free_udp(), dir.path().join("autopilot.json"));
    let bridged = Bridged {
        bridge: "mavlink",
        vehicle: "quadrotor",
        rate_hz: 100,
        duration_s: 1000,
        safety: "arm = \"autopilot\"\nstale_s = 1.0",
        link: format!("udpin://127.0.0.1:{port}"),
        more: "",
    };
    let launch = bridged.write(dir.path()).display().to_string();
    let events = value!([
        {"when": "told", "do": "note"},
        {"when": "neutral", "for": ARMED_STILL, "do": "disarm"},
        {"when": "neutral", "do": "arm"},
        {"when": "moved", "do": "end"},
    ]);
    let mut autopilot = Command::new(python);
    autopilot.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bridge/autopilot.py"));
    autopilot.args(["--rate", "100", "--link", &format!("udpout:127.0.0.1:{port}")]);
    autopilot.args(["--events", &events.to_string(), "--report"]).arg(&report);
    let autopilot = spawn(autopilot);
    let out = dir.path().join("out").display().to_string();
    let restart = ["--set", "nodes.plant.restart=on-failure", "--log-level", "debug"];
    let mut running = spawn(whirlstand(["run", &launch, "--out", &out].iter().chain(&restart)));
    let plant = bench::ready(&mut running, "plant");
    running.wait_for_stderr("the controller is in charge");
    bench::signal(plant, libc::SIGKILL);
    running.wait_for_stderr("restarting it");
    running.wait_for_stderr("the bridge was restarted: arm it again");
    autopilot.signal(libc::SIGUSR1);
    running.wait_for_stderr("the controller is in charge");
    autopilot.finish().success();
    running.signal(libc::SIGINT);
    let end = running.finish();
    let seen = json(&report);
    assert_eq!(seen["faults"], value!([]), "{}", end.stderr);
    // The vehicle was still armed between the note and the disarm, and nothing moved it.
    let history: Vec<&Value> = seen["history"].as_array().unwrap().iter().map(|entry| &entry[1]).collect();
    let at = |what: &str| history.iter().position(|seen| **seen == what).unwrap();
    let moved_in = |part: &[&Value]| part.iter().any(|what| **what == false);
    let (told, disarmed, armed) = (at("note"), at("disarm"), at("arm"));
    assert!(moved_in(&history[..told]), "{history:?}\n{}", end.stderr);
    assert!(!moved_in(&history[told..armed]), "{history:?}\n{}", end.stderr);
    assert!(told < disarmed && moved_in(&history[armed..]), "{history:?}\n{}", end.stderr);
    Ok(())
}

whirlstand_test_harness::listed!(
    a_bridge_that_was_killed_in_flight_comes_back_neutral_until_the_vehicle_is_armed_again
);
