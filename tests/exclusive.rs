//! The resources that a run holds exclusively: its folder and its bench name, whatever else runs and however the
//! previous run ended.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use crate::support::bench::{all_ready, no_residue, unique};
use crate::support::{FAULTS_ALLOWED, Finished, Running, json, run, spawn, whirlstand};

const NODES: [&str; 4] = ["recorder", "estimator", "controller", "plant"];

/// The command of a run that lasts `duration` in bench time.
fn start(bench: Option<&str>, out: Option<&Path>, duration: &str, more: &[&str]) -> std::process::Command {
    let mut command = whirlstand(["run", "quadrotor", "--duration", duration, "--set", FAULTS_ALLOWED]);
    command.args(["--log-level", "debug"]).args(more);
    if let Some(bench) = bench {
        command.args(["--bench", bench]);
    }
    if let Some(out) = out {
        command.arg("--out").arg(out);
    }
    command
}

/// Ends a run by Ctrl-C; its summary must report no problem caused by another run.
#[track_caller]
fn interrupted(running: Running, out: &Path) {
    running.signal(libc::SIGINT);
    let end = running.finish();
    assert_eq!(end.code(), 130, "{}\n{}", end.stdout, end.stderr);
    let summary = json(out.join("summary.json"));
    assert!(summary["runs"][0]["problems"].as_array().unwrap().is_empty(), "{summary}");
}

/// Asserts that the run was refused with an error that the user can correct, and that the message names the other run.
#[track_caller]
fn refused(end: &Finished, holder: &Running, words: &[&str]) {
    assert_eq!(end.code(), 2, "{}\n{}", end.stdout, end.stderr);
    let process = format!("process {} since 2", holder.pid());
    for word in words.iter().chain([&process.as_str()]) {
        assert!(end.stderr.contains(word), "{word:?} is missing in:\n{}", end.stderr);
    }
}

fn a_folder_that_a_run_writes_into_is_refused_to_another_and_free_afterwards() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let mut first = spawn(start(None, Some(&out), "1000", &[]));
    all_ready(&mut first, NODES);
    let log = out.join("log.mcap");
    let inode = log.metadata().unwrap().ino();

    let second = spawn(start(None, Some(&out), "1", &[])).finish();
    refused(&second, &first, &[out.to_str().unwrap(), "--out"]);
    assert_eq!(log.metadata().unwrap().ino(), inode, "the log of the first run is untouched");
    // Another path of the same folder does not bypass the lock.
    let round = out.join("../out");
    refused(&spawn(start(None, Some(&round), "1", &[])).finish(), &first, &["--out"]);

    interrupted(first, &out);
    let again = spawn(start(None, Some(&out), "1", &["--mode", "lockstep"])).finish().success();
    assert!(again.stdout.contains("completed"), "{}", again.stdout);
    assert_eq!(json(out.join("summary.json"))["runs"][0]["steps"], 200);
}

fn a_bench_name_belongs_to_one_run_on_every_transport() {
    for transport in ["iceoryx2", "zenoh", "inproc"] {
        let dir = tempfile::tempdir().unwrap();
        let (out, other) = (dir.path().join("first"), dir.path().join("second"));
        let bench = unique(&format!("name-{transport}"));
        let over = ["--transport", transport];
        let mut first = spawn(start(Some(&bench), Some(&out), "1000", &over));
        match transport {
            "inproc" => _ = first.wait_for_stderr("quadrotor: quadrotor under smc"),
            _ => _ = all_ready(&mut first, NODES),
        }
        let second = spawn(start(Some(&bench), Some(&other), "1", &over)).finish();
        refused(&second, &first, &[&bench, "--bench"]);
        assert!(!other.exists(), "a run that is refused leaves no folder");
        interrupted(first, &out);
        spawn(start(Some(&bench), Some(&other), "1", &over)).finish().success();
        no_residue(&format!("name-{transport}"));
    }
}

fn of_two_runs_that_start_at_once_under_one_name_one_flies_and_counts_its_own_steps() {
    let dir = tempfile::tempdir().unwrap();
    let bench = unique("race");
    let outs = [dir.path().join("a"), dir.path().join("b")];
    let long = ["--mode", "lockstep"];
    let both = outs.each_ref().map(|out| spawn(start(Some(&bench), Some(out), "300", &long)));
    let ends = both.map(Running::finish);
    let mut codes = ends.each_ref().map(Finished::code);
    let winner = &outs[codes.iter().position(|&code| code == 0).expect("one of them flies")];
    assert_eq!(json(winner.join("summary.json"))["runs"][0]["steps"], 60_000);
    codes.sort_unstable();
    assert_eq!(codes, [0, 2], "{}\n{}", ends[0].stderr, ends[1].stderr);
}

fn runs_without_a_folder_each_make_their_own() {
    let dir = tempfile::tempdir().unwrap();
    let three = [(); 3].map(|()| {
        let mut command = start(None, None, "1", &["--mode", "lockstep"]);
        command.current_dir(dir.path());
        spawn(command)
    });
    three.into_iter().for_each(|run| _ = run.finish().success());
    let folders: Vec<PathBuf> =
        std::fs::read_dir(dir.path().join("out")).unwrap().map(|e| e.unwrap().path()).collect();
    assert_eq!(folders.len(), 3, "{folders:?}");
    for folder in folders {
        assert_eq!(json(folder.join("summary.json"))["runs"][0]["steps"], 200, "{}", folder.display());
        let info = run(["log", "info", folder.join("log.mcap").to_str().unwrap()]).success();
        assert!(info.stdout.contains("complete"), "{}", info.stdout);
        assert!(!folder.join(".whirlstand.lock").exists());
    }
}

fn what_a_killed_launcher_held_is_free_as_soon_as_its_nodes_have_ended() {
    let dir = tempfile::tempdir().unwrap();
    let bench = unique("freed");
    let mut first = spawn(start(Some(&bench), Some(dir.path()), "1000", &[]));
    all_ready(&mut first, NODES);
    first.signal(libc::SIGKILL);
    let next = spawn(start(Some(&bench), Some(dir.path()), "1", &["--mode", "lockstep"])).finish();
    assert_eq!(next.code(), 0, "{}\n{}", next.stdout, next.stderr);
    assert_eq!(json(dir.path().join("summary.json"))["runs"][0]["steps"], 200);
    drop(first);
    no_residue("freed");
}

whirlstand_test_harness::listed!(
    a_folder_that_a_run_writes_into_is_refused_to_another_and_free_afterwards,
    a_bench_name_belongs_to_one_run_on_every_transport,
    of_two_runs_that_start_at_once_under_one_name_one_flies_and_counts_its_own_steps,
    runs_without_a_folder_each_make_their_own,
    what_a_killed_launcher_held_is_free_as_soon_as_its_nodes_have_ended,
);
