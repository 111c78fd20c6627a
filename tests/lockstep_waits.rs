//! Lockstep uses no wall clock: a bench whose nodes are stopped for any length of time flies the same flight.

use std::path::Path;

use crate::support::bench::{all_ready, ready, signal};
use crate::support::{json, run, spawn, whirlstand};

/// Long enough that every node can be stopped within it; over a network a step takes several times as long.
fn duration_s(transport: &str) -> &'static str {
    if transport == "zenoh" { "120" } else { "200" }
}

fn flight<'a>(out: &'a str, transport: &'a str, duration: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    // A stopped node sends no health messages, and would be killed for that.
    let patient = [
        "nodes.plant.hang_timeout_s=100",
        "nodes.estimator.hang_timeout_s=100",
        "nodes.controller.hang_timeout_s=100",
        "nodes.recorder.hang_timeout_s=100",
        "plant.start_timeout_s=100",
    ];
    let set = patient.into_iter().flat_map(|key| ["--set", key]);
    ["run", "quadrotor", "--mode", "lockstep", "--duration", duration, "--transport", transport, "--out", out]
        .into_iter()
        .chain(set)
        .chain(more.iter().copied())
        .collect()
}

#[track_caller]
fn assert_same(a: &Path, b: &Path) {
    let diff = run(["log".as_ref(), "diff".as_ref(), a.as_os_str(), b.as_os_str()]);
    assert_eq!(diff.code(), 0, "{}\n{}", diff.stdout, diff.stderr);
}

fn nodes_that_stand_still_change_nothing_over_iceoryx2() {
    nodes_that_stand_still_change_nothing("iceoryx2");
}

fn nodes_that_stand_still_change_nothing_over_zenoh() {
    nodes_that_stand_still_change_nothing("zenoh");
}

fn nodes_that_stand_still_change_nothing(transport: &str) {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().expect("utf-8 path").to_string();
    let reference = path("reference");
    run(flight(&reference, "inproc", duration_s(transport), &[])).success();
    let out = path(transport);
    let told = ["--log-level", "debug"];
    let mut bench = spawn(whirlstand(flight(&out, transport, duration_s(transport), &told)));
    let nodes = ["estimator", "controller", "recorder"];
    let pids = all_ready(&mut bench, nodes);
    if transport == "zenoh" {
        // Waits until the loop runs: a link made while one end is stopped begins with a gap for the recorder.
        bench.wait_for_stderr("steps/s  misses 0");
    }
    for (node, pid) in nodes.into_iter().zip(pids) {
        signal(pid, libc::SIGSTOP);
        bench.wait_for_stderr(&format!("waiting for the {node}"));
        signal(pid, libc::SIGCONT);
    }
    bench.finish().success();
    let timing = &json(dir.path().join(transport).join("summary.json"))["timing"];
    assert_eq!((&timing["deadline_misses"], &timing["lost"]), (&0.into(), &0.into()), "{timing}");
    assert_same(&Path::new(&reference).join("log.mcap"), &Path::new(&out).join("log.mcap"));
}

fn an_answer_timeout_is_for_those_who_ask_for_one() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().to_str().expect("utf-8 path");
    let args = ["run", "quadrotor", "--no-log", "--mode", "lockstep", "--duration", "1000 h", "--out", out];
    let more = ["--answer-timeout", "100 ms", "--log-level", "debug"];
    let mut bench = spawn(whirlstand(args.into_iter().chain(more)));
    let pid = ready(&mut bench, "controller");
    bench.wait_for_stderr("steps/s");
    signal(pid, libc::SIGSTOP);
    bench.wait_for_stderr("FAILSAFE");
    signal(pid, libc::SIGCONT);
    bench.wait_for_stderr("failsafe ended");
    bench.signal(libc::SIGTERM);
    assert_eq!(bench.finish().code(), 143);
}

whirlstand_test_harness::listed!(
    nodes_that_stand_still_change_nothing_over_iceoryx2,
    nodes_that_stand_still_change_nothing_over_zenoh,
    an_answer_timeout_is_for_those_who_ask_for_one,
);
