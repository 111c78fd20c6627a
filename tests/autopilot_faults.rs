//! Autopilots that are slow, reboot, or never fly: what the bench does with them, and what it reports.

use crate::support::flight::{betaflight, fly, free_tcp, free_udp, take_off};
use crate::support::run;
use serde_json::json as value;
use whirlstand_test_harness::Outcome;

/// PX4 in lockstep that answers 50 ms late, in a loop of 5 ms: the vehicle is flown on the outputs before, without
/// failsafe, and its pace is told once.
fn a_slow_autopilot_in_lockstep_is_flown_on_its_previous_outputs_in_realtime() -> Outcome {
    let port = free_tcp();
    let arguments = [&*port.to_string(), "REPORT", "--slow", "0.05"].map(String::from);
    let link = format!("bridge.px4.link=tcpin://127.0.0.1:{port}");
    let flight = fly("px4-hil", "px4.py", &arguments, &[link], &["--mode", "realtime"])?.well();
    let timing = &flight.summary["runs"][0]["timing"];
    assert!(timing["failsafe_share"].as_f64().unwrap() < 0.01, "{timing}\n{}", flight.stderr);
    // At most one answer every 50 ms, over 10 s and the start.
    let steps = flight.report["steps"].as_u64().unwrap();
    assert!((60..400).contains(&steps), "{}", flight.report);
    let told: Vec<_> = flight.stderr.lines().filter(|line| line.contains(" ms to answer")).collect();
    assert!(told.len() == 1 && told[0].contains("the loop asks every 5 ms"), "{told:?}\n{}", flight.stderr);
    Ok(())
}

/// A board on a serial line that reboots in flight: silence, a clock that begins at zero, and not armed.
fn a_board_that_reboots_on_its_line_is_recognised_and_flies_again_once_armed() -> Outcome {
    let dir = tempfile::tempdir().unwrap();
    let line = dir.path().join("ttyACM0").display().to_string();
    let arguments = ["0", "REPORT", "--free", "--pty", &line, "--baud", "921600", "--reboot-after", "1000"]
        .map(Into::into);
    let link = format!("bridge.px4.link=serial://{line}:921600");
    let rest = ["--mode", "realtime", "--set", "rate_hz=250"];
    let flight = fly("px4-hil", "px4.py", &arguments, &[link], &rest)?;
    assert_eq!(flight.report["faults"], value!([]), "{}", flight.stderr);
    assert_eq!(flight.report["reboots"], 1, "{}", flight.stderr);
    let mut said = flight.stderr.as_str();
    for words in [
        "PX4: no fresh outputs",
        "PX4 restarted: outputs are neutral until it is armed again",
        "PX4: not armed: inputs at neutral",
        "PX4 flies again",
    ] {
        said =
            said.split_once(words).unwrap_or_else(|| panic!("{words}, in this order:\n{}", flight.stderr)).1;
    }
    let disarmed = &flight.summary["runs"][0]["timing"]["disarmed_share"];
    assert!(disarmed.as_f64() > Some(0.01), "{disarmed}");
    Ok(())
}

/// The run ends with the reason that the autopilot gives, and nothing of a broken chain.
fn an_autopilot_that_is_never_armed_ends_the_run_with_its_reason() -> Outcome {
    let ground = free_udp();
    let telemetry = format!("udpin://127.0.0.1:{ground}");
    for (how, place, words) in [
        (&["--station", "1e9"][..], "", ": its arming checks fail, in every mode: GPS, magnetometer"),
        (
            &["--disarmed"],
            &*telemetry,
            &*format!(", and has not said why: nothing is received from it at {telemetry}"),
        ),
    ] {
        let port = free_tcp();
        let mut arguments = vec![port.to_string(), "REPORT".into()];
        arguments.extend(how.iter().map(ToString::to_string));
        let options = [
            format!("bridge.px4.link=tcpin://127.0.0.1:{port}"),
            format!("bridge.px4.telemetry={place}"),
            "plant.start_timeout_s=5".into(),
        ];
        let end = take_off("px4-hil", "px4.py", &arguments, &options, &["--mode", "lockstep"])?.fail();
        let told = format!("PX4 was not armed within 5 s{words}");
        assert!(
            end.stderr.contains(&told) && end.stdout.contains(&told),
            "{told}\n{}{}",
            end.stderr,
            end.stdout
        );
        assert!(
            !end.stderr.contains("the chain from") && !end.stderr.contains("restarting it"),
            "{}",
            end.stderr
        );
    }
    ardupilot_ends_with_its_reason()?;
    let (mut arguments, options) = betaflight(std::array::from_fn(|_| free_udp()));
    let msp = free_tcp();
    arguments.extend(["--msp".into(), msp.to_string(), format!("--blocked={:#x}", 1 << 7)]);
    let mut options = options.to_vec();
    options.push(format!("bridge.betaflight.msp=tcpout://127.0.0.1:{msp}"));
    options.push("plant.start_timeout_s=8".into());
    let rest = ["--mode", "realtime"];
    let end = take_off("betaflight-sitl", "betaflight.py", &arguments, &options, &rest)?.fail();
    let told = "Betaflight was not armed within 8 s: THROTTLE (the throttle is not low)";
    assert!(end.stdout.contains(told), "{}{}", end.stderr, end.stdout);
    Ok(())
}

/// ArduPilot's simulation interface has no reasons: they come from its MAVLink, and without it the user is told of it.
fn ardupilot_ends_with_its_reason() -> Outcome {
    let (port, serial1) = (free_udp(), free_tcp());
    let place = format!("tcpout://127.0.0.1:{serial1}");
    let checks = ": PreArm: RC not calibrated; PreArm: AHRS: EKF3 Yaw inconsistent 12 deg. Wait or reboot";
    let silent = format!(", and has not said why: nothing is received from it at {place}");
    for (has_mavlink, words) in [(true, checks), (false, &silent)] {
        let mut arguments: Vec<String> =
            [&*port.to_string(), "REPORT", "--disarmed"].map(Into::into).to_vec();
        if has_mavlink {
            arguments.extend(["--serial1".into(), serial1.to_string()]);
        }
        let options = [
            format!("bridge.ardupilot.link=udpin://127.0.0.1:{port}"),
            format!("bridge.ardupilot.telemetry={place}"),
            "plant.start_timeout_s=5".into(),
        ];
        let rest = ["--mode", "lockstep"];
        let flying = take_off("ardupilot-json", "ardupilot.py", &arguments, &options, &rest)?;
        let (end, report) = flying.fail_with_report();
        let told = format!("ArduPilot was not armed within 5 s{words}");
        assert!(end.stdout.contains(&told), "{told}\n{}{}", end.stderr, end.stdout);
        assert_eq!(report["faults"], value!([]), "{report}");
        if has_mavlink {
            let state =
                "ArduPilot is system 1, component 1, and says that it is not armed, in mode Stabilize";
            assert!(end.stderr.contains(state), "{}", end.stderr);
            assert!(report["asked"].as_u64() >= Some(1) && report["beats"].as_u64() >= Some(2), "{report}");
        }
    }
    Ok(())
}

fn an_autopilot_that_does_not_come_ends_the_run_with_where_it_was_awaited() {
    let ports: [u16; 4] = std::array::from_fn(|_| free_udp());
    let dir = tempfile::tempdir().unwrap();
    let set = format!("bridge.betaflight.ports={ports:?}");
    let out = dir.path().display().to_string();
    let settings =
        ["nodes.controller.bridge=betaflight-sitl", &set, "bridge.rc.arm=true", "plant.start_timeout_s=2"];
    let settings = settings.into_iter().flat_map(|set| ["--set", set]);
    let end = run(["run", "quadrotor", "--out", &out].into_iter().chain(settings));
    assert_eq!(end.code(), 1, "{}", end.stderr);
    assert!(end.stderr.contains("Betaflight sent no outputs within 2 s"), "{}", end.stderr);
    assert!(!end.stderr.contains("the chain from"), "{}", end.stderr);
}

whirlstand_test_harness::listed!(
    a_slow_autopilot_in_lockstep_is_flown_on_its_previous_outputs_in_realtime,
    a_board_that_reboots_on_its_line_is_recognised_and_flies_again_once_armed,
    an_autopilot_that_is_never_armed_ends_the_run_with_its_reason,
    an_autopilot_that_does_not_come_ends_the_run_with_where_it_was_awaited
);
