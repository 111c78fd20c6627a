//! A board on one serial line, as hardware in the loop: the loop flies over it, and a third-party ground station arms
//! the board and reads its attitude through the bench. The station never writes what the loop owns. All lines carry only
//! what their baud rate allows.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::flight::take_off;
use crate::support::{Running, json, run, spawn};
use whirlstand_test_harness::{Missing, Outcome, python, python_with};

/// Starts a ground station of this kind on a serial line of its own.
fn station(kind: &str, package: &str, line: &Path, baud: u32, report: &Path) -> Result<Running, Missing> {
    let mut station = Command::new(python_with(package)?);
    station.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/autopilots/station.py"));
    station.arg(kind).arg(line).arg(baud.to_string()).arg(report);
    Ok(spawn(station))
}

/// Flies over lines of this baud rate, armed by the station; returns the bench's messages.
fn flies(kind: &str, package: &str, baud: u32, rate_hz: u32) -> Result<String, Missing> {
    let dir = tempfile::tempdir().unwrap();
    let place = |name: &str| -> PathBuf { dir.path().join(name) };
    let (board, ground, seen) = (place("ttyACM0"), place("ttyGS0"), place("station.json"));
    let station = station(kind, package, &ground, baud, &seen)?;
    let (name, rate) = (board.display().to_string(), baud.to_string());
    let arguments =
        ["0", "REPORT", "--free", "--pty", &name, "--baud", &rate, "--station", "2"].map(Into::into);
    let options = [
        format!("bridge.px4.link=serial://{}:{baud}", board.display()),
        format!("bridge.px4.forward=serial://{}:{baud}", ground.display()),
        format!("rate_hz={rate_hz}"),
        "duration_s=8".into(),
    ];
    let flight =
        take_off("px4-hil", "px4.py", &arguments, &options, &["--mode", "realtime", "--log-level", "info"])?;
    let flight = flight.finish();
    station.finish();
    let (seen, said) = (json(&seen), &flight.stderr);
    assert_eq!(flight.report["faults"], serde_json::json!([]), "{said}");
    assert_eq!(seen["faults"], serde_json::json!([]), "{said}");
    assert_eq!(seen["armed"], true, "{seen}\n{said}");
    assert!(seen["attitudes"].as_u64() >= Some(20), "{seen}\n{said}");
    assert_eq!(flight.report["stations"].as_array().unwrap().len(), 1, "{}", flight.report);
    // HEARTBEAT, STATUSTEXT and the events of the arming checks are reported.
    for words in [
        "PX4 is system 1, component 1, and says that it is not armed",
        "PX4 cannot be armed: its arming checks fail, in every mode: GPS, magnetometer",
        "PX4 says: Preflight Fail: ekf2 missing data",
        "PX4 says that it is armed",
    ] {
        assert!(said.contains(words), "{words}:\n{said}");
    }
    Ok(flight.stderr)
}

fn pymavlink_arms_a_board_on_one_line_and_writes_nothing_that_the_loop_owns() -> Outcome {
    for (baud, rate_hz) in [(921_600, 250), (57_600, 50)] {
        let said = flies("pymavlink", "pymavlink", baud, rate_hz)?;
        // The station tried to write three sensors, and another rate of the outputs.
        assert!(said.contains("the ground station sent HIL_SENSOR: the sensors are the bench's"), "{said}");
    }
    Ok(())
}

fn mavsdk_arms_a_board_on_one_line() -> Outcome {
    for (baud, rate_hz) in [(921_600, 250), (57_600, 50)] {
        flies("mavsdk", "mavsdk", baud, rate_hz)?;
    }
    Ok(())
}

fn mavproxy_arms_a_board_on_one_line() -> Outcome {
    for (baud, rate_hz) in [(921_600, 250), (57_600, 50)] {
        flies("mavproxy", "MAVProxy", baud, rate_hz)?;
    }
    Ok(())
}

fn the_check_reads_the_attitude_over_the_line_that_carries_the_sensors() -> Outcome {
    for (baud, rate_hz) in [(921_600, 200), (57_600, 50)] {
        let dir = tempfile::tempdir().unwrap();
        let (line, report) = (dir.path().join("ttyACM0"), dir.path().join("report.json"));
        let mut board = Command::new(python()?);
        board.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/autopilots/px4.py"));
        board.args(["0".as_ref(), report.as_os_str(), "--free".as_ref(), "--pty".as_ref(), line.as_os_str()]);
        board.args(["--baud", &baud.to_string(), "--disarmed", "--station", "0"]);
        let board = spawn(board);
        let link = format!("--set=bridge.px4.link=serial://{}:{baud}", line.display());
        let rate = format!("--set=rate_hz={rate_hz}");
        let end = run(["bridge", "check", "controller", "--launch", "quadrotor-px4", &link, &rate]);
        board.signal(libc::SIGTERM);
        board.finish();
        let said = end.stdout.clone() + &end.stderr;
        assert_eq!(end.code(), 0, "{baud}:\n{said}");
        for words in
            ["PX4 sends outputs", "stands level", "roll: +17.2 deg", "pitch: -34.4 deg", "yaw: +17.2 deg"]
        {
            let told = said.lines().any(|l| l.starts_with("ok") && l.contains(words));
            assert!(told, "{baud}: {words}:\n{said}");
        }
        assert_eq!(json(&report)["faults"], serde_json::json!([]), "{said}");
        assert!(json(&report)["intervals"]["30"].as_f64().is_some(), "it was asked for its attitude");
    }
    Ok(())
}

fn a_line_that_cannot_carry_the_sensors_is_refused_with_the_rate_that_it_carries() {
    let end = run(["run", "quadrotor-px4", "--set", "bridge.px4.link=serial:///dev/ttyACM0:57600"]);
    assert_eq!(end.code(), 2, "{}", end.stderr);
    assert!(end.stderr.contains("rate_hz at most 52"), "{}", end.stderr);
    let forward = "bridge.px4.forward=nowhere";
    let end = run(["run", "quadrotor-px4", "--set", forward]);
    assert_eq!(end.code(), 2, "{}", end.stderr);
    assert!(end.stderr.contains("udpout://"), "{}", end.stderr);
}

whirlstand_test_harness::listed!(
    pymavlink_arms_a_board_on_one_line_and_writes_nothing_that_the_loop_owns,
    mavsdk_arms_a_board_on_one_line,
    mavproxy_arms_a_board_on_one_line,
    the_check_reads_the_attitude_over_the_line_that_carries_the_sensors,
    a_line_that_cannot_carry_the_sensors_is_refused_with_the_rate_that_it_carries
);
