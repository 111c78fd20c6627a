//! A run in which the vehicle was not controlled is not a success, whatever its launch file states or omits.

use std::path::Path;

use crate::support::{Finished, json, run, spawn, whirlstand};

/// Flies in real time, and sends `signal` to a node in flight.
fn fly_and_signal(node: &str, signal: i32, out: &Path, more: &[&str]) -> Finished {
    let bench = format!("test-verdict-{}-{signal}-{}", std::process::id(), more.len());
    let args = ["run", "quadrotor-lqr", "--duration", "8", "--log-level", "debug", "--bench", &bench];
    // By default a node that hangs is restarted.
    let patient = ["--set", &format!("nodes.{node}.hang_timeout_s=600"), "--out", out.to_str().unwrap()];
    let mut running = spawn(whirlstand(args.iter().chain(&patient).chain(more)));
    let started = running.wait_for_stderr(&format!("{node} runs as process "));
    let pid: i32 = started.rsplit(' ').next().and_then(|number| number.parse().ok()).expect(&started);
    // Printed every 5 s when there is no terminal.
    running.wait_for_stderr("steps/s");
    // SAFETY: kill(2) on a process of a bench that this test has started touches no memory of ours.
    assert_eq!(unsafe { libc::kill(pid, signal) }, 0);
    running.finish()
}

fn a_run_that_stays_in_failsafe_fails_with_or_without_its_log() {
    for more in [&[][..], &["--no-log", "--set", "expect={}"]] {
        let dir = tempfile::tempdir().unwrap();
        let end = fly_and_signal("controller", libc::SIGSTOP, dir.path(), more);
        assert_eq!(end.code(), 1, "{more:?}\n{}\n{}", end.stdout, end.stderr);
        assert!(end.stdout.contains("max_failsafe_share is 0."), "{more:?}\n{}", end.stdout);
        assert!(end.stdout.contains("above the limit 0.01"), "{more:?}\n{}", end.stdout);
        let summary = json(dir.path().join("summary.json"));
        assert_eq!(summary["ok"], false);
        let timing = &summary["runs"][0]["timing"];
        assert!(timing["failsafe_at_end"].as_u64().is_some_and(|n| n > 100), "{more:?} {timing}");
    }
}

fn a_restart_fails_the_run_unless_the_file_allows_it() {
    let dir = tempfile::tempdir().unwrap();
    let end = fly_and_signal("recorder", libc::SIGKILL, dir.path(), &[]);
    assert_eq!(end.code(), 1, "{}\n{}", end.stdout, end.stderr);
    assert!(end.stdout.contains("max_restarts is 1, above the limit 0"), "{}", end.stdout);
}

fn a_run_that_controls_holds_the_limits_that_nobody_stated() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("plain.toml");
    std::fs::write(&file, "vehicle = 'quadrotor'\nmode = 'lockstep'\ncontroller.law = 'lqr'\n").unwrap();
    let out = dir.path().join("out");
    let end = run(["run", file.to_str().unwrap(), "--out", out.to_str().unwrap()]).success();
    assert!(end.stdout.contains("5 of 5 met"), "{}", end.stdout);
    let expect = json(out.join("summary.json"))["runs"][0]["expect"].clone();
    assert!(expect.as_array().unwrap().iter().all(|e| e["limit"] == 0.0 && e["found"] == 0.0), "{expect}");
}

fn the_rows_of_a_verdict_are_in_the_order_of_their_names() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("two.toml");
    let gust = |place: &str, size: &str| {
        format!(
            "[[effects]]\neffect = 'pulse_disturbance'\nwhere = '{place}'\nat_s = 1.0\nduration_s = 0.2\nmagnitude = '{size}'\n"
        )
    };
    // The reported order is neither that of the file nor that of the sizes.
    let limits = "[expect]\nu_roll.rms = 0.0\nroll_rate.peak = '0.001 deg/s'\nroll.peak = '0.001 deg'\npitch.peak = '0.001 deg'\n";
    let flight = "vehicle = 'quadrotor'\nmode = 'lockstep'\nduration_s = 3.0\ncontroller.law = 'lqr'\n";
    let gusts = gust("roll_rate", "100 deg/s^2") + &gust("pitch_rate", "50 deg/s^2");
    std::fs::write(&file, format!("{flight}{gusts}{limits}")).unwrap();
    let out = dir.path().join("out");
    let end = run(["run", file.to_str().unwrap(), "--out", out.to_str().unwrap()]);
    assert_eq!(end.code(), 1, "{}\n{}", end.stdout, end.stderr);
    let lines: Vec<&str> = end.stdout.lines().map(str::trim).collect();
    let first = lines.iter().position(|l| l.starts_with("expected")).expect("a row of expectations");
    let names: Vec<&str> = lines[first + 1..first + 5].iter().filter_map(|l| l.split(' ').next()).collect();
    assert_eq!(names, ["pitch.peak", "roll.peak", "roll_rate.peak", "u_roll.rms"], "{}", end.stdout);
    let moved = lines.iter().find(|l| l.starts_with("disturbance")).expect("a row of the disturbances");
    assert!(moved.contains(": pitch by ") && moved.contains("; roll by "), "{moved}");
    let sentence = json(out.join("summary.json"))["verdict"].to_string();
    assert!(sentence.contains("(pitch.peak, roll.peak, roll_rate.peak, u_roll.rms)"), "{sentence}");
}

whirlstand_test_harness::listed!(
    a_run_that_stays_in_failsafe_fails_with_or_without_its_log,
    a_restart_fails_the_run_unless_the_file_allows_it,
    a_run_that_controls_holds_the_limits_that_nobody_stated,
    the_rows_of_a_verdict_are_in_the_order_of_their_names,
);
