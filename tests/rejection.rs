//! Disturbance rejection, the paper's Figures 10 to 12, with noise and vibration on: every vehicle under every law in
//! lockstep over shared memory, and every vehicle and every law over the network; `rejection_in_realtime.rs` has every
//! vehicle and every law in realtime. The limits on peak and recovery in each launch file decide.

use crate::support::gusts::{Flown, assert_rejected, fly_all};
use crate::support::{json, spawn, whirlstand};

/// Every vehicle under every law.
const OVER_SHARED_MEMORY: [&str; 12] = [
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

/// Every vehicle and every law: in lockstep, logs are the same over every transport (`determinism.rs`).
const OVER_ZENOH: [&str; 4] =
    ["quadrotor-ppc", "helicopter-hover-smc", "helicopter-lateral-lqr", "helicopter-longitudinal-ppc"];

/// Number of concurrent flights: processors wait for the bus in between.
const AT_ONCE: usize = 6;

fn in_lockstep(flights: &'static [&str], transport: &str) {
    let dir = tempfile::tempdir().unwrap();
    fly_all((flights, AT_ONCE), ("lockstep", transport), dir.path(), |Flown { launch, end, out }| {
        assert_rejected(&format!("{launch}, lockstep, {transport}"), end, &out);
    });
}

fn in_lockstep_over_shared_memory() {
    in_lockstep(&OVER_SHARED_MEMORY, "iceoryx2");
}

fn in_lockstep_over_zenoh() {
    in_lockstep(&OVER_ZENOH, "zenoh");
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
    the_laws_of_a_comparison_fly_one_after_the_other_into_one_report,
);
