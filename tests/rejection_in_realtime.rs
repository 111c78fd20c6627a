//! Disturbance rejection in realtime, as `rejection.rs` has it in lockstep: every vehicle and every law, with noise and
//! vibration on, over shared memory and over the network.

use crate::support::gusts::{Flown, assert_rejected, fly_all};
use whirlstand_test_harness::{Outcome, in_real_time};

/// Covers every vehicle and every law: a realtime run without a miss leaves the log of lockstep (`determinism.rs`), so
/// these flights show that nothing is late.
const OVER_SHARED_MEMORY: [&str; 4] =
    ["quadrotor-smc", "helicopter-hover-lqr", "helicopter-lateral-ppc", "helicopter-longitudinal-smc"];

/// Over a network only the messages differ: those of a vehicle with few outputs, and with the most.
const OVER_ZENOH: [&str; 2] = ["quadrotor-smc", "helicopter-hover-lqr"];

/// Number of concurrent flights: a late node costs a step.
const AT_ONCE: usize = 2;

fn in_realtime(flights: &'static [&str], transport: &str) -> Outcome {
    let dir = tempfile::tempdir().unwrap();
    in_real_time(|| {
        fly_all((flights, AT_ONCE), ("realtime", transport), dir.path(), |Flown { launch, end, out }| {
            assert_rejected(&format!("{launch}, realtime, {transport}"), end, &out);
        });
    })
}

fn in_realtime_over_shared_memory() -> Outcome {
    in_realtime(&OVER_SHARED_MEMORY, "iceoryx2")
}

fn in_realtime_over_zenoh() -> Outcome {
    in_realtime(&OVER_ZENOH, "zenoh")
}

// Late commands are due to the machine, which is not tested here.
whirlstand_test_harness::listed_one_at_a_time!(
    "two flights that must not be late":
    in_realtime_over_shared_memory,
    in_realtime_over_zenoh,
);
