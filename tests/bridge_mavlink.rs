//! The MAVLink bridge as a whole process, against third-party programs: pymavlink is the autopilot, MAVSDK the ground
//! station. Real UDP and real pseudo-terminals.

mod support;

use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;
use support::bridged::{Bridged, setpoints, what_the_controller_flew_alone_is_learned_from};
use support::{Running, json, run, said, spawn, spawn_listening, whirlstand};
use whirlstand_test_harness::{Outcome, python};

/// A UDP port that no process uses.
fn free_port() -> u16 {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

fn script(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bridge").join(name)
}

/// The autopilot alone, talking to the bridge at `port`.
fn autopilot(python: &Path, port: u16, report: &Path, more: &[&str]) -> Command {
    let mut command = Command::new(python);
    command.arg(script("autopilot.py")).args(["--link", &format!("udpout:127.0.0.1:{port}")]);
    command.arg("--report").arg(report).args(more);
    command
}

/// A launch file with the bridge in the plant's place.
fn launch(dir: &Path, port: u16, more: &str) -> PathBuf {
    let bridged = Bridged {
        bridge: "mavlink",
        vehicle: "quadrotor",
        rate_hz: 250,
        duration_s: 6,
        safety: "arm = \"autopilot\"",
        link: format!("udpin://127.0.0.1:{port}"),
        more,
    };
    bridged.write(dir)
}

/// The autopilot writes its report when it is asked to end.
fn end(running: Running) {
    running.signal(libc::SIGTERM);
    running.finish().success();
}

/// The gust of the built-in bench, on this project's plant; its controller is the autopilot, which speaks only MAVLink.
fn bench_flown_by_the_autopilot(python: &Path, port: u16, report: &Path) -> String {
    format!(
        r#"
vehicle = "quadrotor"
transport = "zenoh"
rate_hz = 250.0
duration_s = 14.0
[controller]
law = "lqr"
[nodes.controller]
exec = [{python:?}, {script:?}, "--link", "udpout:127.0.0.1:{port}", "--report", {report:?}]
env = {{ PYTHONPATH = {examples:?} }}
restart = "never"
[[effects]]
effect = "pulse_disturbance"
where = "roll_rate"
at_s = 8.0
duration_s = 0.2
magnitude = "150 deg/s^2"
"#,
        script = script("autopilot.py"),
        examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/python"),
    )
}

fn the_loop_closes_through_real_mavlink_and_rejects_the_gust_as_in_simulation() -> Outcome {
    let python = python()?;
    let dir = tempfile::tempdir().unwrap();
    let port = free_port();
    let report = dir.path().join("autopilot.json");
    let physics = dir.path().join("physics.toml");
    let text = bench_flown_by_the_autopilot(&python, port, &report);
    std::fs::write(&physics, text).unwrap();
    let ours = launch(dir.path(), port, "pace = \"telemetry\"");
    let (out, sim) = (dir.path().join("physics"), dir.path().join("sim"));
    let vehicle = spawn(whirlstand(["run", physics.to_str().unwrap(), "--out", out.to_str().unwrap()]));
    let mut bridge = spawn(whirlstand([
        "run",
        ours.to_str().unwrap(),
        "--set",
        "bridge.safety.max_innovation=100",
        "--duration",
        "60",
        "--out",
        dir.path().join("bridge").to_str().unwrap(),
    ]));
    vehicle.finish().success();
    // The vehicle has ended, and the bridge must report this by itself.
    bridge.wait_for_stderr("FAILSAFE");
    bridge.signal(libc::SIGINT);
    let bridged = bridge.finish();
    // The same bench with its own controller.
    let plain = dir.path().join("plain.toml");
    let text = std::fs::read_to_string(&physics).unwrap();
    let foreign = |line: &&str| ["[nodes", "exec", "env", "restart"].iter().any(|w| line.starts_with(w));
    let kept: Vec<_> = text.lines().filter(|line| !foreign(line)).collect();
    std::fs::write(&plain, kept.join("\n")).unwrap();
    run(["run", plain.to_str().unwrap(), "--mode", "lockstep", "--out", sim.to_str().unwrap()]).success();

    let roll = |dir: &Path| json(dir.join("summary.json"))["runs"][0]["outputs"]["roll"].clone();
    let (real, simulated) = (roll(&out), roll(&sim));
    eprintln!("roll through MAVLink: {real}\nroll in simulation: {simulated}");
    assert_eq!(real["recovered"], true, "{real}\n{}", bridged.stderr);
    let peak = |v: &Value| v["peak"].as_f64().unwrap();
    assert!(peak(&real) < 1.5 * peak(&simulated), "{real}\n{simulated}");
    let seen = json(&report);
    assert_eq!(seen["faults"].as_array().unwrap().len(), 0, "{}", seen["faults"]);
    assert_eq!(seen["moved_before_armed"], 0, "{seen}");
    assert!(seen["seen"]["RC_CHANNELS_OVERRIDE"].as_u64().unwrap() > 500, "{}", seen["seen"]);
    assert!(seen["requested"]["30"].as_f64() == Some(4000.0), "{}", seen["requested"]);
    assert!(bridged.stderr.contains("the controller is in charge"), "{}", bridged.stderr);
    assert!(bridged.stderr.contains("FAILSAFE"), "the vehicle was gone at the end: {}", bridged.stderr);
    Ok(())
}

fn a_silent_vehicle_is_told_and_gets_neutral_and_comes_back_when_armed_again() -> Outcome {
    let python = python()?;
    let dir = tempfile::tempdir().unwrap();
    let (port, report) = (free_port(), dir.path().join("autopilot.json"));
    let events = [
        ("moved", "silence"),
        ("neutral", "speak"),
        ("neutral", "disarm"),
        ("neutral", "arm"),
        ("moved", "end"),
    ];
    let events = events.map(|(when, what)| serde_json::json!({"when": when, "do": what}));
    let events = Value::from(events.to_vec()).to_string();
    let file = launch(dir.path(), port, "");
    let vehicle = spawn(autopilot(&python, port, &report, &["--events", &events]));
    let out = dir.path().join("out");
    let args = ["run", file.to_str().unwrap(), "--duration", "100", "--out", out.to_str().unwrap()];
    let bench = spawn(whirlstand(args));
    vehicle.finish().success();
    bench.signal(libc::SIGINT);
    let ended = bench.finish();
    assert!(
        ended.stderr.contains("FAILSAFE, outputs at neutral: the vehicle's attitude is stale"),
        "{}",
        ended.stderr
    );
    let seen = json(&report);
    assert_eq!(seen["faults"].as_array().unwrap().len(), 0, "{}", seen["faults"]);
    let history = seen["history"].as_array().unwrap();
    let at = |entry: &Value| entry[0].as_f64().unwrap();
    let when = |what: &str| at(history.iter().find(|h| h[1] == what).unwrap());
    let (silent, disarmed) = (when("silence"), when("disarm"));
    assert!(history.iter().any(|h| h[1] == false && at(h) < silent), "it was moved before: {history:?}");
    // 0.25 s of staleness; the rest is the tolerance for a busy machine.
    let held = history.iter().rfind(|h| h[1].is_boolean() && at(h) < disarmed).unwrap();
    assert!(held[1] == true && at(held) < silent + 0.6, "{} s after silence: {held}", at(held) - silent);
    let moved_again = history.iter().any(|h| h[1] == false && at(h) > when("arm"));
    assert!(moved_again, "{history:?}\n{}", ended.stderr);
    Ok(())
}

fn signed_links_work_and_strangers_are_not_believed() -> Outcome {
    let python = python()?;
    let dir = tempfile::tempdir().unwrap();
    let (port, report) = (free_port(), dir.path().join("autopilot.json"));
    let key = dir.path().join("key");
    std::fs::write(&key, "2a".repeat(32)).unwrap();
    let more = format!("signing_key = {:?}", key.to_str().unwrap());
    let file = launch(dir.path(), port, &more);
    let out = dir.path().join("out");
    let args = ["run", file.to_str().unwrap(), "--duration", "4", "--out", out.to_str().unwrap()];
    let vehicle = spawn(autopilot(&python, port, &report, &["--key", &"2a".repeat(32)]));
    let ended = run(args);
    end(vehicle);
    assert!(ended.stderr.contains("the controller is in charge"), "{}", ended.stderr);
    let seen = json(&report);
    assert_eq!(seen["faults"].as_array().unwrap().len(), 0, "{}", seen["faults"]);
    assert!(seen["seen"]["RC_CHANNELS_OVERRIDE"].as_u64().unwrap() > 50, "{}", seen["seen"]);
    let stranger = spawn(autopilot(&python, port, &report, &["--key", &"2b".repeat(32)]));
    let ended = run(args.into_iter().chain(["--set", "plant.start_timeout_s=3"]));
    end(stranger);
    assert_ne!(ended.code(), 0);
    assert!(ended.stderr.contains("no attitude arrived from the vehicle"), "{}", ended.stderr);
    // A wrong key is reported as such.
    assert!(ended.stderr.contains("messages had a wrong signature"), "{}", ended.stderr);
    assert!(ended.stderr.contains("signing_key is the key that the vehicle signs with"), "{}", ended.stderr);
    assert!(!ended.stderr.contains("baud rate"), "{}", ended.stderr);
    Ok(())
}

fn mavsdk_reads_the_attitude_through_the_bridge() -> Outcome {
    let python = python()?;
    let dir = tempfile::tempdir().unwrap();
    let (port, ground, report) = (free_port(), free_port(), dir.path().join("autopilot.json"));
    let file = launch(dir.path(), port, &format!("forward = \"udpout://127.0.0.1:{ground}\""));
    let vehicle = spawn(autopilot(&python, port, &report, &[]));
    let mut station = Command::new(&python);
    station.arg(script("station.py")).args([&format!("udpin://127.0.0.1:{ground}"), "50"]);
    let station = spawn(station);
    let out = dir.path().join("out");
    let bench = spawn(whirlstand([
        "run",
        file.to_str().unwrap(),
        "--duration",
        "60",
        "--out",
        out.to_str().unwrap(),
    ]));
    let read = station.finish().success();
    bench.signal(libc::SIGINT);
    bench.finish();
    end(vehicle);
    let line = read.stdout.lines().find(|line| line.starts_with("[[")).unwrap();
    let read: Vec<[f64; 3]> = serde_json::from_str(line).unwrap();
    assert_eq!(read.len(), 50);
    for [roll, pitch, yaw] in read {
        // Roll and pitch on a circle of 0.02 rad, heading 0.5 rad.
        assert!(((roll * roll + pitch * pitch).sqrt() - 0.02).abs() < 1e-3 && (yaw - 0.5).abs() < 1e-3);
    }
    Ok(())
}

fn a_serial_autopilot_is_flown_unplugged_and_plugged_in_again() -> Outcome {
    let python = python()?;
    let dir = tempfile::tempdir().unwrap();
    let report = dir.path().join("autopilot.json");
    let plug = dir.path().join("ttyACM0");
    let file = launch(dir.path(), 1, "");
    let link = format!("bridge.mavlink.link=serial://{}:921600", plug.display());
    let out = dir.path().join("out");
    let mut bench = spawn(whirlstand(
        ["run", file.to_str().unwrap(), "--duration", "60", "--out", out.to_str().unwrap()]
            .into_iter()
            .chain(["--set", &link]),
    ));
    let mut line = Command::new(&python);
    line.arg(script("line.py")).arg(&plug).arg(&python).arg(script("autopilot.py")).arg(&report);
    let line = spawn(line);
    bench.wait_for_stderr("the controller is in charge");
    line.signal(libc::SIGUSR1);
    bench.wait_for_stderr("FAILSAFE");
    line.signal(libc::SIGUSR1);
    bench.wait_for_stderr("the controller is in charge");
    bench.signal(libc::SIGINT);
    bench.finish();
    line.signal(libc::SIGTERM);
    line.finish().success();
    let seen = json(&report);
    assert_eq!(seen["faults"].as_array().unwrap().len(), 0, "{}", seen["faults"]);
    Ok(())
}

fn the_check_says_which_axis_or_channel_is_turned_and_that_each_channel_arrives() -> Outcome {
    let python = python()?;
    let dir = tempfile::tempdir().unwrap();
    let (port, report) = (free_port(), dir.path().join("autopilot.json"));
    let file = launch(dir.path(), port, "");
    // On this vehicle's own radio, channel 1 goes down for a roll to the right.
    let wrong = ["--arm-after", "1e9", "--hand", "--turned", "pitch", "--reversed", "roll"];
    let vehicle = autopilot(&python, port, &report, &wrong);
    let check =
        whirlstand(["bridge", "check", "plant", "--launch", file.to_str().unwrap(), "--timeout", "30"]);
    let (vehicle, check) = spawn_listening(vehicle, check);
    let checked = check.finish();
    end(vehicle);
    let said = said(&report);
    assert_eq!(checked.code(), 1, "{said:?}\n{}", checked.stderr);
    for words in [
        ["ok", "roll: +"],
        ["WRONG", "pitch: the sign is turned"],
        ["ok", "yaw: +"],
        ["ok", "channel 1: +100 us"],
        ["ok", "channel 2: +100 us"],
        ["u_roll + -> channel 1 down", "the vehicle rolls left and pitches nose down"],
        [
            "WRONG",
            "channel 1: -300 us for the roll stick to the right, and the bridge has it the other way round",
        ],
        ["ok", "channel 2: +300 us for the pitch stick back"],
    ] {
        assert!(said.iter().any(|l| words.iter().all(|w| l.contains(w))), "{words:?}: {said:#?}");
    }
    Ok(())
}

/// A pilot takes over by the vehicle's own radio for part of a flight; see the CRSF test of the same name.
fn what_a_pilot_flew_is_not_what_the_vehicle_is_identified_and_diagnosed_by() -> Outcome {
    let python = python()?;
    let dir = tempfile::tempdir().unwrap();
    let (port, report) = (free_port(), dir.path().join("autopilot.json"));
    let bridged = Bridged {
        bridge: "mavlink",
        vehicle: "quadrotor",
        rate_hz: 100,
        duration_s: 1000,
        safety: "stale_s = 1.0",
        link: format!("udpin://127.0.0.1:{port}"),
        more: &format!("[bridge.pilot]\nsource = \"mavlink\"\n{}", setpoints()),
    };
    let launch = bridged.write(dir.path()).display().to_string();
    let phases = serde_json::json!([
        ["disarmed", {"arm": false, "automatic": true}],
        ["flown", {"arm": null, "automatic": true, "frames": 1500}],
        ["manual", {"arm": true, "automatic": false, "roll": 1700, "push": 60.0, "frames": 500}],
        ["flown", {"arm": true, "automatic": true, "frames": 1500}],
    ]);
    let vehicle =
        spawn(autopilot(&python, port, &report, &["--rate", "100", "--pilot", &phases.to_string()]));
    let out = dir.path().join("out");
    let out = out.to_str().unwrap();
    let bench = spawn(whirlstand(["run", &launch, "--out", out]));
    vehicle.finish().success();
    bench.signal(libc::SIGINT);
    let end = bench.finish();
    assert_eq!(json(&report)["faults"], serde_json::json!([]), "{}", end.stderr);
    // Events after the vehicle has gone are not part of the flight.
    let flown = end.stderr.split_once("the pilot is in charge").expect(&end.stderr).1;
    assert!(flown.contains("the controller is in charge"), "{}", end.stderr);
    what_the_controller_flew_alone_is_learned_from(out, "quadrotor", "quadrotor-structure");
    Ok(())
}

fn wrong_options_are_told_with_their_line() {
    let dir = tempfile::tempdir().unwrap();
    for (more, words) in [
        ("putput = \"sbus\"", ["line 17", "output"]),
        ("output = \"crsf\"", ["line 15", "output_link"]),
        ("[[bridge.channels]]\nchannel = 1\nfrom = \"u_rol\"", ["line 19", "u_roll"]),
        ("[bridge.measured.rol]\nscale = -1", ["line 17", "roll_rate"]),
    ] {
        let file = launch(dir.path(), 1, more);
        let ended = run(["run", file.to_str().unwrap(), "--no-log"]);
        assert_eq!(ended.code(), 2, "{}", ended.stderr);
        for word in words {
            assert!(ended.stderr.contains(word), "{more}: {}", ended.stderr);
        }
    }
    let file = launch(dir.path(), 1, "");
    let ended = run(["run", file.to_str().unwrap(), "--no-log", "--mode", "lockstep"]);
    assert!(ended.code() == 2 && ended.stderr.contains("does not wait"), "{}", ended.stderr);
}

whirlstand_test_harness::tests!(
    the_loop_closes_through_real_mavlink_and_rejects_the_gust_as_in_simulation,
    a_silent_vehicle_is_told_and_gets_neutral_and_comes_back_when_armed_again,
    signed_links_work_and_strangers_are_not_believed,
    mavsdk_reads_the_attitude_through_the_bridge,
    a_serial_autopilot_is_flown_unplugged_and_plugged_in_again,
    the_check_says_which_axis_or_channel_is_turned_and_that_each_channel_arrives,
    what_a_pilot_flew_is_not_what_the_vehicle_is_identified_and_diagnosed_by,
    wrong_options_are_told_with_their_line
);
