//! `bridge check` on stand-ins for autopilots: which axis is turned, and what it says of one that arms, does not answer, or
//! ends.

use std::path::Path;
use std::process::Command;

use crate::support::flight::{free_tcp, free_udp};
use crate::support::{json, run, spawn};
use whirlstand_test_harness::{Missing, Outcome, python};

/// Runs `bridge check` against a stand-in without a running bench; returns its exit code and its output.
fn check(
    program: &str,
    arguments: &[String],
    launch: &str,
    options: &[String],
) -> Result<(i32, String), Missing> {
    let mut stand_in = Command::new(python()?);
    stand_in.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/autopilots").join(program));
    let dir = tempfile::tempdir().unwrap();
    let report = dir.path().join("report.json").display().to_string();
    stand_in.args(arguments.iter().map(|a| if a == "REPORT" { &report } else { a }));
    let stand_in = spawn(stand_in);
    let check = ["bridge", "check", "controller", "--launch", launch].map(String::from);
    let end = run(check.iter().chain(options));
    stand_in.signal(libc::SIGTERM);
    stand_in.finish();
    assert_eq!(json(&report)["faults"], serde_json::json!([]), "{}", end.stdout);
    Ok((end.code(), end.stdout + &end.stderr))
}

/// Asserts that each line of `expected`, a verdict and words of its subject, is reported.
fn has_verdicts(said: &str, expected: &str) {
    for (verdict, words) in expected.lines().filter_map(|l| l.trim().split_once(' ')) {
        let told = said.lines().any(|l| l.starts_with(verdict) && l.contains(words));
        assert!(told, "{verdict} {words}:\n{said}");
    }
}

fn the_check_says_which_axis_px4_has_turned() -> Outcome {
    let (port, ground) = (free_tcp(), free_udp());
    let arguments =
        [&port.to_string(), "REPORT", "--disarmed", "--telemetry", &ground.to_string(), "--turned", "pitch"];
    let options = [
        format!("--set=bridge.px4.link=tcpin://127.0.0.1:{port}"),
        format!("--telemetry=udpin://127.0.0.1:{ground}"),
    ];
    let (code, said) = check("px4.py", &arguments.map(Into::into), "quadrotor-px4", &options)?;
    assert_eq!(code, 1, "{said}");
    has_verdicts(
        &said,
        "ok PX4 sends outputs
         ok stands level
         ok roll: +17.2 deg (right side down)
         ok roll: -34.4 deg (left side down)
         WRONG pitch: +17.2 deg (nose up)
         WRONG pitch: -34.4 deg (nose down)
         ok yaw: +17.2 deg (nose right)",
    );
    assert_eq!(said.matches("the sign is turned").count(), 2, "{said}");
    Ok(())
}

fn the_check_says_which_axis_ardupilot_has_turned() -> Outcome {
    let (port, ground) = (free_udp(), free_udp());
    let arguments =
        [&port.to_string(), "REPORT", "--disarmed", "--telemetry", &ground.to_string(), "--turned", "roll"];
    // Its sensors have no noise, which is told.
    let options = [
        format!("--set=bridge.ardupilot.link=udpin://127.0.0.1:{port}"),
        format!("--telemetry=udpin://127.0.0.1:{ground}"),
        "--set=bridge.sensors={gyro_noise=0, accel_noise=0}".into(),
    ];
    let (code, said) = check("ardupilot.py", &arguments.map(Into::into), "quadrotor-ardupilot", &options)?;
    assert_eq!(code, 1, "{said}");
    let constant =
        "ArduPilot may take them for failed (PX4 does after 100 equal readings): gyroscope, accelerometer";
    assert_eq!(said.matches(constant).count(), 1, "{said}");
    has_verdicts(
        &said,
        "ok ArduPilot sends outputs
         ok stands level
         WRONG roll: +17.2 deg (right side down)
         WRONG roll: -34.4 deg (left side down)
         ok pitch: +17.2 deg (nose up)
         ok pitch: -34.4 deg (nose down)
         ok yaw: +17.2 deg (nose right)",
    );
    Ok(())
}

/// Options of a check that arms a stand-in, which starts quickly.
const ARMED: &[&str] = &["--set=bridge.rc.grace_s=2.0", "--arm"];

/// Result of `bridge check`, with these options, on the stand-in for Betaflight with those.
fn check_of_betaflight(more: &[&str], of_check: &[&str]) -> Result<(i32, String), Missing> {
    let (ports, msp): ([u16; 4], _) = (std::array::from_fn(|_| free_udp()), free_tcp().to_string());
    let options = ["REPORT", "--msp", &msp].into_iter().chain(more.iter().copied()).map(String::from);
    let arguments: Vec<String> = ports.iter().map(ToString::to_string).chain(options).collect();
    let mut options = vec![
        format!("--set=bridge.betaflight.ports={ports:?}"),
        format!("--telemetry=tcpout://127.0.0.1:{msp}"),
    ];
    options.extend(of_check.iter().map(ToString::to_string));
    let launch = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/betaflight/flight.toml");
    check("betaflight.py", &arguments, launch, &options)
}

fn the_check_arms_betaflight_when_asked_to_and_sees_it_push_back() -> Outcome {
    // Each axis is checked in both directions; an axis that does not answer is no success.
    // The second never answers its first client, as Betaflight sometimes while it starts.
    for (more, exit, push_back, silent) in
        [(&["--yaw", "0.5"][..], 0, 6, 0), (&["--yaw", "0.0", "--deaf"], 1, 4, 2)]
    {
        let (code, said) = check_of_betaflight(more, ARMED)?;
        assert_eq!(code, exit, "{said}");
        has_verdicts(&said, "ok roll: +17.2\nok pitch: -34.4\nok yaw: +17.2");
        assert_eq!(said.matches("they push back").count(), push_back, "{said}");
        assert_eq!(said.matches("not checked yaw, nose").count(), silent, "{said}");
    }
    Ok(())
}

fn a_check_on_a_busy_computer_tilts_again_what_it_did_not_see() -> Outcome {
    // The stand-in stands still in its first tilt, is disarmed for that, and is armed again.
    let (code, said) = check_of_betaflight(&["--yaw", "0.5", "--stopped", "2.5"], ARMED)?;
    assert_eq!(code, 0, "{said}");
    assert_eq!(said.matches("they push back").count(), 6, "{said}");
    Ok(())
}

fn a_check_of_an_autopilot_that_ends_says_so_at_once() -> Outcome {
    let (code, said) = check_of_betaflight(&["--dies", "2.0"], &[])?;
    assert_eq!((code, said.matches("Betaflight sends no outputs any more").count()), (1, 1), "{said}");
    assert!(!said.contains("pitch: "), "nothing is said of the other axes: {said}");
    Ok(())
}

whirlstand_test_harness::listed!(
    the_check_says_which_axis_px4_has_turned,
    the_check_says_which_axis_ardupilot_has_turned,
    the_check_arms_betaflight_when_asked_to_and_sees_it_push_back,
    a_check_on_a_busy_computer_tilts_again_what_it_did_not_see,
    a_check_of_an_autopilot_that_ends_says_so_at_once,
);
