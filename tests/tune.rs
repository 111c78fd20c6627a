//! The complete workflow: a flight with a hidden delay, its diagnosis, a law designed for the delay, and the flight
//! again.

use std::path::Path;
use std::time::Duration;

use crate::support::{Finished, json, refused, run, spawn, whirlstand};
use serde_json::Value;

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// The quadrotor under LQR, with setpoint steps and a gust; the law and the estimator do not know of the delay.
const LAUNCH: &str = "vehicle = 'quadrotor'\nmode = 'lockstep'\nrate_hz = 100.0\nduration_s = 24.0\n\
    [controller]\nlaw = 'lqr'\n\
    [[setpoint]]\nat_s = 1.0\nroll = '8 deg'\n[[setpoint]]\nat_s = 5.0\nroll = '-8 deg'\npitch = '5 deg'\n\
    [[setpoint]]\nat_s = 9.0\nroll = 0.0\npitch = 0.0\n[[setpoint]]\nat_s = 13.0\nroll = '8 deg'\n\
    [[setpoint]]\nat_s = 16.0\nroll = 0.0\npitch = '-5 deg'\n\
    [[effects]]\neffect = 'input_delay'\nwhere = 'u_roll'\ndelay_s = 0.3\n\
    [[effects]]\neffect = 'pulse_disturbance'\nwhere = 'roll_rate'\nat_s = 20.0\nduration_s = 0.2\nmagnitude = '60 deg/s^2'\n";

const HIDDEN: &str = "\n[[effects]]\neffect = 'input_delay'\nwhere = 'u_roll'\ndelay_s = 0.3\n";

/// Flies the draw that is reported as the worst over processes: its figures are those of the flight in one thread.
fn a_draw_is_flown_as_processes_fly_it(answer: &Value, tuned: &Path) {
    let worst = &answer["worst"];
    let ended = run(["run", text(&tuned.join("worst.toml")), "--out", text(&tuned.join("worst"))]).success();
    let run = json(tuned.join("worst/summary.json"))["runs"][0].clone();
    assert_eq!(
        (&run["mode"], &run["transport"]),
        (&"lockstep".into(), &"iceoryx2".into()),
        "{}",
        ended.stdout
    );
    let mut compared = 0;
    for (key, value) in worst["figures"].as_object().unwrap() {
        let (signal, figure) = key.rsplit_once('.').unwrap();
        let flown = match figure {
            "iae" => &run["outputs"][signal]["iae"],
            "rms" | "travel_per_s" => &run["inputs"][signal][figure],
            _ => continue,
        };
        assert_eq!(flown, value, "{key} of draw {}", worst["draw"]);
        compared += 1;
    }
    assert!(compared >= 6, "{worst}");
}

fn fly(launch: &Path, out: &Path) -> Value {
    run(["run", text(launch), "--out", text(out)]).success();
    json(out.join("summary.json"))["runs"][0]["outputs"]["roll"].clone()
}

/// A diagnosis may take long on a busy machine; one that hangs is still killed.
fn tune(args: &[&str]) -> Finished {
    spawn(whirlstand(args)).finish_within(Duration::from_secs(900)).success()
}

fn a_hidden_delay_is_found_designed_for_and_flown_better() {
    let folder = tempfile::tempdir().unwrap();
    let (launch, tuned) = (folder.path().join("late.toml"), folder.path().join("tuned"));
    std::fs::write(&launch, LAUNCH).unwrap();
    let before = fly(&launch, &folder.path().join("before"));
    let log = folder.path().join("before");
    let truth = folder.path().join("truth.toml");
    let plain = run(["vehicle", "show", "quadrotor"]).success().stdout;
    std::fs::write(&truth, plain + HIDDEN).unwrap();
    let args = [
        "tune",
        text(&log),
        "--launch",
        text(&launch),
        "--truth",
        text(&truth),
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
    // Nearly the whole gain of a law designed for the truth is reached, and that gain is reported as certain.
    let on_truth = &answer["truth"];
    assert_eq!(on_truth["gain_of_designed"]["certain"], true, "{on_truth}");
    let share = on_truth["share"].as_f64().unwrap();
    assert!(share > 0.9, "{share} {on_truth}");
    for law in ["before", "after"] {
        let lost = &answer[law]["probability_unstable"];
        assert_eq!((lost["count"].as_u64(), lost["of"].as_u64()), (Some(0), Some(40)), "{lost}");
        // Clopper-Pearson upper bound for 0 of 40.
        assert!((lost["high"].as_f64().unwrap() - 0.088_1).abs() < 1e-4, "{lost}");
    }
    a_draw_is_flown_as_processes_fly_it(&answer, &tuned);
    let after = fly(&tuned.join("tuned.toml"), &folder.path().join("after"));
    // After the gust the loop of the blind law rings; that of the law designed for the delay comes to rest.
    let left = |figures: &Value| figures["disturbances"][0]["iae"].as_f64().unwrap();
    println!("roll after the gust, IAE {:.4} -> {:.4} rad s", left(&before), left(&after));
    assert!(left(&after) < left(&before), "{before} {after}");
}

fn weights_are_chosen_on_other_draws_than_they_are_judged_on() {
    let folder = tempfile::tempdir().unwrap();
    let (launch, tuned) = (folder.path().join("slow.toml"), folder.path().join("tuned"));
    let plain = LAUNCH.replace("duration_s = 24.0", "duration_s = 22.0").replace(HIDDEN.trim_start(), "");
    // A regulator that hardly moves its inputs, and a limit on the peak that demands more.
    let timid =
        plain.replace("law = 'lqr'", "law = 'lqr'\nr = [1.0, 1.0]") + "[expect]\nroll.peak = '1 deg'\n";
    std::fs::write(&launch, timid).unwrap();
    let log = folder.path().join("flight");
    run(["run", text(&launch), "--out", text(&log)]);
    let retune =
        ["tune", text(&log), "--launch", text(&launch), "--draws", "20", "--out", text(&tuned), "--retune"];
    let answer = tune(&[&retune[..], &["--max-sensitivity", "2.5", "--json", "-"]].concat());
    let answer: Value = serde_json::from_str(&answer.stdout).unwrap();
    let chosen = &answer["retuned"];
    println!("{chosen}\n{}", answer["gain"]);
    assert_eq!((&chosen["first_draw"], &chosen["against"]), (&20.into(), &"expectations".into()));
    assert!(chosen["after"].as_f64() < chosen["before"].as_f64(), "{chosen}");
    assert!(chosen["sensitivity"].as_f64().unwrap() <= 2.5, "{chosen}");
    let told = std::fs::read_to_string(tuned.join("tuned.toml")).unwrap();
    let kept = answer["gain"]["certain"] == true;
    assert_eq!(!told.contains("r = [1.0, 1.0]"), kept, "{told}");
    refused(&[&retune[..], &["--max-sensitivity", "0.9"]].concat(), &["--max-sensitivity 0.9", "above 1"]);
}

fn a_flight_as_simulated_keeps_its_law() {
    let folder = tempfile::tempdir().unwrap();
    let (launch, tuned) = (folder.path().join("plain.toml"), folder.path().join("tuned"));
    let plain = LAUNCH.replace(HIDDEN.trim_start(), "");
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

/// The paper's Figure 12: the quadrotor by hand and under sliding mode, with roll and pitch of its IMU offset from
/// level.
fn figure_12_from_a_flight_by_hand_is_held_level() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("proof");
    let call =
        ["bench", "tune", "--only", "figure-12/manual", "--draws", "20", "--out", text(&out), "--json"];
    let told: Value = serde_json::from_str(&tune(&call).stdout).unwrap();
    println!("{told}");
    assert_eq!((&told["schema"], &told["to_gain"]), (&"whirlstand.bench-tune.v1".into(), &1.into()));
    let flown = &told["cells"][0]["result"]["flown"];
    // As in the paper, the offset is in roll and pitch, which the flight by hand distinguishes from a real inclination.
    let named: Vec<&str> = flown["named"].as_array().unwrap().iter().map(|n| n.as_str().unwrap()).collect();
    for (place, offset) in [("roll", 3.0), ("pitch", -2.0_f64)] {
        let of =
            |name: &&str| name.strip_prefix(&format!("`sensor_bias` {place}: offset ")).map(str::to_owned);
        let found: f64 = named.iter().find_map(of).unwrap_or_else(|| panic!("{named:?}")).parse().unwrap();
        assert!((found.to_degrees() - offset).abs() < 0.1, "{place}: {found} rad");
    }
    assert!(flown["share"].as_f64().unwrap() > 0.9, "{flown}");
    // The cell is stored and not flown again.
    let cells = || std::fs::read_to_string(out.join("cells.jsonl")).unwrap();
    let before = cells();
    let table = run(["bench", "tune", "--only", "figure-12/manual", "--out", text(&out)]).success().stdout;
    assert!(
        table.contains("| `sensor_bias` |") && table.contains("Worse than before, beyond its interval: none"),
        "{table}"
    );
    assert_eq!((cells(), std::fs::read_to_string(out.join("table.md")).unwrap()), (before, table));
    refused(
        &["bench", "tune", "--only", "lqr/flutter", "--out", text(&out)],
        &["lqr/flutter", "input_delay"],
    );
    std::fs::write(out.join("cells.jsonl"), "{}\n").unwrap();
    refused(&["bench", "tune", "--table", "--out", text(&out)], &["cells.jsonl, line 1", "to fly it again"]);
}

/// One cell with every node as a process of its own: the logs are what is judged.
fn a_cell_is_flown_over_processes() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("proof");
    let call = ["bench", "tune", "--only", "quadrotor/lqr/input_delay", "--draws", "20", "--out", text(&out)];
    let processes = ["--processes", "lockstep", "--seeds", "2", "--json"];
    let told: Value = serde_json::from_str(&tune(&[&call[..], &processes].concat()).stdout).unwrap();
    println!("{told}");
    let cell = &told["cells"][0];
    assert_eq!((&cell["processes"], &told["to_gain"]), (&"lockstep".into(), &1.into()));
    let flown = &cell["result"]["flown"];
    assert!(flown["share"].as_f64().unwrap() > 0.9, "{flown}");
    // The table gives costs of 4.805 and 3.662 over 40 seeds in one thread.
    for (law, cost) in [("before", 4.805), ("after", 3.662), ("designed", 3.662)] {
        let found = flown[law]["cost"].as_f64().unwrap();
        assert!((found / cost - 1.0).abs() < 0.05, "{law}: {found}, in one thread {cost}");
    }
    // Flights in one thread have a table of their own.
    let thread = run(["bench", "tune", "--table", "--out", text(&out)]).success().stdout;
    assert!(thread.contains("0 cells"), "{thread}");
    refused(&[&call[..], &["--seeds", "3"]].concat(), &["--processes"]);
}

whirlstand_test_harness::listed!(
    a_hidden_delay_is_found_designed_for_and_flown_better,
    weights_are_chosen_on_other_draws_than_they_are_judged_on,
    a_flight_as_simulated_keeps_its_law,
    figure_12_from_a_flight_by_hand_is_held_level,
    a_cell_is_flown_over_processes,
);
