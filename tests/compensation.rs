//! The benefit of a launch file's `compensate` in a whole flight, and the warnings about effects that it leaves
//! uncompensated.

use std::fmt::Write as _;
use std::path::Path;

use crate::support::{json, run};

/// Flies the quadrotor with an effect through a slow sine of roll; returns the RMS error of roll and the output.
fn fly(folder: &Path, name: &str, effect: &str, compensate: &str) -> (f64, String) {
    let plain = run(["vehicle", "show", "quadrotor"]).success().stdout;
    std::fs::write(folder.join("vehicle.toml"), format!("{plain}\n[[effects]]\n{effect}\n")).unwrap();
    let mut launch = format!(
        "vehicle = 'vehicle.toml'\nmode = 'lockstep'\nduration_s = 16.0\n\
         controller = {{ law = 'lqr', integral = ['roll'], compensate = [{compensate}] }}\n"
    );
    for k in 0..320 {
        let at_s = 0.05 * f64::from(k);
        let roll = 0.01 * (std::f64::consts::TAU * at_s / 8.0).sin();
        writeln!(launch, "[[setpoint]]\nat_s = {at_s:.2}\nroll = '{roll:.6} rad'").unwrap();
    }
    let path = folder.join(format!("{name}.toml"));
    std::fs::write(&path, launch).unwrap();
    let out = folder.join(name);
    let finished = run(["run", path.to_str().unwrap(), "--out", out.to_str().unwrap()]).success();
    let run = json(out.join("summary.json"))["runs"][0].clone();
    (run["outputs"]["roll"]["rms_error"].as_f64().unwrap(), finished.stdout + &finished.stderr)
}

fn every_compensation_is_worth_something_in_a_flight() {
    let folder = tempfile::tempdir().unwrap();
    for (name, effect) in [
        ("dead_zone", "where = 'u_roll'\nwidth = 1.0"),
        ("backlash", "where = 'u_roll'\nwidth = 3.0"),
        ("coulomb_friction", "where = 'roll_rate'\nlevel = '0.01 rad/s^2'"),
        ("input_saturation", "where = 'u_roll'\nlower = -0.3\nupper = 0.3"),
        ("rate_limit", "where = 'u_roll'\nlimit_per_s = 0.4"),
        ("gain_drift", "where = 'u_roll'\nrate_per_s = -0.03"),
    ] {
        let effect = format!("effect = '{name}'\n{effect}");
        let (without, told) = fly(folder.path(), &format!("{name}-without"), &effect, "");
        assert!(!told.contains("not compensated"), "{told}");
        let (with, told) = fly(folder.path(), name, &effect, &format!("'{name}'"));
        println!("{name}: rms error {without:.5} -> {with:.5} rad");
        assert!(with < 0.99 * without, "{name}: {without} -> {with}");
        assert!(!told.contains("not compensated"), "{told}");
    }
}

fn what_is_unsafe_is_off_with_a_warning_and_the_flight_is_that_without() {
    let folder = tempfile::tempdir().unwrap();
    let effect = "effect = 'dead_zone'\nwhere = 'u_roll'\nwidth = 20.0";
    let (without, _) = fly(folder.path(), "without", effect, "");
    let (with, told) = fly(folder.path(), "with", effect, "'dead_zone'");
    assert_eq!(without, with);
    assert!(told.contains("dead_zone of u_roll is not compensated: it leaves the input no room"), "{told}");
    let vehicle = folder.path().join("vehicle.toml");
    let design = |compensate: &str| {
        let set = format!("compensate={compensate}");
        run(["design", vehicle.to_str().unwrap(), "--law", "lqr", "--set", &set]).success().stdout
    };
    assert!(design("[]").contains("not used: dead_zone of u_roll: it is not linear"));
    assert!(design("['dead_zone']").contains("not used: dead_zone of u_roll: it leaves the input no room"));
    let narrow = std::fs::read_to_string(&vehicle).unwrap().replace("width = 20.0", "width = 1.0");
    std::fs::write(&vehicle, narrow).unwrap();
    assert!(!design("['dead_zone']").contains("not used"));
}

whirlstand_test_harness::listed!(
    every_compensation_is_worth_something_in_a_flight,
    what_is_unsafe_is_off_with_a_warning_and_the_flight_is_that_without,
);
