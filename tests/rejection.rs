//! Disturbance rejection, the paper's Figures 10 to 12: every vehicle under every law, with noise and vibration on,
//! over shared memory and over the network in lockstep, and every vehicle and every law in realtime. The limits on peak
//! and recovery in each launch file decide.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use crate::support::{Finished, Running, json, spawn, whirlstand};
use whirlstand_test_harness::{Outcome, in_real_time, wait_for_rest};

/// Every vehicle under every law.
const FLIGHTS: [&str; 12] = [
    "quadrotor-lqr",
    "quadrotor-ppc",
    "quadrotor-smc",
    "helicopter-hover-lqr",
    "helicopter-hover-ppc",
    "helicopter-hover-smc",
    "helicopter-lateral-lqr",
    "helicopter-lateral-ppc",
    "helicopter-lateral-smc",
    "helicopter-longitudinal-lqr",
    "helicopter-longitudinal-ppc",
    "helicopter-longitudinal-smc",
];

/// Covers every vehicle and every law: a realtime run without a miss leaves the log of lockstep (`determinism.rs`), so
/// these flights show that nothing is late.
const IN_REALTIME: [&str; 4] =
    ["quadrotor-smc", "helicopter-hover-lqr", "helicopter-lateral-ppc", "helicopter-longitudinal-smc"];

/// The gust acts at 6 s, and the slowest loop has recovered 14 s later.
const LONG_ENOUGH_S: &str = "24";

/// Number of concurrent realtime flights: they need little processor time, but a late node costs a step.
const AT_ONCE: usize = 6;

/// Number of times that a realtime flight delayed by the machine is repeated by itself.
const AGAIN: usize = 3;

/// Realtime flights of one test at a time: late commands are due to the machine, which is not tested here.
static CLOCK: Mutex<()> = Mutex::new(());

fn start(launch: &str, mode: &str, transport: &str, out: &Path) -> Running {
    let args = ["run", launch, "--mode", mode, "--transport", transport, "--out", out.to_str().unwrap()];
    // The launch files of the quadrotor end at 12 s, long after its recovery.
    let shorter = (!launch.starts_with("quadrotor")).then_some(["--duration", LONG_ENOUGH_S]);
    spawn(whirlstand(args.into_iter().chain(shorter.into_iter().flatten())))
}

/// Asserts that the run succeeded, including its limits, that these limits exist unless flown by hand, and that a gust
/// acted.
#[track_caller]
fn assert_rejected(what: &str, end: Finished, out: &Path) {
    assert_eq!(end.code(), 0, "{what}\n{}\n{}", end.stdout, end.stderr);
    let summary = json(out.join("summary.json"));
    for run in summary["runs"].as_array().expect("runs") {
        let limits: Vec<_> =
            run["expect"].as_array().unwrap().iter().map(|e| e["key"].as_str().unwrap()).collect();
        let manual = run["law"].as_str() == Some("manual");
        for kind in ["peak", "recovery_s"] {
            let held = limits.iter().any(|key| key.ends_with(kind));
            assert!(held || manual, "{what}: nothing limits {kind} in {limits:?}");
        }
        assert_eq!(run["disturbances"][0]["at_s"], 6.0, "{what}: {run}");
    }
}

/// Whether commands were so late that they were lost, or that the plant went into its failsafe.
fn held_up(out: &Path) -> bool {
    let timing = &json(out.join("summary.json"))["timing"];
    ["lost", "failsafe_steps"].iter().any(|key| timing[*key].as_u64().expect("a count") > 0)
}

/// A flight that has ended, and where its files are.
struct Flown<'a> {
    launch: &'a str,
    end: Finished,
    out: PathBuf,
}

/// Flies these in batches, and passes each flight to `judge` once its batch has ended.
fn fly_all(flights: &'static [&str], mode: &str, transport: &str, dir: &Path, mut judge: impl FnMut(Flown)) {
    for batch in flights.chunks(AT_ONCE) {
        let started: Vec<_> = batch
            .iter()
            .map(|launch| {
                let out = dir.join(launch);
                (launch, start(launch, mode, transport, &out), out)
            })
            .collect();
        // All must have ended before one of them is repeated by itself.
        let ended: Vec<_> = started
            .into_iter()
            .map(|(launch, flight, out)| Flown { launch, end: flight.finish(), out })
            .collect();
        ended.into_iter().for_each(&mut judge);
    }
}

fn in_lockstep(transport: &str) {
    let dir = tempfile::tempdir().unwrap();
    fly_all(&FLIGHTS, "lockstep", transport, dir.path(), |Flown { launch, end, out }| {
        assert_rejected(&format!("{launch}, lockstep, {transport}"), end, &out);
    });
}

/// A flight that the machine delayed is repeated by itself, and the repetition is judged.
fn in_realtime(transport: &str) -> Outcome {
    let _alone = CLOCK.lock().unwrap_or_else(PoisonError::into_inner);
    let dir = tempfile::tempdir().unwrap();
    let mut outcome = Ok(());
    fly_all(&IN_REALTIME, "realtime", transport, dir.path(), |Flown { launch, end, out }| {
        let what = format!("{launch}, realtime, {transport}");
        if end.code() > 1 || !held_up(&out) {
            return assert_rejected(&what, end, &out);
        }
        let alone = in_real_time(|| {
            let (mut end, mut out) = (end, out);
            for attempt in 1..=AGAIN {
                wait_for_rest();
                out = dir.path().join(format!("{launch}-{attempt}"));
                end = start(launch, "realtime", transport, &out).finish();
                if end.code() > 1 || !held_up(&out) {
                    break;
                }
            }
            assert_rejected(&what, end, &out);
        });
        if alone.is_err() {
            outcome = alone;
        }
    });
    outcome
}

fn in_lockstep_over_shared_memory() {
    in_lockstep("iceoryx2");
}

fn in_lockstep_over_zenoh() {
    in_lockstep("zenoh");
}

fn in_realtime_over_shared_memory() -> Outcome {
    in_realtime("iceoryx2")
}

fn in_realtime_over_zenoh() -> Outcome {
    in_realtime("zenoh")
}

fn the_laws_of_a_comparison_fly_one_after_the_other_into_one_report() {
    let dir = tempfile::tempdir().unwrap();
    for (launch, variants) in [("quadrotor", 1), ("quadrotor-compare", 3), ("helicopter-hover-compare", 2)] {
        let out = dir.path().join(launch);
        let args = ["run", launch, "--mode", "lockstep", "--out", out.to_str().unwrap()];
        assert_rejected(launch, spawn(whirlstand(args)).finish(), &out);
        assert_eq!(json(out.join("summary.json"))["runs"].as_array().unwrap().len(), variants, "{launch}");
        assert!(out.join("report.html").is_file());
    }
}

whirlstand_test_harness::listed!(
    in_lockstep_over_shared_memory,
    in_lockstep_over_zenoh,
    in_realtime_over_shared_memory,
    in_realtime_over_zenoh,
    the_laws_of_a_comparison_fly_one_after_the_other_into_one_report,
);
