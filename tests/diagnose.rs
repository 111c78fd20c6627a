//! The whole circle with processes: a flight with a hidden fault is flown, logged and diagnosed; the vehicle with the
//! named cause flies again, and its record is what the first one was.

mod support;

use std::path::Path;

use support::{json, run, spawn, whirlstand};

/// The built-in quadrotor as a file, with more text behind it.
fn quadrotor(dir: &Path, name: &str, more: &str) -> String {
    let shown = run(["vehicle", "show", "quadrotor"]).success().stdout;
    let path = dir.join(name);
    std::fs::write(&path, format!("{shown}\n{more}")).unwrap();
    path.display().to_string()
}

/// Flies a vehicle through the designed test as a bench of processes, in lockstep, with sensor noise; the log.
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

#[test]
fn a_hidden_delay_is_named_and_the_extended_vehicle_flies_the_same() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let truth = quadrotor(
        dir,
        "truth.toml",
        "[[effects]]\neffect = \"input_delay\"\nwhere = \"u_roll\"\ndelay_s = 0.06\n",
    );
    let log = flown(dir, &truth, "measured");
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

    // The extended vehicle runs unchanged, and cannot be told from what was measured.
    let extended = format!("{out}/vehicle.toml");
    let again = flown(dir, &extended, "simulated");
    let (answer, text, _) = diagnosed(dir, &again, &truth, "second");
    assert_eq!(answer["verdict"], "consistent", "{text}");
    let (answer, text, _) = diagnosed(dir, &log, &extended, "third");
    assert_eq!(answer["verdict"], "consistent", "{text}");
}

#[test]
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

#[test]
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
    // With time enough, it is whole.
    let whole = run(call.into_iter().chain(["--budget", "10 min"])).success();
    assert!(whole.stdout.starts_with("Explained"), "{}", whole.stdout);
    let wrong = run(call.into_iter().chain(["--budget", "5 m"]));
    assert_eq!(wrong.code(), 2, "{}", wrong.stderr);
}

#[test]
fn degrees_read_as_radians_are_told_by_diagnose_and_compare() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let log = flown(dir, "quadrotor", "measured");
    let csv = dir.join("flight.csv");
    let csv = csv.to_str().unwrap();
    run(["log", "export", &log, "-o", csv]).success();
    let text = std::fs::read_to_string(csv).unwrap();
    // The head says radians of what is in degrees.
    let degrees: Vec<String> = text
        .lines()
        .enumerate()
        .map(|(row, line)| {
            let value = |(column, v): (usize, &str)| match v.parse::<f64>() {
                Ok(v) if row > 0 && (1..5).contains(&column) => v.to_degrees().to_string(),
                _ => v.to_string(),
            };
            line.split(',').enumerate().map(value).collect::<Vec<_>>().join(",")
        })
        .collect();
    assert!(degrees[0].starts_with("t[s],roll[rad],roll_rate[rad/s],pitch[rad],pitch_rate[rad/s]"));
    std::fs::write(csv, degrees.join("\n")).unwrap();
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

#[test]
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
