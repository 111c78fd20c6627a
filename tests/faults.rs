//! Repeated faults at random times: nodes that are killed, stopped or denied memory, a full disk, forged messages,
//! floods, busy processors. The bench survives and reports them.

use std::os::unix::process::CommandExt;
use std::time::Duration;

use crate::support::bench::all_ready;
use crate::support::{FAULTS_ALLOWED, Finished, json, run, spawn, whirlstand};
use serde_json::Value;

/// Twenty faults of a few seconds each.
const LIMIT: Duration = Duration::from_secs(240);

fn soaked(fault: &str, more: &[&str]) -> (Finished, Value) {
    let dir = tempfile::tempdir().unwrap();
    let result = dir.path().join("soak.json");
    let args = ["soak", "--fault", fault, "--json", result.to_str().unwrap()];
    let end = spawn(whirlstand(args.iter().chain(more))).finish_within(LIMIT);
    assert!(result.is_file(), "{}\n{}", end.stdout, end.stderr);
    (end, json(result))
}

#[track_caller]
fn soak(fault: &str, more: &[&str]) -> (Finished, Value) {
    let (end, result) = soaked(fault, more);
    assert_eq!(end.code(), 0, "{}\n{}", end.stdout, end.stderr);
    (end, result)
}

/// Asserts that `faults` faults were injected and that the loop flew again after each.
#[track_caller]
fn assert_all_survived(result: &Value, faults: u64) {
    assert_eq!(result["ok"], true, "{result}");
    assert_eq!((&result["given"], &result["survived"]), (&faults.into(), &faults.into()), "{result}");
    assert!(result["recovery_s_max"].as_f64() >= result["recovery_s_median"].as_f64(), "{result}");
}

/// Smallest count of messages sent in a fault.
fn dealt(result: &Value) -> u64 {
    let faults = result["faults"].as_array().unwrap();
    faults.iter().map(|fault| fault["dealt"].as_u64().unwrap()).min().unwrap()
}

/// Asserts that every fault of every node was followed by a recovery. A node in the command path that was absent for
/// longer than the plant's patience caused a failsafe, and the plant held its last command no longer than stated.
#[track_caller]
fn assert_survived(result: &Value) {
    assert_eq!(result["ok"], true, "{result}");
    let nodes = result["nodes"].as_array().expect("nodes");
    assert_eq!(nodes.len(), 4, "{result}");
    for node in nodes {
        assert_eq!((&node["faults"], &node["recovered"]), (&5.into(), &5.into()), "{node}");
    }
    let patience_s = if result["mode"] == "lockstep" { 0.4 } else { 0.1 };
    let allowed = result["misses_to_failsafe"].as_u64().expect("a limit");
    for fault in result["faults"].as_array().expect("faults") {
        // A node that was only stopped is absent for the whole stop.
        let away_s = fault["restart_s"].as_f64().unwrap_or(2.0);
        let commands = ["estimator", "controller"].iter().any(|n| fault["node"] == *n);
        match fault["held_before_failsafe"].as_u64() {
            Some(held) => assert!(held < allowed, "{fault}"),
            None => assert!(!commands || away_s < patience_s, "no failsafe: {fault}"),
        }
    }
}

fn every_node_can_be_killed_over_shared_memory() {
    assert_survived(&soak("kill", &["--seed", "11"]).1);
}

fn every_node_can_be_killed_over_zenoh() {
    assert_survived(&soak("kill", &["--seed", "12", "--transport", "zenoh"]).1);
}

fn every_node_can_be_killed_in_lockstep() {
    assert_survived(&soak("kill", &["--seed", "13", "--mode", "lockstep"]).1);
}

fn every_node_can_stand_still_for_two_seconds() {
    assert_survived(&soak("stop", &["--seed", "14", "--stop-for", "2"]).1);
}

fn every_node_can_be_without_memory() {
    let result = soak("memory", &["--seed", "15", "--lasting", "0.5", "--rounds", "2"]).1;
    assert_all_survived(&result, 8);
}

/// Below what a process already uses, so that it gets no more memory, not even what it has released.
static NO_MORE: libc::rlimit = libc::rlimit { rlim_cur: 20 << 20, rlim_max: libc::RLIM_INFINITY };
/// No limit.
static AGAIN: libc::rlimit = libc::rlimit { rlim_cur: libc::RLIM_INFINITY, rlim_max: libc::RLIM_INFINITY };

/// Limits the memory of a process.
fn no_more_than(pid: i32, to: &'static libc::rlimit) {
    // SAFETY: prlimit(2) reads a live structure; the null pointer makes it write none.
    let done = unsafe { libc::prlimit(pid, libc::RLIMIT_AS, to, std::ptr::null_mut()) };
    assert_eq!(done, 0, "prlimit of {pid}");
}

/// The nodes of the loop allocate no memory in flight. The recorder does: it ends and is restarted, and the log reports
/// what it lacks.
fn a_limit_of_memory_in_flight_stops_the_recorder_alone_and_the_log_says_what_it_lacks() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().to_str().unwrap();
    let args = ["run", "quadrotor", "--mode", "lockstep", "--duration", "1000 h", "--out", out];
    let more = ["--set", FAULTS_ALLOWED, "--log-level", "debug"];
    let mut bench = spawn(whirlstand(args.into_iter().chain(more)));
    let [recorder, estimator, controller] = all_ready(&mut bench, ["recorder", "estimator", "controller"]);
    bench.wait_for_stderr("steps/s");
    [estimator, controller].into_iter().for_each(|pid| no_more_than(pid, &NO_MORE));
    let line = bench.wait_for_stderr("steps/s");
    assert!(line.contains("lost 0  restarts 0"), "{line}");
    // A new recorder makes the nodes that publish to it allocate memory.
    [estimator, controller].into_iter().for_each(|pid| no_more_than(pid, &AGAIN));
    no_more_than(recorder, &NO_MORE);
    // The recorder reports that the system has no memory left, unless the compressor gets none, whose crate panics.
    let ended = bench.wait_for_stderr("recorder ended with exit code ");
    assert!(ended.contains("restarting it"), "{ended}");
    let line = bench.wait_for_stderr("steps/s");
    assert!(line.contains("restarts 1"), "{line}");
    bench.signal(libc::SIGTERM);
    assert_eq!(bench.finish().code(), 128 + libc::SIGTERM);
    let log: Value = serde_json::from_str(&run(["log", "info", out, "--json"]).success().stdout).unwrap();
    let endings: Vec<&str> =
        log["files"].as_array().unwrap().iter().map(|f| f["ending"].as_str().unwrap()).collect();
    assert_eq!(endings, ["truncated", "complete"], "{log}");
    let topics = log["topics"].as_array().unwrap();
    let topic = |name: &str| topics.iter().find(|t| t["name"] == name).unwrap_or_else(|| panic!("{log}"));
    for name in ["/imu", "/estimate", "/command"] {
        let of = |key: &str| topic(name)[key].as_u64().unwrap();
        // The messages that the recorder had not written when it ended are one gap; every message is present or
        // counted.
        let steps =
            ((topic(name)["to"].as_f64().unwrap() - topic(name)["from"].as_f64().unwrap()) / 0.005).round();
        assert_eq!((of("messages") + of("lost"), of("gaps")), (steps as u64 + 1, 1), "{name}: {log}");
    }
}

/// A restarted recorder cannot receive from a node at its memory limit: the log ends early for its topic, and the run
/// reports this.
fn a_node_that_a_new_recorder_does_not_hear_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().to_str().unwrap();
    let args = ["run", "quadrotor", "--mode", "lockstep", "--duration", "1000 h", "--out", out];
    let mut bench =
        spawn(whirlstand(args.into_iter().chain(["--set", FAULTS_ALLOWED, "--log-level", "debug"])));
    let [recorder, estimator] = all_ready(&mut bench, ["recorder", "estimator"]);
    bench.wait_for_stderr("steps/s");
    no_more_than(estimator, &NO_MORE);
    // SAFETY: kill(2) reads nothing; the process is a child of the bench, which has not reaped it.
    assert_eq!(unsafe { libc::kill(recorder, libc::SIGKILL) }, 0);
    bench.wait_for_stderr("restarting it");
    // The loop continues for longer than the second of data that a killed recorder may leave unwritten.
    for _ in 0..2 {
        let line = bench.wait_for_stderr("steps/s");
        assert!(line.contains("restarts 1"), "{line}");
    }
    bench.signal(libc::SIGTERM);
    let end = bench.finish();
    assert_eq!(end.code(), 128 + libc::SIGTERM);
    assert!(end.stdout.contains("the log has no estimate after "), "{}\n{}", end.stdout, end.stderr);
    let summary: Value =
        serde_json::from_str(&std::fs::read_to_string(dir.path().join("summary.json")).unwrap()).unwrap();
    assert_eq!(summary["ok"], false, "{summary}");
}

fn a_full_disk_costs_only_what_the_log_tells_of() {
    let result = soak("disk", &["--seed", "16", "--lasting", "1", "--rounds", "3"]).1;
    assert_all_survived(&result, 3);
    assert!(result["lost"].as_u64().unwrap() > 100, "the disk was full: {result}");
}

/// Where no file system can be mounted, for lack of permission, the recorder is kept from writing any byte more.
fn without_a_disk_of_its_own_the_recorder_is_not_allowed_to_write() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("soak.json");
    let args = ["soak", "--fault", "disk", "--seed", "20", "--lasting", "1", "--rounds", "2", "--json"];
    let mut command = whirlstand(args.iter().copied().chain([path.to_str().unwrap()]));
    without_namespaces(&mut command);
    let end = spawn(command).finish_within(LIMIT);
    assert_eq!(end.code(), 0, "{}\n{}", end.stdout, end.stderr);
    assert!(end.stderr.contains("cannot mount a file system of its own"), "{}", end.stderr);
    let result = json(&path);
    assert_all_survived(&result, 2);
    assert!(result["lost"].as_u64().unwrap() > 100, "nothing could be written: {result}");
}

/// Refuses unshare(2) to a command and its children (seccomp(2)), like a system that grants its users no namespaces.
fn without_namespaces(command: &mut std::process::Command) {
    let step = |code: u32, jump: (u8, u8), k: u32| libc::sock_filter {
        code: code as u16,
        jt: jump.0,
        jf: jump.1,
        k,
    };
    let refusal = libc::SECCOMP_RET_ERRNO | libc::EPERM as u32;
    // The number of the call comes first in seccomp_data.
    let filter = [
        step(libc::BPF_LD | libc::BPF_W | libc::BPF_ABS, (0, 0), 0),
        step(libc::BPF_JMP | libc::BPF_JEQ | libc::BPF_K, (0, 1), libc::SYS_unshare as u32),
        step(libc::BPF_RET | libc::BPF_K, (0, 0), refusal),
        step(libc::BPF_RET | libc::BPF_K, (0, 0), libc::SECCOMP_RET_ALLOW),
    ];
    // SAFETY: between fork and exec only prctl(2) is called; it reads the program, which the closure owns.
    unsafe {
        command.pre_exec(move || {
            let mut steps = filter;
            let program = libc::sock_fprog { len: steps.len() as u16, filter: steps.as_mut_ptr() };
            let failed = libc::prctl(libc::PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0
                || libc::prctl(libc::PR_SET_SECCOMP, libc::SECCOMP_MODE_FILTER, &raw const program) != 0;
            if failed { Err(std::io::Error::last_os_error()) } else { Ok(()) }
        });
    }
}

fn nobody_without_a_key_is_believed() {
    let zenoh = ["--transport", "zenoh", "--mode", "lockstep"];
    let more = [&["--seed", "17", "--lasting", "1", "--rounds", "2"], &zenoh[..]].concat();
    let result = soak("forge", &more).1;
    assert_all_survived(&result, 2);
    assert_eq!(result["lost"], 0, "{result}");
    assert!(dealt(&result) > 100, "forged: {result}");
}

/// The positive control of this fault: on an open bench the same forged messages are accepted, and the soak reports
/// this.
fn on_an_open_bench_the_forgers_are_found_out() {
    let more = ["--seed", "17", "--transport", "zenoh", "--set", "security.mode=open", "--rounds", "1"];
    let (end, result) = soaked("forge", &more);
    assert_eq!(end.code(), 1, "{}\n{}", end.stdout, end.stderr);
    let problems = result["problems"].as_array().unwrap();
    let told = |words: &str| problems.iter().any(|p| p.as_str().unwrap().contains(words));
    assert!(told("forged messages were accepted"), "{result}");
}

fn a_flood_of_disturbances_costs_no_message() {
    // In real time a network that falls behind for a millisecond drops messages, as it would on a busy test
    // machine.
    for (transport, mode) in [("iceoryx2", "realtime"), ("zenoh", "lockstep")] {
        let bench = ["--transport", transport, "--mode", mode];
        let more = [&["--seed", "18", "--lasting", "1", "--rounds", "2"], &bench[..]].concat();
        let result = soak("flood", &more).1;
        assert_all_survived(&result, 2);
        assert!(dealt(&result) > 500, "{result}");
    }
}

/// In real time a network that falls behind, as on a busy machine, drops messages: the loop keeps flying, and what the
/// log lacks is reported.
fn a_flood_in_real_time_over_zenoh_is_survived_and_its_losses_are_told() {
    let more =
        ["--seed", "21", "--lasting", "1", "--rounds", "2", "--transport", "zenoh", "--mode", "realtime"];
    let (end, result) = soaked("flood", &more);
    assert_eq!((&result["given"], &result["survived"]), (&2.into(), &2.into()), "{result}");
    assert!(dealt(&result) > 500, "{result}");
    let problems = result["problems"].as_array().unwrap();
    assert!(problems.iter().all(|p| p.as_str().unwrap().starts_with("recorder lost ")), "{result}");
    assert_eq!(end.code(), i32::from(!problems.is_empty()), "{}", end.stderr);
}

fn busy_processors_cost_time_and_no_message() {
    for mode in ["realtime", "lockstep"] {
        let result = soak("load", &["--seed", "19", "--lasting", "1", "--rounds", "2", "--mode", mode]).1;
        assert_all_survived(&result, 2);
    }
}

/// A fault that does not fit the bench is refused, with what is expected.
fn a_fault_without_a_place_is_refused() {
    for (args, words) in [
        (&["--fault", "forge"][..], "--transport zenoh"),
        (&["--fault", "disk", "--mode", "lockstep"], "--mode realtime"),
        (&["--fault", "disk", "--set", "recorder.enabled=false"], "a bench that records"),
        (&["--fault", "flood", "--node", "plant"], "not to a node"),
        (&["--fault", "stop", "--lasting", "0"], "not a positive time"),
    ] {
        let end = run(["soak"].iter().chain(args));
        assert_eq!(end.code(), 2, "{args:?}\n{}", end.stderr);
        assert!(end.stderr.contains(words), "{args:?}\n{}", end.stderr);
    }
}

whirlstand_test_harness::listed!(
    every_node_can_be_killed_over_shared_memory,
    every_node_can_be_killed_over_zenoh,
    every_node_can_be_killed_in_lockstep,
    every_node_can_stand_still_for_two_seconds,
    every_node_can_be_without_memory,
    a_limit_of_memory_in_flight_stops_the_recorder_alone_and_the_log_says_what_it_lacks,
    a_node_that_a_new_recorder_does_not_hear_is_told,
    a_full_disk_costs_only_what_the_log_tells_of,
    without_a_disk_of_its_own_the_recorder_is_not_allowed_to_write,
    nobody_without_a_key_is_believed,
    on_an_open_bench_the_forgers_are_found_out,
    a_flood_of_disturbances_costs_no_message,
    a_flood_in_real_time_over_zenoh_is_survived_and_its_losses_are_told,
    busy_processors_cost_time_and_no_message,
    a_fault_without_a_place_is_refused,
);
