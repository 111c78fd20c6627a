//! A bench of processes under signals, crashes, hangs and failing programs.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::time::{Duration, Instant};

use crate::support::bench::{all_ready, gone, no_residue, ready, signal, unique};
use crate::support::{FAULTS_ALLOWED, HUNG, Running, json, run, spawn, whirlstand};

/// Starts a run that lasts until something ends it.
fn start(name: &str, duration: &str, out: &Path, more: &[&str]) -> Running {
    let bench = unique(name);
    let args = ["run", "quadrotor", "--duration", duration, "--log-level", "debug", "--set", FAULTS_ALLOWED];
    let out = ["--out", out.to_str().unwrap(), "--bench", &bench];
    spawn(whirlstand(args.iter().chain(&out).chain(more)))
}

fn an_interrupted_run_ends_in_order_with_log_and_report() {
    for (name, number, code) in [("int", libc::SIGINT, 130), ("term", libc::SIGTERM, 143)] {
        for transport in ["iceoryx2", "zenoh"] {
            let name = format!("{name}-{transport}");
            let dir = tempfile::tempdir().unwrap();
            let mut running = start(&name, "1000", dir.path(), &["--transport", transport]);
            let pids = all_ready(&mut running, ["recorder", "estimator", "controller", "plant"]);
            running.signal(number);
            let end = running.finish();
            assert_eq!(end.code(), code, "{}\n{}", end.stdout, end.stderr);
            let summary = json(dir.path().join("summary.json"));
            assert_eq!(summary["runs"][0]["ended"]["how"], "interrupted");
            assert!(summary["runs"][0]["problems"].as_array().unwrap().is_empty(), "{summary}");
            let info = run(["log", "info", dir.path().join("log.mcap").to_str().unwrap()]).success();
            assert!(!info.stdout.contains("damage"), "{}", info.stdout);
            pids.into_iter().for_each(gone);
            no_residue(&name);
        }
    }
}

fn a_killed_node_is_started_again_and_the_loop_recovers() {
    for node in ["estimator", "controller", "recorder", "plant"] {
        let dir = tempfile::tempdir().unwrap();
        let mut running = start(&format!("kill-{node}"), "2", dir.path(), &[]);
        let pid = ready(&mut running, node);
        signal(pid, libc::SIGKILL);
        running.wait_for_stderr("restarting it");
        assert_ne!(ready(&mut running, node), pid);
        let end = running.finish();
        assert_eq!(end.code(), 0, "{node}\n{}\n{}", end.stdout, end.stderr);
        let summary = json(dir.path().join("summary.json"));
        assert_eq!(summary["runs"][0]["ended"]["restarts"][node], 1, "{summary}");
        no_residue(&format!("kill-{node}"));
    }
}

fn a_node_that_hangs_is_killed_and_started_again() {
    let dir = tempfile::tempdir().unwrap();
    let mut running = start("hang", "4", dir.path(), &["--set", "nodes.controller.hang_timeout_s=0.5"]);
    let pid = ready(&mut running, "controller");
    signal(pid, libc::SIGSTOP);
    let line = running.wait_for_stderr("restarting it");
    assert!(line.contains("controller") && line.contains("no Health for 0.5 s"), "{line}");
    ready(&mut running, "controller");
    let end = running.finish();
    assert_eq!(end.code(), 0, "{}\n{}", end.stdout, end.stderr);
    gone(pid);
}

fn the_nodes_of_a_killed_launcher_end_in_order_and_leave_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let mut running = start("orphans", "1000", dir.path(), &[]);
    let pids = all_ready(&mut running, ["recorder", "estimator", "controller", "plant"]);
    running.signal(libc::SIGKILL);
    let end = running.finish();
    assert_eq!(end.code(), 128 + libc::SIGKILL);
    assert!(end.stderr.contains("was killed: ending its nodes"), "{}", end.stderr);
    pids.into_iter().for_each(gone);
    no_residue("orphans");
    // The recorder was asked to end, not killed.
    let log = dir.path().join("log.mcap");
    let info = run(["log", "info", log.to_str().unwrap()]).success();
    assert!(info.stdout.contains("complete"), "{}", info.stdout);
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "the log and no lock");
}

/// A launch file with one node replaced.
fn with_node(dir: &Path, section: &str) -> String {
    let path = dir.join("bench.toml");
    let text = format!("vehicle = 'quadrotor'\nduration_s = 1000\n[controller]\nlaw = 'smc'\n{section}");
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_string()
}

#[track_caller]
fn fails(section: &str, code: i32, words: &[&str]) {
    let dir = tempfile::tempdir().unwrap();
    let file = with_node(dir.path(), section);
    let out = dir.path().join("out");
    let end = run(["run", &file, "--out", out.to_str().unwrap()]);
    assert_eq!(end.code(), code, "{}\n{}", end.stdout, end.stderr);
    for word in words {
        assert!(end.stdout.contains(word), "{word:?} is missing in:\n{}\n{}", end.stdout, end.stderr);
    }
    let summary = json(out.join("summary.json"));
    assert_eq!(summary["runs"][0]["ended"]["how"], "failed", "{summary}");
}

fn a_failing_program_ends_the_run_with_its_last_words() {
    let crash = "[nodes.controller]\nexec = ['sh', '-c', 'echo the gain file is empty >&2; exit 3']\n";
    fails(crash, 1, &["controller", "exit code 3", "the gain file is empty"]);
    let missing = "[nodes.controller]\nexec = ['/no/such/program']\n";
    fails(missing, 2, &["controller", "/no/such/program"]);
    let silent = "[nodes.controller]\nexec = ['sleep', '1000']\nready_timeout_s = 0.2\n";
    fails(silent, 1, &["controller", "not ready within 0.2 s", "READY=1", "ready = \"start\""]);
    let helper = "[nodes.helper]\nexec = ['sh', '-c', 'kill -9 $$']\nready = 'start'\nmax_restarts = 2\n";
    fails(helper, 1, &["helper", "SIGKILL", "after 2 restarts"]);
}

fn a_program_learns_of_the_bench_from_its_environment() {
    let dir = tempfile::tempdir().unwrap();
    let seen = dir.path().join("seen");
    let script =
        format!("env | grep -e ^WHIRLSTAND -e ^NOTIFY > {0}.new; mv {0}.new {0}; sleep 1000", seen.display());
    let file =
        with_node(dir.path(), &format!("[nodes.helper]\nexec = ['sh', '-c', '{script}']\nready = 'start'\n"));
    let bench = unique("env");
    let out = dir.path().join("out");
    let running = spawn(whirlstand([
        "run",
        &file,
        "--bench",
        &bench,
        "--transport",
        "zenoh",
        "--out",
        out.to_str().unwrap(),
    ]));
    let until = Instant::now() + HUNG;
    while !seen.exists() {
        assert!(Instant::now() < until, "the helper was never started");
        std::thread::sleep(Duration::from_millis(5));
    }
    let text = std::fs::read_to_string(&seen).unwrap();
    for line in [
        format!("WHIRLSTAND_BENCH={bench}"),
        "WHIRLSTAND_NODE=helper".into(),
        "WHIRLSTAND_TRANSPORT=zenoh".into(),
    ] {
        assert!(text.contains(&line), "{line} is missing in:\n{text}");
    }
    assert!(text.contains("NOTIFY_SOCKET=/") && text.contains("WHIRLSTAND_ZENOH_LISTEN=tls/"), "{text}");
    let key = text.lines().find_map(|l| l.strip_prefix("WHIRLSTAND_ZENOH_CONFIG="));
    let mode = std::fs::metadata(key.expect("a file with the key")).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o600, "only its user reads the key");
    let connect =
        text.lines().find(|l| l.starts_with("WHIRLSTAND_ZENOH_CONNECT=")).expect("addresses of the others");
    assert!(connect.matches("tls/").count() >= 4, "launcher and nodes: {connect}");
    running.signal(libc::SIGTERM);
    assert_eq!(running.finish().code(), 143);
}

fn two_benches_at_once_do_not_disturb_each_other() {
    let dirs = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let both: Vec<Running> = dirs
        .iter()
        .map(|dir| {
            let out = dir.path().to_str().unwrap();
            let args = [
                "run",
                "quadrotor",
                "--mode",
                "lockstep",
                "--duration",
                "20",
                "--set",
                "expect={}",
                "--out",
                out,
            ];
            spawn(whirlstand(args))
        })
        .collect();
    both.into_iter().for_each(|r| {
        r.finish().success();
    });
    let logs = dirs.each_ref().map(|d| d.path().join("log.mcap"));
    let diff = run(["log".as_ref(), "diff".as_ref(), logs[0].as_os_str(), logs[1].as_os_str()]);
    assert_eq!(diff.code(), 0, "{}", diff.stdout);
}

fn a_node_that_must_be_killed_at_the_end_is_told_of_once() {
    let dir = tempfile::tempdir().unwrap();
    // The program is ready once it ignores SIGTERM.
    let script = "trap '' TERM; echo deaf now; while :; do sleep 1; done";
    let deaf =
        format!("nodes.deaf={{exec=[\"sh\", \"-c\", {script:?}], ready=\"start\", stop_timeout_s=0.2}}");
    let mut running = start("deaf", "1000", dir.path(), &["--set", &deaf]);
    running.wait_for_stderr("deaf now");
    running.signal(libc::SIGTERM);
    let end = running.finish();
    let told: Vec<_> = end.stderr.lines().filter(|l| l.contains("deaf") && l.contains("killed")).collect();
    assert_eq!(told, ["deaf did not stop within 0.2 s and was killed"], "{}", end.stderr);
}

whirlstand_test_harness::listed!(
    an_interrupted_run_ends_in_order_with_log_and_report,
    a_killed_node_is_started_again_and_the_loop_recovers,
    a_node_that_hangs_is_killed_and_started_again,
    the_nodes_of_a_killed_launcher_end_in_order_and_leave_nothing,
    a_failing_program_ends_the_run_with_its_last_words,
    a_program_learns_of_the_bench_from_its_environment,
    two_benches_at_once_do_not_disturb_each_other,
    a_node_that_must_be_killed_at_the_end_is_told_of_once,
);
