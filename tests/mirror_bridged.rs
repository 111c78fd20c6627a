//! The mirror with a vehicle behind MAVLink: one bench is the vehicle, pymavlink its autopilot, and a second bench flies it.
//! Real processes, real UDP, and clocks that are not synchronised.

use std::net::UdpSocket;
use std::path::{Path, PathBuf};

use crate::support::bridged::{Bridged, setpoints};
use crate::support::mirrored::half_of_the_input_is_named;
use crate::support::{json, spawn, whirlstand};
use whirlstand_test_harness::{Outcome, python};

/// A UDP port that no process uses.
fn free_port() -> u16 {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// The bench that is the vehicle, with a hidden effect. Its controller is the autopilot, which speaks only MAVLink.
fn vehicle(dir: &Path, python: &Path, port: u16, effect: &str) -> PathBuf {
    let bridge = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bridge");
    let text = format!(
        r#"
vehicle = "quadrotor"
transport = "zenoh"
rate_hz = 100.0
duration_s = 1000.0
[controller]
law = "lqr"
[nodes.controller]
exec = [{python:?}, {script:?}, "--link", "udpout:127.0.0.1:{port}", "--report", {report:?}]
env = {{ PYTHONPATH = {examples:?} }}
restart = "never"
{effect}
"#,
        script = bridge.join("autopilot.py"),
        report = dir.join("autopilot.json"),
        examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/python"),
    );
    let path = dir.join("vehicle.toml");
    std::fs::write(&path, text).unwrap();
    path
}

/// Time at which the effect begins, s: enough to learn the age of the measurements, and then to find nothing where nothing
/// is to be found.
const ONSET_S: f64 = 50.0;

/// Longest flight. If a busy machine stops a process after the onset, these data can have no name, and the search begins
/// again with later ones.
const LONGEST_S: u32 = 115;

fn a_vehicle_is_blamed_for_nothing_until_it_loses_half_of_an_input_which_is_named_with_its_size() -> Outcome {
    let effect = format!(
        "[[effects]]\neffect = \"input_gain\"\nwhere = \"u_roll\"\nfactor = 0.5\nfrom_s = {ONSET_S:?}"
    );
    let python = python()?;
    let dir = tempfile::tempdir().unwrap();
    let port = free_port();
    let file = vehicle(dir.path(), &python, port, &effect);
    let bridged = Bridged {
        bridge: "mavlink",
        vehicle: "quadrotor",
        rate_hz: 100,
        duration_s: LONGEST_S,
        safety: "arm = \"autopilot\"",
        link: format!("udpin://127.0.0.1:{port}"),
        more: &format!("[mirror]\n{}", setpoints()),
    };
    let launch = bridged.write(dir.path()).display().to_string();
    let out = dir.path().join("vehicle").display().to_string();
    let vehicle = spawn(whirlstand(["run", file.to_str().unwrap(), "--out", &out]));
    let out = dir.path().join("out").display().to_string();
    let mut bench = spawn(whirlstand(["run", &launch, "--out", &out]));
    bench.wait_for_stderr("input_gain on u_roll: factor ");
    bench.signal(libc::SIGINT);
    let said = bench.finish().stderr;
    vehicle.signal(libc::SIGINT);
    vehicle.finish();
    let summary = json(format!("{out}/summary.json"));
    let findings = summary["runs"][0]["findings"].as_array().unwrap();
    println!("{findings:?}");
    // The vehicle's clock began before the bench's, and the bench waits until the vehicle is armed.
    let earliest_s = ONSET_S - 10.0;
    half_of_the_input_is_named(findings, earliest_s, &said);
    // If a busy machine stops a process for some periods, the link stalls, and the prediction is wrong then.
    let stalls = findings.iter().filter(|f| {
        let (at_s, text) = (f["at_s"].as_f64().unwrap(), f["text"].as_str().unwrap());
        at_s < earliest_s && text.ends_with("looking for the cause")
    });
    assert!(stalls.count() <= 2, "{findings:?}\n{said}");
    Ok(())
}

// It compares a vehicle in real time with its simulation, behind two processes and a link.
whirlstand_test_harness::listed_alone!(
    a_vehicle_is_blamed_for_nothing_until_it_loses_half_of_an_input_which_is_named_with_its_size,
);
