//! A flight in which something changes, with the mirror beside it: whole processes.

mod support;

use std::path::Path;

use support::{json, refused, run};
use tempfile::TempDir;

/// A sensor that is off by 1 deg from 8 s on, which only the plant knows.
const BIASED: &str = r#"
vehicle = "quadrotor"
mode = "lockstep"
duration_s = 20
controller.law = "lqr"

[[effects]]
effect = "sensor_bias"
where = "pitch"
offset = "1 deg"
from_s = 8.0
"#;

fn fly(folder: &Path, name: &str, text: &str) -> (String, String) {
    let launch = folder.join(format!("{name}.toml"));
    std::fs::write(&launch, text).unwrap();
    let out = folder.join(name).display().to_string();
    let ran = run(["run", launch.to_str().unwrap(), "--out", &out]).success();
    (out, format!("{}{}", ran.stdout, ran.stderr))
}

#[test]
fn what_changes_in_flight_is_named_and_the_loop_does_not_notice() {
    let dir = TempDir::new().unwrap();
    let (out, said) = fly(dir.path(), "watched", &format!("{BIASED}\n[mirror]\n"));
    let findings = json(format!("{out}/summary.json"))["runs"][0]["findings"].clone();
    let findings = findings.as_array().unwrap_or_else(|| panic!("nothing was found: {said}"));
    let first = findings[0]["at_s"].as_f64().unwrap();
    assert!((8.0..8.5).contains(&first), "{findings:?}");
    let last = findings.last().unwrap()["text"].as_str().unwrap();
    assert!(last.contains("sensor_bias on pitch: offset"), "{findings:?}");
    assert!(said.contains("mirror") && said.contains(last), "the terminal tells it too: {said}");
    let page = std::fs::read_to_string(format!("{out}/report.html")).unwrap();
    assert!(page.contains(last), "and so does the report");
    let info = run(["log", "info", &out]).success().stdout;
    assert!(info.lines().any(|line| line.contains("/finding")), "{info}");

    let (alone, _) = fly(dir.path(), "alone", BIASED);
    let diff = run(["log", "diff", &out, &alone]).stdout;
    for topic in ["/command", "/disturbance", "/estimate", "/imu", "/setpoint", "/truth"] {
        let line =
            diff.lines().find(|line| line.contains(topic)).unwrap_or_else(|| panic!("{topic}: {diff}"));
        assert!(line.contains("same"), "{line}");
    }
}

#[test]
fn a_flight_as_the_file_says_has_no_finding() {
    let dir = TempDir::new().unwrap();
    let plain = BIASED.split("[[effects]]").next().unwrap();
    let gust = "[[effects]]\neffect = \"pulse_disturbance\"\nwhere = \"roll_rate\"\nat_s = 5.0\nduration_s = 0.2\n\
                magnitude = \"60 deg/s^2\"\n";
    let (out, said) = fly(dir.path(), "clean", &format!("{plain}\n[mirror]\n\n{gust}"));
    assert!(json(format!("{out}/summary.json"))["runs"][0]["findings"].is_null(), "{said}");
}

#[test]
fn a_law_in_flight_is_refused_with_a_sentence() {
    let dir = TempDir::new().unwrap();
    let launch = dir.path().join("law.toml");
    std::fs::write(&launch, format!("{BIASED}\n[mirror]\non_finding = \"law\"\n")).unwrap();
    refused(&["run", launch.to_str().unwrap()], &["law.toml, line", "a law is not changed in flight yet"]);
}

#[test]
fn what_the_mirror_is_worth_is_measured_by_a_command() {
    let call =
        ["bench", "mirror", "--trials", "2", "--clean", "0.02", "--effects", "bias,delay", "--seed", "3"];
    let flown = run(call).success().stdout;
    assert!(flown.contains("all goals are met") && flown.contains("0 false alarms in 0.02 h"), "{flown}");
    // The same flights, however many at a time, say the same.
    let one = run(call.into_iter().chain(["--jobs", "1", "--json"])).success().stdout;
    let tally: serde_json::Value = serde_json::from_str(&one).unwrap();
    assert_eq!(tally["schema"], "whirlstand.bench-mirror.v1");
    let all = tally["effects"].as_array().unwrap().last().unwrap();
    assert_eq!((&all["effect"], &all["flights"], &all["detected"]), (&"all".into(), &4.into(), &4.into()));
    assert_eq!(tally["trials"][3]["what"], "delay", "{tally}");
    refused(&["bench", "mirror", "--effects", "flutter"], &["flutter", "stuck-sensor"]);
}
