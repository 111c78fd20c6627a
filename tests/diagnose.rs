//! The complete workflow with processes: a flight with a hidden fault is flown, logged and diagnosed; the vehicle
//! extended by the named cause flies again, and its record matches the first one.

use std::path::Path;

use crate::support::{json, run, spawn, whirlstand};

/// Writes the built-in quadrotor as a file, followed by `more`; returns its path.
fn quadrotor(dir: &Path, name: &str, more: &str) -> String {
    let shown = run(["vehicle", "show", "quadrotor"]).success().stdout;
    let path = dir.join(name);
    std::fs::write(&path, format!("{shown}\n{more}")).unwrap();
    path.display().to_string()
}

/// Flies a vehicle through the designed test as a bench of processes, in lockstep, with sensor noise; returns the log.
fn flown(dir: &Path, vehicle: &str, name: &str) -> String {
    let (design, log) = (dir.join(format!("{name}-design")), dir.join(format!("{name}-log")));
    let (design, log) = (design.display().to_string(), log.display().to_string());
    let kind = ["--kind", "multistep", "--duration", "40", "--seed", "5"];
    run(["excite", vehicle].into_iter().chain(kind).chain(["--out", &design])).success();
    let launch = format!("{design}/flight.toml");
    run(["run", &launch, "--mode", "lockstep", "--out", &log]).success();
    log
}

fn diagnosed(dir: &Path, log: &str, vehicle: &str, name: &str) -> (serde_json::Value, String, String) {
    let (answer, out) = (dir.join(format!("{name}.json")), dir.join(name));
    let (path, out) = (answer.display().to_string(), out.display().to_string());
    let finished = run(["diagnose", log, "--vehicle", vehicle, "--json", &path, "--out", &out]).success();
    (json(answer), finished.stdout, out)
}

fn a_hidden_delay_is_named_and_the_extended_vehicle_flies_the_same() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let truth = quadrotor(
        dir,
        "truth.toml",
        "[[effects]]\neffect = \"input_delay\"\nwhere = \"u_roll\"\ndelay_s = 0.06\n",
    );
    let log = flown(dir, &truth, "measured");
    // What a bench records was held between its samples, whatever the vehicle says of other records.
    let straight = quadrotor(dir, "straight.toml", "");
    let shown = std::fs::read_to_string(&straight).unwrap();
    let of_input = "name = \"u_roll\", lower";
    assert!(shown.contains(of_input), "{shown}");
    let foh = "name = \"u_roll\", intersample = \"foh\", lower";
    std::fs::write(&straight, shown.replace(of_input, foh)).unwrap();
    let simulated = |vehicle: &str, name: &str| {
        let csv = dir.join(name).display().to_string();
        run(["simulate", vehicle, "--input", &log, "--output", &csv]).success();
        std::fs::read_to_string(csv).unwrap()
    };
    assert_eq!(simulated(&straight, "straight.csv"), simulated("quadrotor", "held.csv"));
    let (answer, text, out) = diagnosed(dir, &log, "quadrotor", "first");
    assert_eq!(answer["schema"], "whirlstand.diagnosis.v1", "{text}");
    assert_eq!(answer["verdict"], "explained", "{text}");
    let causes = answer["causes"].as_array().unwrap();
    assert_eq!(causes.len(), 1, "{text}");
    assert_eq!(
        (&causes[0]["effect"], &causes[0]["where"]),
        (&"input_delay".into(), &"u_roll".into()),
        "{text}"
    );
    let delay = causes[0]["parameters"]["delay_s"]["value"].as_f64().unwrap();
    assert!((delay - 0.06).abs() < 0.005, "{delay} s, in truth 0.06 s\n{text}");
    assert_eq!(causes[0]["parameters"]["delay_s"]["unit"], "s");
    assert!(text.contains("delay_s 0.0") && text.contains(" s)."), "{text}");
    assert!(text.lines().count() <= 15, "{text}");
    let report = std::fs::read_to_string(format!("{out}/report.html")).unwrap();
    assert!(
        report.contains("input_delay") && !report.contains("<script src") && !report.contains("<link"),
        "it must open without a network"
    );

    // The extended vehicle runs unchanged, and the diagnosis finds it consistent with the measured one.
    let extended = format!("{out}/vehicle.toml");
    let again = flown(dir, &extended, "simulated");
    let (answer, text, _) = diagnosed(dir, &again, &truth, "second");
    assert_eq!(answer["verdict"], "consistent", "{text}");
    let (answer, text, _) = diagnosed(dir, &log, &extended, "third");
    assert_eq!(answer["verdict"], "consistent", "{text}");
}

fn ctrl_c_ends_a_diagnosis_with_what_is_known() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let late = "[[effects]]\neffect = \"input_delay\"\nwhere = \"u_roll\"\ndelay_s = 0.06\n";
    let truth = quadrotor(dir, "truth.toml", late);
    let log = flown(dir, &truth, "measured");
    let path = dir.join("answer.json");
    let diagnosis =
        spawn(whirlstand(["diagnose", &log, "--vehicle", "quadrotor", "--json", path.to_str().unwrap()]));
    diagnosis.wait_for_handlers();
    diagnosis.signal(libc::SIGINT);
    let ended = diagnosis.finish();
    assert_eq!(ended.code(), 130, "{}\n{}", ended.stdout, ended.stderr);
    assert!(ended.stderr.contains("interrupted"), "{}", ended.stderr);
    let answer = json(&path);
    assert!(answer["remarks"].to_string().contains("ended early"), "{answer}");
    assert_eq!(answer["partial"], true, "{answer}");
    assert!(ended.stdout.starts_with("Partial"), "{}", ended.stdout);
    assert!(answer["outputs"]["roll"]["rmse_before"].is_number(), "{answer}");
}

fn a_budget_of_time_ends_a_diagnosis_with_what_is_known() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let late = "[[effects]]\neffect = \"input_delay\"\nwhere = \"u_roll\"\ndelay_s = 0.06\n";
    let truth = quadrotor(dir, "truth.toml", late);
    let log = flown(dir, &truth, "measured");
    let (path, out) = (dir.join("answer.json"), dir.join("out").display().to_string());
    let call = ["diagnose", &log, "--vehicle", "quadrotor", "--json", path.to_str().unwrap(), "--out", &out];
    let ended = run(call.into_iter().chain(["--budget", "1 ms"]));
    assert_eq!(ended.code(), 3, "{}\n{}", ended.stdout, ended.stderr);
    assert!(ended.stdout.starts_with("Partial") && ended.stderr.contains("budget"), "{}", ended.stderr);
    let answer = json(&path);
    assert_eq!((&answer["partial"], &answer["verdict"]), (&true.into(), &"inconclusive".into()), "{answer}");
    assert!(answer["outputs"]["roll"]["rmse_before"].is_number(), "{answer}");
    let report = std::fs::read_to_string(format!("{out}/report.html")).unwrap();
    assert!(report.contains("Partial, as the search was ended early"));
    // With enough time, it is complete.
    let whole = run(call.into_iter().chain(["--budget", "10 min"])).success();
    assert!(whole.stdout.starts_with("Explained"), "{}", whole.stdout);
    let wrong = run(call.into_iter().chain(["--budget", "5 m"]));
    assert_eq!(wrong.code(), 2, "{}", wrong.stderr);
}

/// A table in which the values of these columns are multiplied by `factor`; the units in its header are unchanged.
fn scaled(table: &str, columns: &[&str], factor: f64) -> String {
    let head = table.lines().next().unwrap();
    let name = |column: &str| column.split('[').next().unwrap().to_string();
    let meant: Vec<bool> = head.split(',').map(|c| columns.contains(&name(c).as_str())).collect();
    assert_eq!(meant.iter().filter(|m| **m).count(), columns.len(), "{columns:?} of {head}");
    let row = |line: &str| {
        let value = |(cell, meant): (&str, &bool)| match cell.parse::<f64>() {
            Ok(v) if *meant => (v * factor).to_string(),
            _ => cell.to_string(),
        };
        line.split(',').zip(&meant).map(value).collect::<Vec<_>>().join(",")
    };
    table.lines().map(row).collect::<Vec<_>>().join("\n")
}

/// A flight of the quadrotor as a table with a header.
fn table(dir: &Path) -> String {
    let log = flown(dir, "quadrotor", "measured");
    let csv = dir.join("measured.csv");
    run(["log", "export", &log, "-o", csv.to_str().unwrap()]).success();
    std::fs::read_to_string(csv).unwrap()
}

fn degrees_read_as_radians_are_told_by_diagnose_and_compare() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    // The header declares radians for values in degrees.
    let degrees = scaled(&table(dir), &["roll", "roll_rate", "pitch", "pitch_rate"], 1f64.to_degrees());
    assert!(degrees.starts_with("t[s],roll[rad],roll_rate[rad/s],pitch[rad],pitch_rate[rad/s]"));
    let csv = dir.join("flight.csv");
    let csv = csv.to_str().unwrap();
    std::fs::write(csv, degrees).unwrap();
    for command in ["diagnose", "compare"] {
        let told = run([command, csv, "--vehicle", "quadrotor"]).success();
        assert!(
            told.stdout
                .contains("Inconclusive: roll, roll_rate, pitch and pitch_rate are 57.3 times too large"),
            "{}",
            told.stdout
        );
        assert!(told.stdout.contains("--map roll_rate=roll_rate[deg/s]"), "{}", told.stdout);
    }
}

/// `diagnose` and `compare` report each ratio and its inverse as such, on an output and on an input.
fn each_ratio_of_two_units_is_told_of_an_output_and_of_an_input() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let table = table(dir);
    for (ratio, shown) in [(1f64.to_degrees(), "57.3"), (9.80665, "9.81"), (1000.0, "1000"), (3.6, "3.60")] {
        for (factor, much) in [(ratio, "large"), (1.0 / ratio, "small")] {
            for column in ["roll_rate", "u_pitch"] {
                let csv = dir.join(format!("{column}-{shown}-{much}.csv"));
                std::fs::write(&csv, scaled(&table, &[column], factor)).unwrap();
                for command in ["diagnose", "compare"] {
                    let told =
                        run([command, csv.to_str().unwrap(), "--vehicle", "quadrotor"]).success().stdout;
                    let words = format!("Inconclusive: {column} is {shown} times too {much}");
                    assert!(told.starts_with(&words), "{command}: {words}\n{told}");
                }
            }
        }
    }
}

/// The input is 25 times what the column says: not a ratio of units, and beyond the gains that are searched for. This
/// is reported before the search.
fn a_cause_beyond_what_is_looked_for_is_told_and_does_not_explain() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let csv = dir.join("weak.csv");
    std::fs::write(&csv, scaled(&table(dir), &["u_pitch"], 1.0 / 25.0)).unwrap();
    let (answer, text, _) = diagnosed(dir, csv.to_str().unwrap(), "quadrotor", "weak");
    let none = serde_json::json!([]);
    assert_eq!((&answer["verdict"], &answer["causes"]), (&"inconclusive".into(), &none), "{text}");
    let told = text.strip_prefix("Inconclusive: u_pitch is ").and_then(|t| t.split_once(" times too small"));
    let factor: f64 = told.expect(&text).0.parse().unwrap();
    assert!((factor / 25.0 - 1.0).abs() < 0.1, "{text}");
    assert!(
        text.contains("not the ratio of two units, and faults are only searched for up to a factor of 20.0"),
        "{text}"
    );
}

fn what_cannot_be_diagnosed_says_what_to_do() {
    let dir = tempfile::tempdir().unwrap();
    let csv = dir.path().join("short.csv");
    std::fs::write(&csv, "t,u_roll,u_pitch,roll[deg]\n0,0,0,0\n0.01,0,0,0\n").unwrap();
    let path = csv.to_str().unwrap();
    let short = run(["diagnose", path, "--vehicle", "quadrotor"]);
    assert_eq!(short.code(), 2, "{}", short.stderr);
    assert!(short.stderr.contains("short.csv"), "{}", short.stderr);
    let rows: String = (0..500).map(|k| format!("{},0,{}\n", k as f64 * 0.01, k % 7)).collect();
    std::fs::write(&csv, format!("t,stick,u_pitch\n{rows}")).unwrap();
    let unmapped = run(["diagnose", path, "--vehicle", "quadrotor"]);
    assert_eq!(unmapped.code(), 2, "{}", unmapped.stderr);
    assert!(unmapped.stderr.contains("u_roll") && unmapped.stderr.contains("stick"), "{}", unmapped.stderr);
}

whirlstand_test_harness::listed!(
    a_hidden_delay_is_named_and_the_extended_vehicle_flies_the_same,
    ctrl_c_ends_a_diagnosis_with_what_is_known,
    a_budget_of_time_ends_a_diagnosis_with_what_is_known,
    degrees_read_as_radians_are_told_by_diagnose_and_compare,
    each_ratio_of_two_units_is_told_of_an_output_and_of_an_input,
    a_cause_beyond_what_is_looked_for_is_told_and_does_not_explain,
    what_cannot_be_diagnosed_says_what_to_do,
);
