//! Blind trials as processes: what the diagnosing program gets to see, and how its answers are counted.

use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use serde_json::Value;
use sha2::{Digest, Sha256};

use crate::support::{json, run};

/// A program that appends a listing of its folder to a file next to itself and then writes this diagnosis.
fn stand_in(dir: &Path, diagnosis: &str) -> PathBuf {
    let (path, list) = (dir.join("stand-in.sh"), dir.join("seen.txt"));
    let script = format!(
        "#!/bin/sh\necho \"$@ $(ls -a | tr '\\n' ' ')\" >> '{list}'\nprintf '%s' '{diagnosis}' > diagnosis.json\n",
        list = list.display()
    );
    std::fs::write(&path, script).unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
    path
}

fn goal<'a>(tally: &'a Value, name: &str) -> &'a Value {
    tally["goals"].as_array().unwrap().iter().find(|g| g["name"] == name).unwrap()
}

fn the_program_sees_a_record_and_a_vehicle_and_nothing_else() {
    let dir = tempfile::tempdir().unwrap();
    let program = stand_in(dir.path(), r#"{"verdict":"consistent","causes":[]}"#);
    let (out, tally) = (dir.path().join("out"), dir.path().join("tally.json"));
    let arguments = ["--trials", "12", "--seed", "3", "--jobs", "2", "--program", program.to_str().unwrap()];
    let finished = run(["blind"].into_iter().chain(arguments).chain([
        "--keep",
        out.to_str().unwrap(),
        "--json",
        tally.to_str().unwrap(),
    ]));
    // No cause is named where one is hidden, so the first goal is missed.
    assert_eq!(finished.code(), 1, "{}", finished.stderr);
    let seen = std::fs::read_to_string(dir.path().join("seen.txt")).unwrap();
    for line in seen.split("diagnose ").skip(1) {
        assert_eq!(
            line.replace('\n', " ").trim(),
            "trial.csv --vehicle nominal.toml --json diagnosis.json . .. nominal.toml stderr.txt trial.csv"
        );
    }

    let tally = json(tally);
    assert_eq!(tally["schema"], "whirlstand.blind.v1");
    let trials = tally["trials"].as_array().unwrap();
    assert_eq!(trials.len() + tally["skipped"].as_u64().unwrap() as usize, 12);
    let seals = std::fs::read_to_string(out.join("seals.txt")).unwrap();
    for trial in trials {
        let number = trial["answer"]["number"].as_u64().unwrap();
        let answer = std::fs::read(out.join(format!("sealed/{number}.json"))).unwrap();
        let seal: String = Sha256::digest(answer).iter().map(|b| format!("{b:02x}")).collect();
        assert_eq!(trial["seal"], seal.as_str());
        assert!(seals.contains(&format!("{number} {seal}")));
        let expected = match trial["answer"]["case"].as_str().unwrap() {
            "single" | "pair" => "missed",
            _ => "right",
        };
        assert_eq!(trial["outcome"], expected, "{number}");
    }
    // A few clean records cannot demonstrate a rate of one in a hundred.
    assert_eq!(goal(&tally, "false cause on a clean record")["met"], Value::Null);
    assert_eq!(goal(&tally, "right name and place first")["met"], false);
}

fn an_interrupted_run_goes_on_where_it_ended() {
    let dir = tempfile::tempdir().unwrap();
    let program = stand_in(dir.path(), r#"{"verdict":"consistent","causes":[]}"#);
    let (first, again) = (dir.path().join("first.json"), dir.path().join("again.json"));
    let fly = |seed: &str, tally: &Path, rest: &[&str]| {
        let arguments =
            ["blind", "--trials", "6", "--seed", seed, "--length", "5:8", "--rate", "50", "--program"];
        let files = [program.to_str().unwrap(), "--json", tally.to_str().unwrap()];
        run(arguments.iter().chain(&files).chain(rest))
    };
    fly("4", &first, &[]);
    let whole = json(&first);
    let mut cut = whole.clone();
    cut["call"] = format!("{} (interrupted after 2)", whole["call"].as_str().unwrap()).into();
    cut["trials"].as_array_mut().unwrap().truncate(2);
    std::fs::write(&first, cut.to_string()).unwrap();
    std::fs::remove_file(dir.path().join("seen.txt")).unwrap();
    fly("4", &again, &["--resume", first.to_str().unwrap()]);
    let seen = std::fs::read_to_string(dir.path().join("seen.txt")).unwrap();
    let trials = whole["trials"].as_array().unwrap();
    assert_eq!(seen.split("diagnose ").skip(1).count(), trials.len() - 2, "only what was missing is flown");
    let numbers = |tally: &Value| -> Vec<u64> {
        let trials = tally["trials"].as_array().unwrap();
        trials.iter().map(|t| t["answer"]["number"].as_u64().unwrap()).collect()
    };
    let resumed = json(&again);
    assert_eq!((numbers(&resumed), &resumed["call"]), (numbers(&whole), &whole["call"]));
    let other = fly("5", &again, &["--resume", first.to_str().unwrap()]);
    assert_eq!(other.code(), 2);
    assert!(other.stderr.contains("from another call"), "{}", other.stderr);
}

fn parts_join_to_the_whole_and_what_does_not_belong_together_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let program = stand_in(dir.path(), r#"{"verdict":"consistent","causes":[]}"#);
    let at = |name: &str| dir.path().join(name).display().to_string();
    let fly = |seed: &str, tally: &str, rest: &[&str]| {
        let arguments =
            ["blind", "--trials", "7", "--seed", seed, "--length", "5:8", "--rate", "50", "--program"];
        let files = [program.display().to_string(), "--json".into(), at(tally)];
        run(arguments
            .iter()
            .map(|a| (*a).to_string())
            .chain(files)
            .chain(rest.iter().map(|r| (*r).to_string())))
    };
    fly("4", "whole.json", &["--out", &at("whole")]);
    for part in ["1", "2", "3"] {
        let ended = fly("4", &format!("part-{part}.json"), &["--shard", &format!("{part}/3")]);
        assert_eq!(ended.code(), 0, "a part meets and misses no goal: {}", ended.stderr);
    }
    let merge = |parts: &[&str]| {
        let parts = parts.iter().map(|part| at(part));
        let files = ["--json".to_string(), at("joined.json"), "--out".into(), at("joined")];
        run(["blind".to_string(), "merge".into()].into_iter().chain(parts).chain(files))
    };
    let ended = merge(&["part-3.json", "part-1.json", "part-2.json"]);
    assert_eq!(ended.code(), 1, "the whole misses a goal: {}", ended.stderr);
    // The duration of each diagnosis depends on the machine.
    let without_seconds = |name: &str| {
        let mut tally = json(dir.path().join(name));
        tally["trials"].as_array_mut().unwrap().iter_mut().for_each(|trial| trial["seconds"] = 0.into());
        tally
    };
    assert_eq!(without_seconds("joined.json"), without_seconds("whole.json"));
    let text = |name: &str| std::fs::read_to_string(dir.path().join(name).join("blind.txt")).unwrap();
    assert_eq!(text("joined"), text("whole"));

    fly("5", "other.json", &["--shard", "3/3"]);
    let mut newer = json(dir.path().join("part-3.json"));
    newer["part"]["version"] = "999.0.0".into();
    std::fs::write(at("newer.json"), newer.to_string()).unwrap();
    for (parts, words) in [
        (&["part-1.json", "part-2.json"][..], "parts 3/3 are missing"),
        (&["part-1.json", "part-2.json", "part-2.json"], "is part 2/3, which was already given"),
        (&["part-1.json", "part-2.json", "other.json"], "the call differs"),
        (&["part-1.json", "part-2.json", "newer.json"], "the version of the program differs"),
        (&["part-1.json", "part-2.json", "whole.json"], "the number of parts differs"),
    ] {
        let ended = merge(parts);
        assert!(ended.code() == 2 && ended.stderr.contains(words), "{words:?}: {}", ended.stderr);
    }
    let ended = fly("4", "again.json", &["--shard", "2/3", "--resume", &at("part-1.json")]);
    assert!(ended.code() == 2 && ended.stderr.contains("from another part"), "{}", ended.stderr);
}

fn a_trial_is_repeated_by_its_number() {
    let dir = tempfile::tempdir().unwrap();
    let truth = r#"{"verdict":"explained","causes":[{"effect":"sensor_bias","where":"nowhere"}]}"#;
    let program = stand_in(dir.path(), truth);
    let once = |name: &str| -> (Vec<u8>, Value) {
        let (keep, tally) = (dir.path().join(name), dir.path().join(format!("{name}.json")));
        let arguments = ["blind", "--only", "8000005", "--program", program.to_str().unwrap()];
        let files = ["--keep", keep.to_str().unwrap(), "--json", tally.to_str().unwrap()];
        let finished = run(arguments.into_iter().chain(files));
        assert!(finished.stderr.contains("sealed with SHA-256"), "{}", finished.stderr);
        assert!(finished.stdout.contains("named    sensor_bias(nowhere)"), "{}", finished.stdout);
        (std::fs::read(keep.join("trials/8000005/trial.csv")).unwrap(), json(tally))
    };
    let (first, again) = (once("first"), once("again"));
    assert!(first.0 == again.0, "the record is the same");
    assert_eq!(first.1["trials"][0]["seal"], again.1["trials"][0]["seal"]);
    assert_eq!(first.1["trials"][0]["outcome"], "wrong");
}

fn a_users_own_vehicle_and_excitation_are_flown() {
    let dir = tempfile::tempdir().unwrap();
    let program = stand_in(dir.path(), r#"{"verdict":"unexplained"}"#);
    let (vehicle, input) = (dir.path().join("cart.toml"), dir.path().join("input.csv"));
    std::fs::write(
        &vehicle,
        "A = [[0.0, 1.0], [-4.0, -0.5]]\nB = [[0.0], [2.0]]\nstates = [{ name = \"x\", unit = \"m\" }, { name = \"v\", unit = \"m/s\" }]\n\
         inputs = [{ name = \"force\", unit = \"N\" }]\noutputs = [{ name = \"x\", unit = \"cm\", noise = 0.2 }]\n",
    )
    .unwrap();
    let rows = (0..3000).map(|k| format!("{},{}\n", f64::from(k) * 0.02, f64::from((k / 60 % 3) - 1)));
    let text: String = std::iter::once("t,force[N]\n".to_string()).chain(rows).collect();
    std::fs::write(&input, text).unwrap();
    let keep = dir.path().join("keep");
    let arguments = ["blind", "--trials", "3", "--kinds", "single", "--effects", "input_delay,dead_zone"];
    let own = ["--vehicle", vehicle.to_str().unwrap(), "--input", input.to_str().unwrap()];
    let rest = ["--program", program.to_str().unwrap(), "--keep", keep.to_str().unwrap()];
    let finished = run(arguments.into_iter().chain(own).chain(rest));
    assert!(
        finished.stdout.contains("input_delay") && finished.stdout.contains("dead_zone"),
        "{}",
        finished.stdout
    );
    for trial in std::fs::read_dir(keep.join("trials")).unwrap() {
        let csv = std::fs::read_to_string(trial.unwrap().path().join("trial.csv")).unwrap();
        assert!(csv.starts_with("t,force[N],x[cm]\n0,-1,"), "{}", &csv[..60]);
        assert_eq!(csv.lines().count(), 3001);
    }
}

fn what_cannot_be_flown_is_refused_with_the_reason() {
    let refused = |arguments: &[&str], words: &str| {
        let finished = run(["blind"].iter().chain(arguments));
        assert_eq!(finished.code(), 2, "{}", finished.stderr);
        assert!(finished.stderr.contains(words), "{words:?} is missing in: {}", finished.stderr);
    };
    refused(&["--effects", "input_dely"], "did you mean 'input_delay'?");
    refused(&["--vehicle", "no-such-vehicle"], "no-such-vehicle");
    refused(&["--input", "inputs.csv"], "--input requires --vehicle");
    refused(&["--length", "60:20"], "as in 30:120");
    refused(&["--rate", "50,fast"], "'fast' is not a sampling rate");
    let dir = tempfile::tempdir().unwrap();
    let silent = dir.path().join("silent.toml");
    let text = "A = [[-1.0]]\nB = [[1.0]]\nstates = [{ name = \"x\" }]\ninputs = [{ name = \"u\" }]\n";
    std::fs::write(&silent, text).unwrap();
    refused(&["--trials", "1", "--vehicle", silent.to_str().unwrap()], "declares no noise");
}

/// A fixed set of trials through the whole program: every trial is a process that sees only a record and a vehicle. The
/// bounds suit a set of this size; the figures of the full table are in docs/blind.md.
fn the_diagnosis_finds_what_was_hidden() {
    let dir = tempfile::tempdir().unwrap();
    let tally = dir.path().join("tally.json");
    let drawn = ["--kinds", "single,clean,pair", "--length", "15:60", "--rate", "50,100"];
    let arguments =
        ["blind", "--trials", "16", "--seed", "7", "--jobs", "2", "--json", tally.to_str().unwrap()];
    let running = crate::support::spawn(crate::support::whirlstand(arguments.into_iter().chain(drawn)));
    let finished = running.finish_within(std::time::Duration::from_secs(400));
    assert!(finished.code() < 2, "{}", finished.stderr);
    let tally = json(tally);
    let trials = tally["trials"].as_array().unwrap();
    let count = |outcome: &str| trials.iter().filter(|t| t["outcome"] == outcome).count();
    assert!(trials.len() >= 14, "{}", finished.stdout);
    assert_eq!(count("failed"), 0, "{}", finished.stdout);
    assert!(count("wrong") <= 1, "{}", finished.stdout);
    assert!(count("right") * 10 >= trials.len() * 7, "{}", finished.stdout);
    let clean = trials.iter().filter(|t| t["answer"]["case"] == "clean");
    assert!(
        clean.clone().count() > 0 && clean.into_iter().all(|t| t["outcome"] == "right"),
        "{}",
        finished.stdout
    );
}

whirlstand_test_harness::listed!(
    the_program_sees_a_record_and_a_vehicle_and_nothing_else,
    an_interrupted_run_goes_on_where_it_ended,
    parts_join_to_the_whole_and_what_does_not_belong_together_is_refused,
    a_trial_is_repeated_by_its_number,
    a_users_own_vehicle_and_excitation_are_flown,
    what_cannot_be_flown_is_refused_with_the_reason,
    the_diagnosis_finds_what_was_hidden,
);
