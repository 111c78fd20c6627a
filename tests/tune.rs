//! The circle: a flight with a hidden delay, its diagnosis, a law that knows of it, and the flight again.

mod support;

use std::path::Path;
use std::time::Duration;

use serde_json::Value;
use support::{Finished, json, refused, run, spawn, whirlstand};

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// The quadrotor under LQR, steps of the setpoint and a gust; law and filter do not know of the delay.
const LAUNCH: &str = "vehicle = 'quadrotor'\nmode = 'lockstep'\nrate_hz = 100.0\nduration_s = 24.0\n\
    [controller]\nlaw = 'lqr'\n\
    [[setpoint]]\nat_s = 1.0\nroll = '8 deg'\n[[setpoint]]\nat_s = 5.0\nroll = '-8 deg'\npitch = '5 deg'\n\
    [[setpoint]]\nat_s = 9.0\nroll = 0.0\npitch = 0.0\n[[setpoint]]\nat_s = 13.0\nroll = '8 deg'\n\
    [[setpoint]]\nat_s = 16.0\nroll = 0.0\npitch = '-5 deg'\n\
    [[effects]]\neffect = 'input_delay'\nwhere = 'u_roll'\ndelay_s = 0.3\n\
    [[effects]]\neffect = 'pulse_disturbance'\nwhere = 'roll_rate'\nat_s = 20.0\nduration_s = 0.2\nmagnitude = '60 deg/s^2'\n";

fn fly(launch: &Path, out: &Path) -> Value {
    run(["run", text(launch), "--out", text(out)]).success();
    json(out.join("summary.json"))["runs"][0]["outputs"]["roll"].clone()
}

/// A diagnosis takes its time on a busy machine; one that hangs is still ended.
fn tune(args: &[&str]) -> Finished {
    spawn(whirlstand(args)).finish_within(Duration::from_secs(900)).success()
}

#[test]
fn a_hidden_delay_is_found_designed_for_and_flown_better() {
    let folder = tempfile::tempdir().unwrap();
    let (launch, tuned) = (folder.path().join("late.toml"), folder.path().join("tuned"));
    std::fs::write(&launch, LAUNCH).unwrap();
    let before = fly(&launch, &folder.path().join("before"));
    let log = folder.path().join("before");
    let args = [
        "tune",
        text(&log),
        "--launch",
        text(&launch),
        "--draws",
        "40",
        "--out",
        text(&tuned),
        "--json",
        "-",
    ];
    let answer: Value = serde_json::from_str(&tune(&args).stdout).unwrap();
    println!("{}\n{}", answer["causes"], answer["gain"]);
    assert_eq!(answer["schema"], "whirlstand.tune.v1");
    let causes = answer["causes"].as_array().unwrap();
    assert!(causes.iter().any(|c| c["effect"] == "input_delay" && c["where"] == "u_roll"), "{causes:?}");
    assert_eq!(answer["gain"]["certain"], true, "{}", answer["gain"]);
    assert!(tuned.join("report.html").is_file());
    let after = fly(&tuned.join("tuned.toml"), &folder.path().join("after"));
    // After the gust the blind law rings; the one that knows of the delay comes to rest.
    let left = |figures: &Value| figures["disturbances"][0]["iae"].as_f64().unwrap();
    println!("roll after the gust, IAE {:.4} -> {:.4} rad s", left(&before), left(&after));
    assert!(left(&after) < left(&before), "{before} {after}");
}

#[test]
fn a_flight_as_simulated_keeps_its_law() {
    let folder = tempfile::tempdir().unwrap();
    let (launch, tuned) = (folder.path().join("plain.toml"), folder.path().join("tuned"));
    let plain = LAUNCH.replace("[[effects]]\neffect = 'input_delay'\nwhere = 'u_roll'\ndelay_s = 0.3\n", "");
    std::fs::write(&launch, plain).unwrap();
    let log = folder.path().join("flight");
    fly(&launch, &log);
    let args = ["tune", text(&log), "--launch", text(&launch), "--draws", "20", "--out", text(&tuned)];
    let told = tune(&args).stdout;
    assert!(told.contains("The old law is kept: the diagnosis found nothing"), "{told}");
    let kept = std::fs::read_to_string(tuned.join("tuned.toml")).unwrap();
    assert!(kept.contains("law = \"lqr\"") && !kept.contains("model"), "{kept}");
    refused(
        &["tune", text(&log), "--launch", text(&launch), "--draws", "3", "--out", text(&tuned)],
        &["--draws 3"],
    );
}
