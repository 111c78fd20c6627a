//! Tells the totals of a run.

use whirlstand_bridge::vehicle::Figures;

/// Counts of the links, and the offset of the vehicle's clock.
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
