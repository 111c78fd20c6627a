//! Disturbance rejection in realtime, as `rejection.rs` has it in lockstep: every vehicle and every law, with noise and
//! vibration on, over shared memory and over the network.

use std::path::Path;
use std::sync::{Mutex, PoisonError};

use crate::support::gusts::{Flown, assert_rejected, fly_all, start};
use crate::support::json;
use whirlstand_test_harness::{Outcome, in_real_time, wait_for_rest};

/// Covers every vehicle and every law: a realtime run without a miss leaves the log of lockstep (`determinism.rs`), so
/// these flights show that nothing is late.
const IN_REALTIME: [&str; 4] =
    ["quadrotor-smc", "helicopter-hover-lqr", "helicopter-lateral-ppc", "helicopter-longitudinal-smc"];

/// Number of concurrent flights: a late node costs a step.
const AT_ONCE: usize = 2;

/// Number of times that a realtime flight delayed by the machine is repeated by itself.
const AGAIN: usize = 3;

/// Realtime flights of one test at a time: late commands are due to the machine, which is not tested here.
static CLOCK: Mutex<()> = Mutex::new(());

/// Whether commands were so late that they were lost, or that the plant went into its failsafe.
fn held_up(out: &Path) -> bool {
    let timing = &json(out.join("summary.json"))["timing"];
    ["lost", "failsafe_steps"].iter().any(|key| timing[*key].as_u64().expect("a count") > 0)
}

/// A flight that the machine delayed is repeated by itself, and the repetition is judged.
fn in_realtime(transport: &str) -> Outcome {
    let _alone = CLOCK.lock().unwrap_or_else(PoisonError::into_inner);
    let dir = tempfile::tempdir().unwrap();
    let mut outcome = Ok(());
    fly_all((&IN_REALTIME, AT_ONCE), ("realtime", transport), dir.path(), |Flown { launch, end, out }| {
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

fn in_realtime_over_shared_memory() -> Outcome {
    in_realtime("iceoryx2")
}

fn in_realtime_over_zenoh() -> Outcome {
    in_realtime("zenoh")
}

whirlstand_test_harness::listed!(in_realtime_over_shared_memory, in_realtime_over_zenoh);
