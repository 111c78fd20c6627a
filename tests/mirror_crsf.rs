//! The mirror with a vehicle behind CRSF: a transmitter module on a pseudo-terminal, with a vehicle behind it.

use crate::support::bridged::setpoints;
use crate::support::mirrored::half_of_the_input_is_named;
use crate::support::radio::Place;
use crate::support::{json, spawn, whirlstand};
use serde_json::json as value;

/// CRSF reports only the attitude, rounded, here 50 times a second.
fn half_of_an_input_that_a_vehicle_behind_crsf_loses_is_named() {
    let place = Place::new();
    let vehicle = place.vehicle_file("quadrotor", "");
    let launch = place.launch_of(&vehicle, "stale_s = 1.0", &format!("[mirror]\n{}", setpoints()));
    let phases = value!([
        ["disarmed", {"arm": false, "automatic": true}],
        ["flown", {"arm": null, "automatic": true, "frames": 2500}],
        ["flown", {"arm": true, "automatic": true, "effective": 0.5, "frames": 9000}],
    ]);
    let _radio = spawn(place.flying(&phases, &value!({"every": 2, "late": 1, "noise": 1e-3})));
    let out = place.dir.path().join("out");
    let mut bench = spawn(whirlstand(["run", &launch, "--out", out.to_str().unwrap()]));
    bench.wait_for_stderr("input_gain on u_roll: factor ");
    bench.signal(libc::SIGINT);
    let ended = bench.finish();
    let summary = json(out.join("summary.json"));
    let findings = summary["runs"][0]["findings"].as_array().unwrap();
    println!("{findings:?}");
    half_of_the_input_is_named(findings, 20.0, &ended.stderr);
}

whirlstand_test_harness::listed!(half_of_an_input_that_a_vehicle_behind_crsf_loses_is_named);
