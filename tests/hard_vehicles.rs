//! Vehicle files on which unbounded iterations did not terminate, and stiff ones: every command answers within seconds,
//! with numbers or with an error message.

use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::support::{Finished, json, spawn, whirlstand};

/// Far longer than any of these commands should take; one that does not end is killed.
const ANSWER: Duration = Duration::from_secs(60);

fn ask(args: &[&str]) -> Finished {
    spawn(whirlstand(args)).finish_within(ANSWER)
}

/// A vehicle with these rows of A, whose input acts on the last state and whose states are all measured.
fn vehicle(dir: &Path, name: &str, a: &[Vec<f64>]) -> PathBuf {
    let n = a.len();
    let rows = a.iter().map(|row| format!("    {row:?},\n")).collect::<String>();
    let b = (0..n).map(|i| if i + 1 == n { "[1.0]" } else { "[0.0]" }).collect::<Vec<_>>().join(", ");
    let states = (1..=n).map(|i| format!("{{ name = \"x{i}\" }}")).collect::<Vec<_>>().join(", ");
    let outputs =
        (1..=n).map(|i| format!("[[outputs]]\nname = \"x{i}\"\nnoise = 0.001\n")).collect::<String>();
    let text = format!(
        "A = [\n{rows}]\nB = [{b}]\nstates = [{states}]\ninputs = [{{ name = \"u\", lower = -1.0, upper = 1.0 }}]\n{outputs}"
    );
    let path = dir.join(format!("{name}.toml"));
    std::fs::write(&path, text).unwrap();
    path
}

fn square(n: usize, entry: impl Fn(usize, usize) -> f64) -> Vec<Vec<f64>> {
    (0..n).map(|i| (0..n).map(|j| entry(i, j)).collect()).collect()
}

fn next(i: usize, j: usize, n: usize) -> f64 {
    f64::from(u8::from(j == (i + 1) % n))
}

fn hard() -> Vec<(&'static str, Vec<Vec<f64>>)> {
    let above = |i: usize, j: usize| f64::from(u8::from(j == i + 1));
    let companion = |last: [f64; 5]| square(5, move |i, j| if i == 4 { last[j] } else { above(i, j) });
    vec![
        ("cyclic", square(6, |i, j| next(i, j, 6))),
        ("chain-of-integrators", square(4, above)),
        ("jordan", square(4, |i, j| if i == j { -1.0 } else { above(i, j) })),
        ("unstable-jordan", square(4, |i, j| if i == j { 2.0 } else { above(i, j) })),
        ("identity", square(4, |i, j| f64::from(u8::from(i == j)))),
        ("companion", companion([-1.0, 0.0, 0.0, 0.0, 0.0])),
        ("large-companion", companion([-1e12, -1e9, -1e6, -1e3, -1e2])),
        ("huge", square(4, |i, j| 1e300 * (next(i, j, 4) - f64::from(u8::from(i == j))))),
        ("tiny", square(3, |i, j| 1e-300 * next(i, j, 3))),
        ("graded", square(4, |i, j| 10f64.powi(70 * (i as i32 - j as i32)))),
        ("stiff", square(3, |i, j| if i == j { [-1e-6, -1.0, -1e6][i] } else { above(i, j) })),
    ]
}

fn every_vehicle_is_checked_and_designed_for_within_seconds() {
    let dir = tempfile::tempdir().unwrap();
    let mut answered = 0;
    for (name, a) in hard() {
        let path = vehicle(dir.path(), name, &a);
        let path = path.to_str().unwrap();
        for format in [&[][..], &["--json"]] {
            let end = ask(&[&["vehicle", "check", path], format].concat());
            assert!([0, 2].contains(&end.code()), "{name}: {end:?}");
            assert!(end.code() == 0 || !end.stderr.trim().is_empty(), "{name}: {end:?}");
        }
        for law in ["lqr", "ppc", "smc"] {
            let end = ask(&["design", path, "--law", law, "--json"]);
            assert!([0, 2].contains(&end.code()), "{name} {law}: {end:?}");
            assert!(!end.stderr.contains("NaN") && !end.stderr.contains("panicked"), "{name} {law}: {end:?}");
            if end.code() == 0 {
                let design: serde_json::Value = serde_json::from_str(&end.stdout).unwrap();
                let gain = design["linear"]["gain"].as_array().unwrap().iter();
                let mut entries = gain.flat_map(|row| row.as_array().unwrap());
                // NaN is null in JSON.
                assert!(entries.all(serde_json::Value::is_number), "{name} {law}: {}", end.stdout);
                answered += 1;
            } else {
                println!("{name} {law}: {}", end.stderr.trim());
            }
        }
    }
    assert!(answered >= 9, "{answered} designs");
}

/// The state x1 follows x2 within a microsecond, in a loop of 5 ms: whatever the ratio, x1 is a thousandth of x2 at
/// every step, and the loop brings the slow states to rest.
fn a_stiff_vehicle_flies_as_processes() {
    let dir = tempfile::tempdir().unwrap();
    let a = vec![vec![-1e6, 1e3, 0.0], vec![0.0, 0.0, 1.0], vec![0.0, 0.0, -0.5]];
    vehicle(dir.path(), "stiff", &a);
    let launch = dir.path().join("launch.toml");
    let text = "vehicle = 'stiff.toml'\nmode = 'lockstep'\nrate_hz = 200.0\nduration_s = 8.0\ncontroller.law = 'lqr'\n\
                [plant]\ninitial = { x1 = 0.0005, x2 = 0.5 }\n";
    std::fs::write(&launch, text).unwrap();
    let out = dir.path().join("out");
    let end = ask(&["run", launch.to_str().unwrap(), "--out", out.to_str().unwrap()]).success();
    let summary = json(out.join("summary.json"));
    let run = &summary["runs"][0];
    assert_eq!((&run["ended"]["how"], &run["steps"]), (&"complete".into(), &1600.into()), "{}", end.stdout);
    assert_eq!((&run["timing"]["failsafe_steps"], &run["timing"]["lost"]), (&0.into(), &0.into()), "{run}");
    let figure = |output: &str, key: &str| run["outputs"][output][key].as_f64().unwrap();
    let ratio = figure("x1", "rms_error") / figure("x2", "rms_error");
    assert!((ratio / 1e-3 - 1.0).abs() < 1e-3, "{ratio}");
    // Uncontrolled, x2 would stay at 0.5 for 8 s.
    assert!(figure("x2", "iae") < 1.0, "{run}");
}

whirlstand_test_harness::listed!(
    every_vehicle_is_checked_and_designed_for_within_seconds,
    a_stiff_vehicle_flies_as_processes,
);
