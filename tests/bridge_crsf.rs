//! The CRSF bridge and an SBUS pilot as a whole process, over pseudo-terminals, against a transmitter module and a
//! receiver written only from the published layouts.

use std::path::Path;

use crate::support::bridged::{setpoints, what_the_controller_flew_alone_is_learned_from};
use crate::support::radio::Place;
use crate::support::{json, said, spawn, spawn_listening, whirlstand};
use serde_json::{Value, json as value};
use whirlstand_logs::{BenchMessage, Log};

/// Roll and throttle channels that were received in a phase.
fn seen(report: &Value, phase: usize) -> Vec<(i64, i64)> {
    let list = report["phases"][phase].as_array().unwrap();
    list.iter().map(|v| (v[0].as_i64().unwrap(), v[1].as_i64().unwrap())).collect()
}

fn the_pilot_arms_takes_over_and_a_lost_link_is_neutral() {
    let place = Place::new();
    let phases = value!([
        ["disarmed", {"arm": false, "automatic": true}],
        ["automatic", {"arm": null, "automatic": true}],
        ["manual", {"arm": true, "automatic": false, "roll": 1700}],
        ["automatic", {"arm": true, "automatic": true}],
        ["neutral", {"arm": true, "automatic": true, "telemetry": false}],
        ["disarmed", {"arm": true, "automatic": false, "failsafe": true, "telemetry": false}],
    ]);
    let radio = spawn(place.radio(&phases.to_string()));
    let out = place.dir.path().join("out");
    let bench = spawn(whirlstand(["run", &place.launch(), "--out", out.to_str().unwrap()]));
    radio.finish().success();
    bench.signal(libc::SIGINT);
    let end = bench.finish();
    let report = json(&place.report);
    assert_eq!(report["faults"].as_array().unwrap().len(), 0, "{}\n{}", report["faults"], end.stderr);
    assert!(report["frames"].as_u64().unwrap() >= 300, "{report}");
    if std::env::var_os("CI").is_some_and(|ci| !ci.is_empty()) {
        assert_eq!(report["judged"], report["frames"], "no crsf-parser: install tests/requirements.txt");
    }
    assert!(seen(&report, 0).iter().all(|s| *s == (1500, 1000)), "disarmed: {report}\n{}", end.stderr);
    let automatic = seen(&report, 1);
    assert!(!automatic.is_empty(), "automatic: {report}\n{}", end.stderr);
    assert!(automatic.iter().all(|s| (1000..=2000).contains(&s.0) && (s.1 - 1200).abs() <= 1), "{report}");
    let near = |v: (i64, i64), want: (i64, i64)| (v.0 - want.0).abs() <= 1 && (v.1 - want.1).abs() <= 1;
    assert!(seen(&report, 2).iter().all(|s| near(*s, (1700, 1200))), "manual: {report}");
    assert!(!seen(&report, 3).is_empty(), "automatic again: {report}");
    assert!(seen(&report, 4).iter().all(|s| near(*s, (1500, 1200))), "telemetry lost: {report}");
    assert!(seen(&report, 5).iter().all(|s| near(*s, (1500, 1000))), "pilot lost: {report}");
    for words in [
        "the controller is in charge",
        "the pilot is in charge",
        "attitude is stale",
        "no messages arrive from the pilot's stick",
    ] {
        assert!(end.stderr.contains(words), "{words}: {}", end.stderr);
    }
    the_log_has_what_the_module_received(&out, &report);
}

/// Every set of channels in the log is one that the module received, all 16 of them, and the vehicle's arm switch on
/// channel 5 was seen on and off.
fn the_log_has_what_the_module_received(out: &Path, report: &Value) {
    let received: Vec<[f64; 16]> = serde_json::from_value(report["channels"].clone()).unwrap();
    let log = Log::open(out).unwrap();
    let (mut steps, mut arm) = (0, [false; 2]);
    for message in log.bench_messages().unwrap() {
        let BenchMessage::Sent(sent) = message.unwrap() else { continue };
        // Nothing left the bridge before and after the module was there.
        if sent.channels.iter().all(|us| us.is_nan()) {
            continue;
        }
        steps += 1;
        let near = |came: &&[f64; 16]| came.iter().zip(&sent.channels).all(|(a, b)| (a - b).abs() <= 1.0);
        assert!(received.iter().any(|came| near(&came)), "{:?} is logged, and never came", sent.channels);
        arm[usize::from(sent.channels[4] > 1500.0)] = true;
    }
    assert!(steps >= 300 && arm == [true; 2], "{steps} steps, switch off and on: {arm:?}");
}

fn the_check_says_which_axis_of_the_telemetry_is_turned() {
    let place = Place::new();
    let launch = place.launch();
    let check = whirlstand(["bridge", "check", "plant", "--launch", &launch, "--timeout", "30", "--yes"]);
    let (radio, check) = spawn_listening(place.radio("by hand"), check);
    let checked = check.finish();
    radio.signal(libc::SIGTERM);
    radio.finish().success();
    let said = said(&place.report);
    assert_eq!(checked.code(), 1, "{said:?}\n{}", checked.stderr);
    for words in [
        ["ok", "0 messages damaged, 0 lost"],
        ["WRONG", "roll: the sign is turned; set bridge.measured.roll.scale = -1"],
        ["ok", "pitch: +"],
        ["ok", "yaw: +"],
        ["not checked", "channel 1: whether it arrives, because CRSF brings no channels back"],
        ["not checked", "channels 1 and 2: which way the vehicle turns, because over CRSF"],
    ] {
        assert!(said.iter().any(|l| words.iter().all(|w| l.contains(w))), "{words:?}: {said:#?}");
    }
    assert_eq!(json(&place.report)["faults"], value!([]));
}

/// Latency of the telemetry, known to the law and the estimator.
const LATE: &str = r#"
[[effects]]
effect = "sensor_delay"
where = "roll"
delay_s = "100 ms"
[[effects]]
effect = "sensor_delay"
where = "pitch"
delay_s = "100 ms"
"#;

/// ExpressLRS with its default settings: an estimator that knows the delay and the low rate of the attitude recovers
/// the vehicle from a gust. Uncontrolled, the vehicle takes 8.7 s.
fn telemetry_of_4_and_of_10_hz_is_flown_on() {
    for every in [25, 10] {
        let place = Place::new();
        let vehicle = place.vehicle_file("quadrotor", LATE);
        let launch = place.launch_of(&vehicle, "stale_s = 1.0", "");
        let phases = value!([
            ["disarmed", {"arm": false, "automatic": true, "frames": 300}],
            ["flown", {"arm": null, "automatic": true}],
            ["flown", {"arm": true, "automatic": true, "gust": 30.0, "frames": 1000}],
        ]);
        let radio = spawn(place.vehicle(&phases, every, 10));
        let out = place.dir.path().join("out");
        let bench = spawn(whirlstand(["run", &launch, "--out", out.to_str().unwrap()]));
        radio.finish().success();
        bench.signal(libc::SIGINT);
        let end = bench.finish();
        let report = json(&place.report);
        assert_eq!(report["faults"], value!([]), "{}", end.stderr);
        let back = report["recovered_after_s"].as_f64();
        println!("an attitude every {every} periods: level after {back:?} s");
        assert!(back.is_some_and(|s| s < 5.0), "{back:?}\n{}", end.stderr);
        assert!(!end.stderr.contains("FAILSAFE"), "{}", end.stderr);
    }
}

/// CRSF telemetry has no angular rates: the bridge detects from the attitude alone that the vehicle rolls against its
/// commands, and sets the outputs to neutral.
fn a_vehicle_that_rolls_against_its_commands_is_noticed_by_its_attitude_alone() {
    for every in [2, 10, 25] {
        let place = Place::new();
        let vehicle = place.vehicle_file("quadrotor", "");
        let launch = place.launch_of(&vehicle, "stale_s = 1.0", "");
        let phases = value!([
            ["disarmed", {"arm": false, "automatic": true, "frames": 300}],
            ["flown", {"arm": null, "automatic": true}],
            ["neutral", {"arm": true, "automatic": true, "gust": 0.5}],
        ]);
        let radio = spawn(place.flying(&phases, &value!({"every": every, "late": 0, "turned": true})));
        let out = place.dir.path().join("out");
        let bench = spawn(whirlstand(["run", &launch, "--out", out.to_str().unwrap()]));
        radio.finish().success();
        bench.signal(libc::SIGINT);
        let end = bench.finish();
        assert_eq!(json(&place.report)["faults"], value!([]), "{}", end.stderr);
        for words in ["roll: the vehicle accelerates opposite to the command", "with the wrong sign"] {
            assert!(end.stderr.contains(words), "{words}: {}", end.stderr);
        }
    }
}

/// With the usual age limit, one lost attitude would end the flight: arming is refused, and the required rate is
/// reported.
fn telemetry_of_4_hz_is_refused_where_one_attitude_lost_would_end_the_flight() {
    let place = Place::new();
    let phases = value!([
        ["disarmed", {"arm": false, "automatic": true, "frames": 300}],
        ["refused", {"arm": null, "automatic": true}],
    ]);
    let radio = spawn(place.vehicle(&phases, 25, 10));
    let out = place.dir.path().join("out");
    // Just long enough that the age of the current attitude is not itself a reason.
    let launch = place.launch_of("quadrotor", "stale_s = 0.4", "");
    let bench = spawn(whirlstand(["run", &launch, "--out", out.to_str().unwrap()]));
    radio.finish().success();
    bench.signal(libc::SIGINT);
    let end = bench.finish();
    assert_eq!(json(&place.report)["faults"], value!([]), "{}", end.stderr);
    for words in
        ["the vehicle's attitude arrives too rarely", "bridge.safety.stale_s = 0.4 needs 5.0 or more"]
    {
        assert!(end.stderr.contains(words), "{words}: {}", end.stderr);
    }
}

/// A pilot takes over for part of a flight, in which the vehicle is also pushed: that part is not used for
/// identification or diagnosis, and this is reported. The controller's parts before and after it are sufficient.
fn what_a_pilot_flew_is_not_what_the_vehicle_is_identified_and_diagnosed_by() {
    let place = Place::new();
    let vehicle = place.vehicle_file("quadrotor", "");
    let structure = place.vehicle_file("quadrotor-structure", "");
    let launch = place.launch_of(&vehicle, "stale_s = 1.0", &setpoints());
    let phases = value!([
        ["disarmed", {"arm": false, "automatic": true}],
        ["flown", {"arm": null, "automatic": true, "frames": 1500}],
        ["manual", {"arm": true, "automatic": false, "roll": 1700, "push": 60.0, "frames": 500}],
        ["flown", {"arm": true, "automatic": true, "frames": 1500}],
    ]);
    let radio = spawn(place.vehicle(&phases, 1, 0));
    let out = place.dir.path().join("out");
    let out = out.to_str().unwrap();
    let bench = spawn(whirlstand(["run", &launch, "--out", out]));
    radio.finish().success();
    bench.signal(libc::SIGINT);
    let end = bench.finish();
    assert_eq!(json(&place.report)["faults"], value!([]), "{}", end.stderr);

    what_the_controller_flew_alone_is_learned_from(out, &vehicle, &structure);
}

whirlstand_test_harness::listed!(
    the_pilot_arms_takes_over_and_a_lost_link_is_neutral,
    the_check_says_which_axis_of_the_telemetry_is_turned,
    telemetry_of_4_and_of_10_hz_is_flown_on,
    a_vehicle_that_rolls_against_its_commands_is_noticed_by_its_attitude_alone,
    telemetry_of_4_hz_is_refused_where_one_attitude_lost_would_end_the_flight,
    what_a_pilot_flew_is_not_what_the_vehicle_is_identified_and_diagnosed_by,
);
