//! Flights under the gust of the paper's Figures 10 to 12, several at a time, and what a good end of one is.

use std::path::{Path, PathBuf};

use super::{Finished, Running, json, spawn, whirlstand};

/// The gust acts at 6 s, and the slowest loop has recovered 14 s later.
const LONG_ENOUGH_S: &str = "24";

/// Starts a flight of a built-in launch file.
pub fn start(launch: &str, mode: &str, transport: &str, out: &Path) -> Running {
    let args = ["run", launch, "--mode", mode, "--transport", transport, "--out", out.to_str().unwrap()];
    // The launch files of the quadrotor end at 12 s, long after its recovery.
    let shorter = (!launch.starts_with("quadrotor")).then_some(["--duration", LONG_ENOUGH_S]);
    spawn(whirlstand(args.into_iter().chain(shorter.into_iter().flatten())))
}

/// Asserts that the run succeeded, including its limits, that these limits exist unless flown by hand, and that a gust
/// acted.
#[track_caller]
pub fn assert_rejected(what: &str, end: Finished, out: &Path) {
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

/// A flight that has ended, and where its files are.
pub struct Flown<'a> {
    pub launch: &'a str,
    pub end: Finished,
    pub out: PathBuf,
}

/// Flies these in batches of `at_once`, and passes each flight to `judge` once its batch has ended.
pub fn fly_all(
    (flights, at_once): (&'static [&str], usize),
    (mode, transport): (&str, &str),
    dir: &Path,
    mut judge: impl FnMut(Flown),
) {
    for batch in flights.chunks(at_once) {
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
