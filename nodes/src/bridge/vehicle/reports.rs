//! Reports of a bridge to a vehicle: its state while it runs, and its counts at the end.

use whirlstand_bridge::arming::Mode;
use whirlstand_bridge::vehicle::Figures;
use whirlstand_msgs::NodeState;

/// State that the node reports while the loop runs.
pub(super) fn state(mode: Mode) -> NodeState {
    match mode {
        Mode::Disarmed => NodeState::Disarmed,
        Mode::Manual => NodeState::Manual,
        Mode::Automatic => NodeState::Running,
        Mode::Failed(_) => NodeState::Failsafe,
    }
}

/// Reports the counts of the bridge at its end.
pub(super) fn tell_figures(f: &Figures, dropped: u64) {
    tracing::info!(
        messages = f.messages,
        dropped = f.dropped,
        signature = f.signature,
        noise_bytes = f.noise_bytes,
        lost = f.lost,
        refused = f.refused,
        outputs = f.outputs,
        clamped = f.clamped,
        unsent = dropped,
        unforwarded = f.unforwarded,
        clock_offset_ms = f.clock_offset_ns.map(|ns| ns / 1_000_000),
        round_trip_us = f.round_trip_ns.map(|ns| ns / 1000),
        "the bridge ends"
    );
}

/// Refused datagrams and clients are a warning besides the counters.
pub(super) fn tell_strangers(strangers: u64) {
    if strangers > 0 {
        tracing::warn!("{strangers} datagrams or clients that were not the other end's were refused");
    }
}
