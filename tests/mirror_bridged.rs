//! The mirror with a vehicle behind MAVLink: one bench is the vehicle, pymavlink its autopilot, and a second bench flies it.
//! Real processes, real UDP, and clocks that are not synchronised.

use std::net::UdpSocket;
use std::path::{Path, PathBuf};

use crate::support::bridged::{Bridged, setpoints};
use crate::support::mirrored::{half_of_the_input_is_named, one_at_a_time};
use crate::support::{json, spawn, whirlstand};
use serde_json::Value;
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

/// Time at which the effect begins, s, which is enough to learn the age of the measurements before; and the length
/// of a flight in which nothing is to be found.
const ONSET_S: f64 = 30.0;
const CLEAN_S: u32 = 70;

/// Longest flight in which something is to be found. If a busy machine stops a process after the onset, these data
/// can have no name, and the search begins again with later ones.
const LONGEST_S: u32 = 110;

/// The mirror's findings in a flight that ends after `duration_s`, or as soon as one of them contains `awaited`; and the
/// bench's standard error.
fn flown(
    effect: &str,
    duration_s: u32,
    awaited: Option<&str>,
) -> Result<(Vec<Value>, String), whirlstand_test_harness::Missing> {
    let python = python()?;
    let _alone = one_at_a_time();
    let dir = tempfile::tempdir().unwrap();
    let port = free_port();
    let file = vehicle(dir.path(), &python, port, effect);
    let bridged = Bridged {
        bridge: "mavlink",
        vehicle: "quadrotor",
        rate_hz: 100,
        duration_s,
        safety: "arm = \"autopilot\"",
        link: format!("udpin://127.0.0.1:{port}"),
        more: &format!("[mirror]\n{}", setpoints()),
    };
    let launch = bridged.write(dir.path()).display().to_string();
    let out = dir.path().join("vehicle").display().to_string();
    let vehicle = spawn(whirlstand(["run", file.to_str().unwrap(), "--out", &out]));
    let out = dir.path().join("out").display().to_string();
    let mut bench = spawn(whirlstand(["run", &launch, "--out", &out]));
    if let Some(awaited) = awaited {
        bench.wait_for_stderr(awaited);
        bench.signal(libc::SIGINT);
    }
    let ended = bench.finish();
    vehicle.signal(libc::SIGINT);
    vehicle.finish();
    let summary = json(format!("{out}/summary.json"));
    let run = &summary["runs"][0];
    let how = if awaited.is_some() { "interrupted" } else { "complete" };
    assert_eq!(run["ended"]["how"], how, "{}", ended.stderr);
    println!("{}", run["findings"]);
    Ok((run["findings"].as_array().cloned().unwrap_or_default(), ended.stderr))
}

fn a_vehicle_as_its_file_says_is_blamed_for_nothing() -> Outcome {
    let (findings, said) = flown("", CLEAN_S, None)?;
    let text = |f: &Value| f["text"].as_str().unwrap().to_owned();
    // If a busy machine stops a process for some periods, the link stalls, and the prediction is wrong then.
    let stopped = |f: &Value| text(f).ends_with("looking for the cause") || text(f).contains("right again");
    assert!(findings.len() <= 2 && findings.iter().all(stopped), "{findings:?}\n{said}");
    Ok(())
}

fn half_of_an_input_that_is_lost_in_flight_is_named_with_its_size() -> Outcome {
    let effect = format!(
        "[[effects]]\neffect = \"input_gain\"\nwhere = \"u_roll\"\nfactor = 0.5\nfrom_s = {ONSET_S:?}"
    );
    let cause = "input_gain on u_roll: factor ";
    let (findings, said) = flown(&effect, LONGEST_S, Some(cause))?;
    // The vehicle's clock began before the bench's, and the bench waits until the vehicle is armed.
    half_of_the_input_is_named(&findings, ONSET_S - 10.0, &said);
    Ok(())
}

whirlstand_test_harness::listed!(
    a_vehicle_as_its_file_says_is_blamed_for_nothing,
    half_of_an_input_that_is_lost_in_flight_is_named_with_its_size,
);
