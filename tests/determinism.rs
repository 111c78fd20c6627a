//! The same seed gives the same log, bit for bit, over every transport, in lockstep and in real time.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use crate::support::{json, run};

/// Short enough for every transport, long enough for the reference step and the disturbance.
const DURATION_S: &str = "3";

/// A rate at which a shared machine can meet every deadline.
const SLOW: [&str; 2] = ["--set", "rate_hz=50"];

fn fly(out: &Path, launch: &str, mode: &str, transport: &str, seed: &str) -> PathBuf {
    fly_with(&[], out, launch, mode, transport, seed)
}

fn fly_with(set: &[&str], out: &Path, launch: &str, mode: &str, transport: &str, seed: &str) -> PathBuf {
    let disturbed_early = ["--set", "effects.0.at_s=1.5"];
    let out_arg = out.to_str().expect("utf-8 path");
    run([
        "run",
        launch,
        "--mode",
        mode,
        "--transport",
        transport,
        "--seed",
        seed,
        "--duration",
        DURATION_S,
        "--out",
        out_arg,
    ]
    .into_iter()
    .chain(disturbed_early)
    .chain(["--set", "expect={}"])
    .chain(set.iter().copied()))
    .success();
    out.join("log.mcap")
}

#[track_caller]
fn assert_same(a: &Path, b: &Path) {
    let diff = run(["log".as_ref(), "diff".as_ref(), a.as_os_str(), b.as_os_str()]);
    assert_eq!(diff.code(), 0, "{}\n{}", diff.stdout, diff.stderr);
}

fn lockstep_logs_are_the_same_over_every_transport_and_twice_in_a_row() {
    let dir = tempfile::tempdir().unwrap();
    for launch in ["quadrotor", "helicopter-hover-lqr"] {
        let reference = fly(&dir.path().join(format!("{launch}-0")), launch, "lockstep", "iceoryx2", "7");
        for (i, transport) in ["iceoryx2", "zenoh", "inproc"].into_iter().enumerate() {
            let again =
                fly(&dir.path().join(format!("{launch}-{}", i + 1)), launch, "lockstep", transport, "7");
            assert_same(&reference, &again);
        }
    }
}

/// Two threads per processor that keep it busy until this is dropped.
struct Busy {
    over: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Busy {
    fn begin() -> Self {
        let over = Arc::new(AtomicBool::new(false));
        let busy = |_| {
            let over = Arc::clone(&over);
            std::thread::spawn(move || {
                while !over.load(Ordering::Relaxed) {
                    std::hint::spin_loop();
                }
            })
        };
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        let threads = (0..2 * processors).map(busy).collect();
        Self { over, threads }
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        self.threads.drain(..).for_each(|thread| _ = thread.join());
    }
}

/// Lockstep uses no wall clock, so an overloaded machine does not change the result.
fn busy_processors_change_no_bit_of_a_lockstep_flight() {
    let dir = tempfile::tempdir().unwrap();
    let reference = fly(&dir.path().join("alone"), "quadrotor", "lockstep", "inproc", "5");
    let _busy = Busy::begin();
    for transport in ["iceoryx2", "zenoh", "inproc"] {
        let log = fly(&dir.path().join(transport), "quadrotor", "lockstep", transport, "5");
        assert_same(&reference, &log);
    }
}

fn another_seed_differs_and_the_first_differing_sample_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let a = fly(&dir.path().join("a"), "quadrotor", "lockstep", "inproc", "1");
    let b = fly(&dir.path().join("b"), "quadrotor", "lockstep", "inproc", "2");
    let diff = run(["log".as_ref(), "diff".as_ref(), a.as_os_str(), b.as_os_str()]);
    assert_eq!(diff.code(), 1, "{}\n{}", diff.stdout, diff.stderr);
    assert!(diff.stdout.contains("imu") && diff.stdout.contains("step 0"), "{}", diff.stdout);
}

/// A shared machine may delay any single run, but one of a few runs must have no deadline miss.
fn realtime_without_a_miss_gives_the_log_of_lockstep() {
    let dir = tempfile::tempdir().unwrap();
    let reference = fly_with(&SLOW, &dir.path().join("lockstep"), "quadrotor", "lockstep", "iceoryx2", "11");
    for transport in ["iceoryx2", "zenoh"] {
        let mut misses = Vec::new();
        let unmissed = (0..16).find_map(|attempt| {
            let out = dir.path().join(format!("{transport}-{attempt}"));
            let log = fly_with(&SLOW, &out, "quadrotor", "realtime", transport, "11");
            let missed =
                json(out.join("summary.json"))["timing"]["deadline_misses"].as_u64().expect("a count");
            misses.push(missed);
            (missed == 0).then_some(log)
        });
        let log = unmissed.unwrap_or_else(|| panic!("{transport}: every run missed deadlines: {misses:?}"));
        assert_same(&reference, &log);
    }
}

whirlstand_test_harness::listed!(
    lockstep_logs_are_the_same_over_every_transport_and_twice_in_a_row,
    busy_processors_change_no_bit_of_a_lockstep_flight,
    another_seed_differs_and_the_first_differing_sample_is_named,
    realtime_without_a_miss_gives_the_log_of_lockstep,
);
