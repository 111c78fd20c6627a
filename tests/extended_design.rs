//! The effects that the vehicle file declares are used in the law, the estimator and the flight.

use std::path::{Path, PathBuf};

use crate::support::{json, refused, run};
use serde_json::Value;

const LATE: &str = "\n[[effects]]\neffect = 'input_delay'\nwhere = 'u_roll'\ndelay_s = 0.12\n";

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// The quadrotor's file, and the same with 120 ms of delay on an input.
fn vehicles(folder: &Path) -> [PathBuf; 2] {
    let plain = run(["vehicle", "show", "quadrotor"]).success().stdout;
    [("plain.toml", plain.clone()), ("late.toml", plain + LATE)].map(|(name, text)| {
        let path = folder.join(name);
        std::fs::write(&path, text).unwrap();
        path
    })
}

fn design(vehicle: &Path, law: &str) -> Value {
    let answer = run(["design", text(vehicle), "--law", law, "--json"]).success().stdout;
    serde_json::from_str(&answer).unwrap()
}

fn a_delay_in_the_file_changes_gains_margins_and_poles() {
    let folder = tempfile::tempdir().unwrap();
    let [plain, late] = vehicles(folder.path());
    for law in ["lqr", "ppc", "smc"] {
        let (before, after) = (design(&plain, law), design(&late, law));
        assert_eq!(before["with_estimator"]["loop_margins"].as_array().unwrap().len(), 2, "{law}");
        assert_ne!(before["loop_margins"], after["loop_margins"], "{law}");
        let poles = |design: &Value| design["closed_loop_poles"].as_array().unwrap().len();
        // A delay of 24 periods adds 24 past commands as states.
        assert_eq!(poles(&after), poles(&before) + 24, "{law}");
        assert_eq!(after["plant"]["memory_names"].as_array().unwrap().len(), 24, "{law}");
        assert!(after["with_estimator"]["spectral_radius"].as_f64().unwrap() < 1.0, "{law}");
    }
    let told = run(["design", text(&late), "--law", "lqr"]).success().stdout;
    assert!(told.contains("late inputs: u_roll 120 ms"), "{told}");
    let mut dead = std::fs::read_to_string(&plain).unwrap();
    dead.push_str("\n[[effects]]\neffect = 'dead_zone'\nwhere = 'u_roll'\nwidth = 0.1\n");
    std::fs::write(&plain, dead).unwrap();
    let told = run(["design", text(&plain), "--law", "lqr"]).success().stdout;
    assert!(told.contains("not used: dead_zone of u_roll: it is not linear"), "{told}");
}

/// Flies the delayed vehicle through a gust with law and estimator designed for `model`; returns the figures of the
/// run.
fn fly(folder: &Path, law: &str, model: &str) -> Value {
    let launch = folder.join(format!("{law}-{model}.toml"));
    std::fs::write(
        &launch,
        format!(
            "vehicle = 'late.toml'\nmodel = '{model}.toml'\nmode = 'lockstep'\nduration_s = 8.0\n\
             controller.law = '{law}'\n[[effects]]\neffect = 'pulse_disturbance'\nwhere = 'roll_rate'\nat_s = 2.0\n\
             duration_s = 0.2\nmagnitude = '60 deg/s^2'\n"
        ),
    )
    .unwrap();
    let out = folder.join(format!("{law}-{model}"));
    run(["run", text(&launch), "--out", text(&out)]).success();
    json(out.join("summary.json"))["runs"][0].clone()
}

/// Sum of the mean squares of roll and of its input, each divided by its scale, as the regulator weights them.
fn cost(run: &Value, roll_scale: f64) -> f64 {
    let roll = run["outputs"]["roll"]["rms_error"].as_f64().unwrap() / roll_scale;
    let input = run["inputs"]["u_roll"]["rms"].as_f64().unwrap() / 20.0;
    roll * roll + input * input
}

fn a_law_designed_for_the_delay_flies_through_the_gust_at_less_cost() {
    let folder = tempfile::tempdir().unwrap();
    let [plain, _] = vehicles(folder.path());
    let scale = design(&plain, "lqr")["plant"]["scales"][0].as_f64().unwrap();
    for law in ["lqr", "smc"] {
        let (blind, knowing) = (fly(folder.path(), law, "plain"), fly(folder.path(), law, "late"));
        let (before, after) = (cost(&blind, scale), cost(&knowing, scale));
        println!("{law}: cost {before:.3} -> {after:.3}");
        // Sliding mode is not designed for this cost; knowledge of the delay must not make it more expensive.
        assert!(after < before || law == "smc" && after < 1.05 * before, "{law}: {before} {after}");
    }
}

fn a_delay_that_a_blind_law_cannot_hold_is_held() {
    let folder = tempfile::tempdir().unwrap();
    vehicles(folder.path());
    let late = folder.path().join("late.toml");
    let longer = std::fs::read_to_string(&late).unwrap().replace("delay_s = 0.12", "delay_s = 0.4");
    std::fs::write(&late, longer).unwrap();
    let (blind, knowing) = (fly(folder.path(), "lqr", "plain"), fly(folder.path(), "lqr", "late"));
    let recovered = |run: &Value| run["outputs"]["roll"]["recovered"].clone();
    assert_eq!((recovered(&blind), recovered(&knowing)), (false.into(), true.into()));
}

fn a_law_designed_for_a_lag_and_a_mode_flies_them() {
    let folder = tempfile::tempdir().unwrap();
    let [plain, late] = vehicles(folder.path());
    let scale = design(&plain, "lqr")["plant"]["scales"][0].as_f64().unwrap();
    let text = std::fs::read_to_string(&plain).unwrap();
    for effect in [
        "effect = 'actuator_lag'\nwhere = 'u_roll'\ntime_constant_s = 0.4\n",
        "effect = 'unmodelled_mode'\nwhere = 'u_roll'\nfrequency_hz = 1.0\ndamping_ratio = 0.2\n",
    ] {
        std::fs::write(&late, format!("{text}\n[[effects]]\n{effect}")).unwrap();
        let (blind, knowing) = (fly(folder.path(), "lqr", "plain"), fly(folder.path(), "lqr", "late"));
        let (before, after) = (cost(&blind, scale), cost(&knowing, scale));
        println!("{effect}: cost {before:.3} -> {after:.3}");
        assert!(after < before, "{effect}: {before} {after}");
    }
}

fn a_model_with_other_signals_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let launch = folder.path().join("wrong.toml");
    std::fs::write(&launch, "vehicle = 'quadrotor'\nmodel = 'helicopter-hover'\ncontroller.law = 'lqr'\n")
        .unwrap();
    refused(
        &["run", text(&launch)],
        &["line 2", "states of helicopter-hover are not those of the vehicle quadrotor"],
    );
}

whirlstand_test_harness::listed!(
    a_delay_in_the_file_changes_gains_margins_and_poles,
    a_law_designed_for_the_delay_flies_through_the_gust_at_less_cost,
    a_delay_that_a_blind_law_cannot_hold_is_held,
    a_law_designed_for_a_lag_and_a_mode_flies_them,
    a_model_with_other_signals_is_refused,
);
