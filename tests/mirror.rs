//! Flights as whole processes in which something changes, monitored by the mirror.

use std::path::Path;

use crate::support::{json, refused, run};
use tempfile::TempDir;

/// A sensor bias of 1 deg from 8 s on, which only the plant knows.
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

fn a_flight_as_the_file_says_has_no_finding() {
    let dir = TempDir::new().unwrap();
    let plain = BIASED.split("[[effects]]").next().unwrap();
    let gust = "[[effects]]\neffect = \"pulse_disturbance\"\nwhere = \"roll_rate\"\nat_s = 5.0\nduration_s = 0.2\n\
                magnitude = \"60 deg/s^2\"\n";
    let (out, said) = fly(dir.path(), "clean", &format!("{plain}\n[mirror]\n\n{gust}"));
    assert!(json(format!("{out}/summary.json"))["runs"][0]["findings"].is_null(), "{said}");
}

/// Launch file with a delay of an input from 8 s on, in turbulence and with setpoint steps.
const LATE: &str = r#"
vehicle = "quadrotor"
mode = "lockstep"
duration_s = 50
controller.law = "lqr"

[[effects]]
effect = "input_delay"
where = "u_roll"
delay_s = "200 ms"
from_s = 8.0

[[effects]]
effect = "turbulence"
where = "roll_rate"
std = "4 deg/s^2"
bandwidth_hz = 1.0
"#;

/// Setpoint steps of roll every two seconds: time in s, and roll in deg.
fn setpoints() -> impl Iterator<Item = (f64, f64)> {
    (1..25u32).map(|k| (2.0 * f64::from(k), [0.0, 5.0, -5.0][k as usize % 3]))
}

/// Time, roll in rad, and the input that acts on roll, from the log.
fn flown(out: &str) -> Vec<[f64; 3]> {
    let csv = format!("{out}.csv");
    run(["log", "export", out, "--output", &csv]).success();
    let text = std::fs::read_to_string(csv).unwrap();
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let at = |name: &str| {
        let found = names.iter().position(|n| n.trim_matches('"').split(['[', ' ']).next() == Some(name));
        found.unwrap_or_else(|| panic!("{name} is not in {names:?}"))
    };
    let places = [0, at("roll"), at("u_roll")];
    let read = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        places.map(|i| cells[i].parse::<f64>().unwrap_or(f64::NAN))
    };
    lines.map(read).filter(|row: &[f64; 3]| row.iter().all(|v| v.is_finite())).collect()
}

fn the_law_for_what_was_found_takes_over_in_flight_without_a_bump_and_flies_better() {
    let dir = TempDir::new().unwrap();
    let steps = setpoints().map(|(at, roll)| format!("[[setpoint]]\nat_s = {at}\nroll = \"{roll} deg\"\n"));
    let launch = LATE.to_string() + &steps.collect::<String>();
    let (told, _) = fly(dir.path(), "told", &format!("{launch}\n[mirror]\n"));
    let (out, said) = fly(dir.path(), "law", &format!("{launch}\n[mirror]\non_finding = \"law\"\n"));
    assert!(said.contains("the law that the mirror asked for is active"), "{said}");
    let findings = json(format!("{out}/summary.json"))["runs"][0]["findings"].clone();
    let law = findings
        .as_array()
        .unwrap()
        .iter()
        .find(|f| f["text"].as_str().unwrap().starts_with("switched to the law for"));
    let law = law.unwrap_or_else(|| panic!("no law: {findings:?}"));
    let text = law["text"].as_str().unwrap();
    assert!(text.contains("input_delay on u_roll: delay_s 0.") && text.contains("its cost is"), "{text}");
    let at = law["at_s"].as_f64().unwrap();
    assert!((8.5..20.0).contains(&at), "asked for at {at} s");
    let [with, without] = [flown(&out), flown(&told)];
    let cost = |rows: &[[f64; 3]]| {
        let late = rows.iter().filter(|[t, ..]| *t > 22.0);
        let (sum, count) = late.fold((0.0, 0), |(sum, n), [t, roll, u]| {
            let wanted = setpoints().take_while(|(at, _)| at <= t).last().map_or(0.0, |(_, roll)| roll);
            (sum + ((roll.to_degrees() - wanted) / 2.0).powi(2) + (u / 20.0).powi(2), n + 1)
        });
        sum / f64::from(count)
    };
    let (with_law, told_only) = (cost(&with), cost(&without));
    println!(
        "asked for at {at} s; mean square from 22 s on: {told_only:.4} told, {with_law:.4} with the law"
    );
    assert!(with_law < 0.97 * told_only, "{told_only} {with_law}");
    // Around the switch the command's step-to-step changes are of the same size as before.
    let largest = |from: f64, to: f64| {
        let pairs = with.windows(2).filter(|p| p[1][0] > from && p[1][0] < to);
        pairs.map(|p| (p[1][2] - p[0][2]).abs()).fold(0.0, f64::max)
    };
    let (before, around) = (largest(at - 3.0, at), largest(at, at + 1.5));
    assert!(around < 2.0 * before, "{around} after {before}");
    let again = fly(dir.path(), "again", &format!("{launch}\n[mirror]\non_finding = \"law\"\n")).0;
    run(["log", "diff", &out, &again]).success();
}

fn what_the_mirror_is_worth_is_measured_by_a_command() {
    let call =
        ["bench", "mirror", "--trials", "2", "--clean", "0.02", "--effects", "bias,delay", "--seed", "3"];
    let flown = run(call).success().stdout;
    assert!(flown.contains("all goals are met") && flown.contains("0 false alarms in 0.02 h"), "{flown}");
    // The same flights give the same results, however many are flown at a time.
    let one = run(call.into_iter().chain(["--jobs", "1", "--json"])).success().stdout;
    let tally: serde_json::Value = serde_json::from_str(&one).unwrap();
    assert_eq!(tally["schema"], "whirlstand.bench-mirror.v1");
    let all = tally["effects"].as_array().unwrap().last().unwrap();
    assert_eq!((&all["effect"], &all["flights"], &all["detected"]), (&"all".into(), &4.into(), &4.into()));
    assert_eq!(tally["trials"][3]["what"], "delay", "{tally}");
    refused(&["bench", "mirror", "--effects", "flutter"], &["flutter", "stuck-sensor"]);
}

whirlstand_test_harness::listed!(
    what_changes_in_flight_is_named_and_the_loop_does_not_notice,
    a_flight_as_the_file_says_has_no_finding,
    the_law_for_what_was_found_takes_over_in_flight_without_a_bump_and_flies_better,
    what_the_mirror_is_worth_is_measured_by_a_command,
);
