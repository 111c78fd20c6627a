//! The MAVLink bridge as a whole process, against third-party programs: pymavlink is the autopilot, MAVSDK the ground
//! station. Real UDP and real pseudo-terminals.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::bridged::{Bridged, setpoints, what_the_controller_flew_alone_is_learned_from};
use crate::support::mavlink::{RATE_HZ, autopilot, end, free_port, launch, script};
use crate::support::{Running, json, run, spawn, whirlstand};
use serde_json::Value;
use whirlstand_test_harness::{Outcome, python};

/// The gust of the built-in bench, on this project's plant; its controller is the autopilot, which speaks only MAVLink.
fn bench_flown_by_the_autopilot(python: &Path, port: u16, report: &Path, more: &[&str]) -> String {
    let script = script("autopilot.py").display().to_string();
    let (link, report) = (format!("udpout:127.0.0.1:{port}"), report.display().to_string());
    let exec = [&*python.display().to_string(), &script, "--link", &link, "--report", &report];
    format!(
        r#"
vehicle = "quadrotor"
transport = "zenoh"
rate_hz = {RATE_HZ}.0
duration_s = 14.0
[controller]
law = "lqr"
[nodes.controller]
exec = {exec:?}
env = {{ PYTHONPATH = {examples:?} }}
restart = "never"
[[effects]]
effect = "pulse_disturbance"
where = "roll_rate"
at_s = 8.0
duration_s = 0.2
magnitude = "150 deg/s^2"
"#,
        exec = [&exec[..], more].concat(),
        examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/python"),
    )
}

/// The autopilot's bench and the bridge that flies it, over MAVLink alone.
struct Flown {
    dir: tempfile::TempDir,
    report: PathBuf,
    vehicle: Running,
    bridge: Running,
}

impl Flown {
    /// Starts both, with options of the autopilot, and of the bridge.
    fn take_off(python: &Path, autopilot: &[&str], bridge: &str) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let (port, report) = (free_port(), dir.path().join("autopilot.json"));
        let physics = dir.path().join("physics.toml");
        std::fs::write(&physics, bench_flown_by_the_autopilot(python, port, &report, autopilot)).unwrap();
        let ours = launch(dir.path(), port, &format!("pace = \"telemetry\"\n{bridge}"));
        let [flown, seen] = ["physics", "bridge"].map(|name| dir.path().join(name).display().to_string());
        let vehicle = spawn(whirlstand(["run", physics.to_str().unwrap(), "--out", &flown]));
        let set = ["--set", "bridge.safety.max_innovation=100", "--duration", "60"];
        let args = [&["run", ours.to_str().unwrap(), "--out", &seen], &set[..]].concat();
        let bridge = spawn(whirlstand(args));
        Self { dir, report, vehicle, bridge }
    }
}

/// The roll of a run.
fn roll(dir: &Path) -> Value {
    json(dir.join("summary.json"))["runs"][0]["outputs"]["roll"].clone()
}

/// The roll of the same bench with its own controller.
fn roll_in_simulation(python: &Path) -> Value {
    let dir = tempfile::tempdir().unwrap();
    let text = bench_flown_by_the_autopilot(python, 1, Path::new("unused"), &[]);
    let foreign = |line: &&str| ["[nodes", "exec", "env", "restart"].iter().any(|w| line.starts_with(w));
    let kept: Vec<_> = text.lines().filter(|line| !foreign(line)).collect();
    let (plain, out) = (dir.path().join("plain.toml"), dir.path().join("sim"));
    std::fs::write(&plain, kept.join("\n")).unwrap();
    let out = out.to_str().unwrap();
    run(["run", plain.to_str().unwrap(), "--mode", "lockstep", "--out", out]).success();
    roll(Path::new(out))
}

fn the_loop_closes_through_real_mavlink_and_rejects_the_gust_as_in_simulation() -> Outcome {
    let python = python()?;
    let simulated = roll_in_simulation(&python);
    for (output, message) in [
        ("rc-override", "RC_CHANNELS_OVERRIDE"),
        ("manual-control", "MANUAL_CONTROL"),
        ("attitude-target", "SET_ATTITUDE_TARGET"),
    ] {
        let Flown { dir, report, vehicle, mut bridge } =
            Flown::take_off(&python, &[], &format!("output = \"{output}\""));
        vehicle.finish().success();
        // The vehicle has ended, and the bridge must report this by itself.
        bridge.wait_for_stderr("FAILSAFE");
        bridge.signal(libc::SIGINT);
        let bridged = bridge.finish();
        let real = roll(&dir.path().join("physics"));
        eprintln!("roll through {message}: {real}\nroll in simulation: {simulated}");
        assert_eq!(real["recovered"], true, "{output}: {real}\n{}", bridged.stderr);
        let peak = |v: &Value| v["peak"].as_f64().unwrap();
        assert!(peak(&real) < 1.5 * peak(&simulated), "{output}: {real}\n{simulated}");
        let seen = json(&report);
        assert_eq!(seen["faults"], serde_json::json!([]), "{output}");
        assert_eq!(seen["moved_before_armed"], 0, "{output}: {seen}");
        assert!(seen["seen"][message].as_u64() > Some(500), "{output}: {}", seen["seen"]);
        assert!(seen["requested"]["30"].as_f64() == Some(1e6 / f64::from(RATE_HZ)), "{}", seen["requested"]);
        assert!(bridged.stderr.contains("the controller is in charge"), "{}", bridged.stderr);
    }
    Ok(())
}

/// ATTITUDE has rates: the bridge notices that the vehicle rolls against its commands, and stays neutral.
fn a_vehicle_that_rolls_against_its_commands_goes_neutral_and_is_told() -> Outcome {
    let Flown { dir: _dir, report, vehicle, mut bridge } = Flown::take_off(&python()?, &["--rolls-left"], "");
    bridge.wait_for_stderr("roll: the vehicle accelerates opposite to the command");
    bridge.wait_for_stderr("the vehicle answers its commands with the wrong sign");
    vehicle.finish();
    bridge.signal(libc::SIGINT);
    let bridged = bridge.finish();
    let seen = json(&report);
    assert_eq!(seen["faults"], serde_json::json!([]), "{}", bridged.stderr);
    let history = seen["history"].as_array().unwrap();
    assert!(history.iter().any(|h| h[1] == false), "it was moved before: {history:?}");
    // The flight goes on for seconds, and neutral lasts until its end.
    let last = history.last().unwrap();
    let lasted = seen["seconds"].as_f64().unwrap() - last[0].as_f64().unwrap();
    assert!(last[1] == true && lasted > 1.0, "{lasted} s: {last}\n{}", bridged.stderr);
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

/// A pilot takes over by the vehicle's own radio for part of a flight; see the CRSF test of the same name.
fn what_a_pilot_flew_is_not_what_the_vehicle_is_identified_and_diagnosed_by() -> Outcome {
    let python = python()?;
    let dir = tempfile::tempdir().unwrap();
    let (port, report) = (free_port(), dir.path().join("autopilot.json"));
    let bridged = Bridged {
        bridge: "mavlink",
        vehicle: "quadrotor",
        rate_hz: RATE_HZ,
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
    let vehicle = spawn(autopilot(&python, port, &report, &["--pilot", &phases.to_string()]));
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

whirlstand_test_harness::listed!(
    the_loop_closes_through_real_mavlink_and_rejects_the_gust_as_in_simulation,
    a_vehicle_that_rolls_against_its_commands_goes_neutral_and_is_told,
    a_silent_vehicle_is_told_and_gets_neutral_and_comes_back_when_armed_again,
    signed_links_work_and_strangers_are_not_believed,
    mavsdk_reads_the_attitude_through_the_bridge,
    a_serial_autopilot_is_flown_unplugged_and_plugged_in_again,
    what_a_pilot_flew_is_not_what_the_vehicle_is_identified_and_diagnosed_by,
    wrong_options_are_told_with_their_line
);
