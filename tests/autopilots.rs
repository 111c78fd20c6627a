//! Stand-ins for autopilots, written in Python from the published protocol layouts, fly the bench's vehicle over
//! loopback sockets: they hold it level against a gust using only what the bridge sends, and record every fault.

use std::path::Path;

use crate::support::flight::{Flight, betaflight, fly, free_tcp, free_udp, take_off};
use crate::support::{json, run};
use serde_json::Value;
use whirlstand_test_harness::{Missing, Outcome, python};

fn px4s_side_flies_over_a_serial_line_as_hardware_in_the_loop() -> Outcome {
    let dir = tempfile::tempdir().unwrap();
    let line = dir.path().join("ttyACM0").display().to_string();
    let arguments = ["0", "REPORT", "--free", "--pty", &line, "--baud", "921600"].map(Into::into);
    let link = format!("bridge.px4.link=serial://{line}:921600");
    let rest = ["--mode", "realtime", "--set", "rate_hz=250"];
    let flight = fly("px4-hil", "px4.py", &arguments, &[link], &rest)?;
    let flight = flight.well();
    assert!(flight.report["steps"].as_u64().unwrap() > 2000, "{}", flight.report);
    Ok(())
}
fn px4(options: &[&str], rest: &[&str]) -> Result<Flight, Missing> {
    let port = free_tcp();
    let mut arguments = vec![port.to_string(), "REPORT".into()];
    arguments.extend(options.iter().map(ToString::to_string));
    fly("px4-hil", "px4.py", &arguments, &[format!("bridge.px4.link=tcpin://127.0.0.1:{port}")], rest)
}

fn px4s_side_of_mavlink_hil_flies_in_lockstep() -> Outcome {
    // Without noise of the autopilot's sensors themselves, that of the vehicle's sensors keeps them from standing still.
    let noiseless = "bridge.sensors={gyro_noise=0, accel_noise=0}";
    let rest =
        ["--mode", "lockstep", "--set", "rate_hz=250", "--set", "bridge.px4.rc=true", "--set", noiseless];
    let flight = px4(&[], &rest)?;
    let flight = flight.well();
    let seen = |kind: &str| flight.report["seen"][kind].as_u64().unwrap_or(0);
    // 10 s at 250 Hz, plus the start.
    let sensors = seen("HIL_SENSOR");
    assert!(sensors >= 2500, "{}", flight.report);
    for (kind, share) in [("HIL_GPS", 25), ("HIL_STATE_QUATERNION", 2), ("RC_CHANNELS", 6)] {
        assert!(seen(kind) >= sensors / share - 5, "{kind}: {}", flight.report);
    }
    // The attitude that it estimates from gyroscope and accelerometer is correct within the sensors' errors.
    assert!(flight.report["roll_error"].as_f64().unwrap() < 0.03, "{}", flight.report);
    Ok(())
}

fn px4s_side_of_mavlink_hil_flies_freely_at_500_hz() -> Outcome {
    let flight = px4(&["--free"], &["--mode", "realtime", "--set", "rate_hz=500"])?;
    let flight = flight.well();
    assert!(flight.report["steps"].as_u64().unwrap() > 4000, "{}", flight.report);
    Ok(())
}

fn an_autopilot_that_connects_again_is_told_and_the_plant_is_in_failsafe_meanwhile() -> Outcome {
    let flight = px4(&["--reconnect-after", "1500"], &["--mode", "realtime"])?;
    assert_eq!(flight.report["connections"], 2, "{}", flight.stderr);
    assert_eq!(flight.report["faults"], serde_json::json!([]));
    let said = |words: &str| assert!(flight.stderr.contains(words), "{words}:\n{}", flight.stderr);
    said("the other end closed it");
    said("neutral until PX4 is armed again");
    said("not armed: inputs at neutral");
    said("PX4 flies again");
    Ok(())
}

fn ardupilot(options: &[&str], rest: &[&str]) -> Result<Flight, Missing> {
    let port = free_udp();
    let mut arguments = vec![port.to_string(), "REPORT".into()];
    arguments.extend(options.iter().map(ToString::to_string));
    let link = [format!("bridge.ardupilot.link=udpin://127.0.0.1:{port}")];
    fly("ardupilot-json", "ardupilot.py", &arguments, &link, rest)
}

fn ardupilots_side_of_its_json_interface_flies_in_lockstep() -> Outcome {
    // The stand-in also starts slowly, which costs no flight time.
    let options = ["--resend", "100", "--boots", "0.6"];
    let flight = ardupilot(&options, &["--mode", "lockstep", "--set", "rate_hz=400"])?;
    let flight = flight.well();
    let resent = flight.report["resent"].as_u64().unwrap();
    assert!(resent >= 40 && flight.report["resent_same"] == resent, "{}", flight.report);
    assert!(flight.report["roll_error"].as_f64().unwrap() < 0.03, "{}", flight.report);
    Ok(())
}

fn ardupilot_with_32_channels_flies_in_realtime_and_may_start_again() -> Outcome {
    let flight = ardupilot(&["--wide", "--restart-after", "1200"], &["--mode", "realtime"])?;
    assert_eq!(flight.report["faults"], serde_json::json!([]), "{}", flight.stderr);
    assert_eq!(flight.report["restarts"], 1);
    assert!(flight.stderr.contains("it restarted at another address"), "{}", flight.stderr);
    assert!(flight.stderr.contains("ArduPilot flies again"), "{}", flight.stderr);
    Ok(())
}

fn betaflights_side_of_its_sitl_flies_in_real_time_after_an_explicit_arm() -> Outcome {
    let ports: [u16; 4] = std::array::from_fn(|_| free_udp());
    let (arguments, options) = betaflight(ports);
    let rest = ["--mode", "realtime", "--set", "rate_hz=500"];
    let flight = fly("betaflight-sitl", "betaflight.py", &arguments, &options, &rest)?;
    let flight = flight.well();
    let report = &flight.report;
    assert!(report["armed_at"].as_f64().unwrap() > 1.9, "not before the grace: {report}");
    assert_eq!(report["disarmed"], true, "disarmed at the end: {report}");
    assert_eq!(report["rc"][2], 1000, "throttle low at the end: {report}");
    // Betaflight's clock runs at the rate of the wall clock at all times, however its packets arrive.
    assert_eq!(report["rates"], serde_json::json!([1.0, 1.0, 1.0]), "{report}");
    Ok(())
}

/// Soaks a bench with a stand-in; returns the result and the report of the stand-in.
fn soaked(
    fault: &str,
    bridge: &str,
    program: &str,
    arguments: &[String],
    options: &[String],
) -> Result<(Value, Value), Missing> {
    let dir = tempfile::tempdir().unwrap();
    let (report, result) = (dir.path().join("report.json"), dir.path().join("soak.json"));
    let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/autopilots").join(program);
    let mut exec = vec![python()?.display().to_string(), program.display().to_string()];
    let report_path = report.display().to_string();
    exec.extend(arguments.iter().map(|a| if a == "REPORT" { report_path.clone() } else { a.clone() }));
    let head = ["soak", "quadrotor", "--fault", fault, "--rounds", "2", "--lasting", "1", "--json"];
    let mut args: Vec<String> = head.map(Into::into).to_vec();
    args.push(result.display().to_string());
    let node = [format!("nodes.controller.bridge={bridge}"), format!("nodes.autopilot.exec={exec:?}")];
    let more = ["nodes.autopilot.ready=start".to_string(), "setpoint=[]".to_string()];
    for set in node.iter().chain(&more).chain(options) {
        args.extend(["--set".into(), set.clone()]);
    }
    let end = run(args);
    assert_eq!(end.code(), 0, "{}\n{}", end.stdout, end.stderr);
    assert!(end.stderr.contains("sends as well and is refused"), "{}", end.stderr);
    Ok((json(result), json(report)))
}

/// Valid outputs of a second sender and malformed data, at 10 kHz: neither is accepted, and neither costs a step.
fn strangers_at_an_autopilots_port_are_refused_while_it_flies() -> Outcome {
    let ports: [u16; 4] = std::array::from_fn(|_| free_udp());
    let (arguments, options) = betaflight(ports);
    let port = free_udp();
    let link = [format!("bridge.ardupilot.link=udpin://127.0.0.1:{port}"), "mode=lockstep".into()];
    let ardupilot = [port.to_string(), "REPORT".into()];
    for fault in ["forge", "flood"] {
        for (result, seen) in [
            soaked(fault, "ardupilot-json", "ardupilot.py", &ardupilot, &link)?,
            soaked(fault, "betaflight-sitl", "betaflight.py", &arguments, &options)?,
        ] {
            assert_eq!((&result["ok"], &result["survived"]), (&true.into(), &2.into()), "{result}");
            let dealt = result["faults"].as_array().unwrap().iter().map(|f| f["dealt"].as_u64().unwrap());
            assert!(dealt.min() > Some(500), "{result}");
            assert_eq!(seen["faults"], serde_json::json!([]), "{fault}: {seen}");
        }
    }
    Ok(())
}

/// Two reasons prevent arming, or no switch arms it (for which it has no flag): each is reported with its meaning.
fn betaflight_that_does_not_arm_says_why() -> Outcome {
    let blocked = format!("--blocked={:#x}", 1 << 28 | 1 << 23 | 1 << 7);
    for (how, words) in [
        (&*blocked, "THROTTLE (the throttle is not low), ACC_CALIB (the accelerometer is not calibrated)"),
        ("--no-switch", "no switch of the transmitter arms it: 'aux 0 0 0 1700 2100 0 0'"),
    ] {
        let (mut arguments, options) = betaflight(std::array::from_fn(|_| free_udp()));
        let msp = free_tcp();
        arguments.extend(["--msp".into(), msp.to_string(), how.into()]);
        let mut options = options.to_vec();
        options.push(format!("bridge.betaflight.msp=tcpout://127.0.0.1:{msp}"));
        let rest = ["--mode", "realtime"];
        let mut flying = take_off("betaflight-sitl", "betaflight.py", &arguments, &options, &rest)?;
        flying.wait_for(&format!("Betaflight cannot be armed: {words}"));
    }
    Ok(())
}

/// Flies PX4 in lockstep, never armed, with the stand-in options `how`; the bench must print `words` within 15 s of
/// the stand-in's own clock.
fn px4_that_does_not_arm(how: &[&str], place: &str, words: &str) -> Outcome {
    let port = free_tcp();
    let mut arguments = vec![port.to_string(), "REPORT".into()];
    arguments.extend(how.iter().chain(&["--mark", "15"]).map(ToString::to_string));
    let options =
        [format!("bridge.px4.link=tcpin://127.0.0.1:{port}"), format!("bridge.px4.telemetry={place}")];
    let mut flying = take_off("px4-hil", "px4.py", &arguments, &options, &["--mode", "lockstep"])?;
    flying.wait_for_before(words, "15 s have passed");
    Ok(())
}

fn px4_in_lockstep_that_does_not_arm_says_why_on_its_link_and_at_a_port_of_its_own() -> Outcome {
    const CHECKS: &str = "PX4 cannot be armed: its arming checks fail, in every mode: GPS, magnetometer";
    let ground = free_udp();
    let (port, place) = (ground.to_string(), format!("udpin://127.0.0.1:{ground}"));
    // PX4's checks never pass; it reports this on the simulator's link, or on its other port as software in the loop.
    px4_that_does_not_arm(&["--station", "1e9"], "", CHECKS)?;
    px4_that_does_not_arm(&["--station", "1e9", "--ground", &port], &place, CHECKS)?;
    // Without events, the health bits give the reason.
    let bits = ["--station", "1e9", "--bits", "--ground", &port];
    let words = "PX4 cannot be armed: its pre-arm checks fail; not healthy: magnetometer, GPS";
    px4_that_does_not_arm(&bits, &place, words)
}

/// PX4 responds, but no reason why it is not armed is received: the bench reports where it listens for one.
fn px4_in_lockstep_that_says_nothing_is_told_with_where_to_look() -> Outcome {
    let place = format!("udpin://127.0.0.1:{}", free_udp());
    let words = format!("is not armed, and has not said why: nothing is received from it at {place}");
    px4_that_does_not_arm(&["--disarmed"], &place, &words)
}

/// As the comment in the example says: the project's own controller then flies, and holds what Betaflight holds.
fn the_example_of_betaflight_flies_without_its_bridge_line() {
    let dir = tempfile::tempdir().unwrap();
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/betaflight");
    std::fs::copy(example.join("agile.toml"), dir.path().join("agile.toml")).unwrap();
    let text = std::fs::read_to_string(example.join("flight.toml")).unwrap();
    let line = "bridge = \"betaflight-sitl\"    # without this line the controller is ours\n";
    assert!(text.contains(line), "{text}");
    let launch = dir.path().join("flight.toml");
    std::fs::write(&launch, text.replace(line, "")).unwrap();
    let out = dir.path().join("out");
    // In lockstep, so that the load of the machine has no effect.
    let args = ["run", launch.to_str().unwrap(), "--mode", "lockstep", "--out", out.to_str().unwrap()];
    run(args).success();
    let outputs = &json(out.join("summary.json"))["runs"][0]["outputs"];
    for axis in ["roll", "pitch"] {
        let peak = outputs[axis]["peak"].as_f64().unwrap();
        assert!((0.02..0.35).contains(&peak), "{axis}: {outputs}");
    }
}

fn what_an_autopilots_bridge_cannot_be_is_refused_with_its_place() {
    for (assignments, words) in [
        (["nodes.controller.bridge=px4-hil", "bridge.mixer.roll.input=u_rol"], "u_roll, u_pitch"),
        (["nodes.controller.bridge=px4-hill", "seed=1"], "px4-hil"),
        (["nodes.plant.bridge=px4-hil", "seed=1"], "replaces the controller"),
        (["nodes.controller.bridge=px4-hil", "bridge.px4.link=nowhere"], "tcpin://"),
        (["nodes.controller.bridge=px4-hil", "bridge.px4.lnk=nowhere"], "'link'"),
        (["nodes.controller.bridge=betaflight-sitl", "mode=lockstep"], "realtime"),
        (["nodes.controller.bridge=betaflight-sitl", "bridge.rc.throttle=2"], "0 to 1"),
        (["nodes.controller.bridge=ardupilot-json", "bridge.sensors.heading=90 m"], "m"),
        (["nodes.controller.bridge=ardupilot-json", "bridge.flight.stale_s=0"], "above 0"),
        (["nodes.controller.bridge=ardupilot-json", "bridge.ardupilot.telemetry=nowhere"], "tcpout://"),
        (["nodes.controller.bridge=betaflight-sitl", "bridge.betaflight.msp=nowhere"], "tcpout://"),
    ] {
        let mut args = vec!["run", "quadrotor"];
        assignments.iter().for_each(|a| args.extend(["--set", a]));
        let end = run(args);
        assert_eq!(end.code(), 2, "{assignments:?}: {}", end.stderr);
        assert!(end.stderr.contains(words), "{assignments:?}: {}", end.stderr);
    }
}

whirlstand_test_harness::listed!(
    px4s_side_flies_over_a_serial_line_as_hardware_in_the_loop,
    px4s_side_of_mavlink_hil_flies_in_lockstep,
    px4s_side_of_mavlink_hil_flies_freely_at_500_hz,
    an_autopilot_that_connects_again_is_told_and_the_plant_is_in_failsafe_meanwhile,
    ardupilots_side_of_its_json_interface_flies_in_lockstep,
    ardupilot_with_32_channels_flies_in_realtime_and_may_start_again,
    betaflights_side_of_its_sitl_flies_in_real_time_after_an_explicit_arm,
    strangers_at_an_autopilots_port_are_refused_while_it_flies,
    betaflight_that_does_not_arm_says_why,
    px4_in_lockstep_that_does_not_arm_says_why_on_its_link_and_at_a_port_of_its_own,
    px4_in_lockstep_that_says_nothing_is_told_with_where_to_look,
    the_example_of_betaflight_flies_without_its_bridge_line,
    what_an_autopilots_bridge_cannot_be_is_refused_with_its_place
);
