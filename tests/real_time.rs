//! Whole-process tests that wait for most of their time, for flights in real time and time limits to end. Twice as many
//! run at a time as there are processors.

mod autopilot_checks;
mod autopilot_faults;
mod autopilots;
mod betaflight;
mod bridge_check;
mod bridge_crsf;
mod bridge_mavlink;
mod bridge_peers;
mod bridge_restart;
mod bridge_verdict;
mod foxglove;
mod hosts;
mod interop;
mod live;
mod live_stick;
mod log_segments;
mod mirror_bridged;
mod mirror_crsf;
mod pages;
mod px4_station;
mod rejection_in_realtime;
mod residue;
mod supervisor;
mod support;
mod verdict;

// The longest first, so that none is left to run alone at the end; of those that run one at a time, the sum counts.
whirlstand_test_harness::suites!(
    whirlstand_test_harness::run_waiting:
    mirror_bridged,
    mirror_crsf,
    residue,
    rejection_in_realtime,
    betaflight,
    bridge_mavlink,
    bridge_crsf,
    px4_station,
    bridge_check,
    autopilot_checks,
    autopilot_faults,
    bridge_verdict,
    live_stick,
    autopilots,
    live,
    pages,
    bridge_peers,
    supervisor,
    verdict,
    interop,
    hosts,
    log_segments,
    bridge_restart,
    foxglove,
);
