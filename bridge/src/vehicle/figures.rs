//! Counts and figures of a bridge.

use super::{Source, Vehicle};

/// Figures of a bridge.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Figures {
    /// Number of bytes from the vehicle.
    pub bytes: u64,
    /// Number of messages from the vehicle.
    pub messages: u64,
    /// Number of messages discarded, from the vehicle, the pilot's receiver or a ground station: damaged,
    /// unknown, unsigned.
    pub dropped: u64,
    /// Number of bytes outside of messages, from the vehicle or the pilot's receiver.
    pub noise_bytes: u64,
    /// Number of messages from the vehicle's link refused for their signature.
    pub signature: u64,
    /// Number of messages that never arrived, from gaps in their sequence numbers.
    pub lost: u64,
    /// Number of refusals: of measurements that are repeated, overtaken or not finite, of messages with which
    /// a ground station steers, and those of `unforwarded`.
    pub refused: u64,
    /// Number of messages of a ground station for which the vehicle's link had no room.
    pub unforwarded: u64,
    /// Number of outputs sent.
    pub outputs: u64,
    /// Number of channel values held by a limit or a rate.
    pub clamped: u64,
    /// Offset of the vehicle's clock, vehicle minus ours, ns.
    pub clock_offset_ns: Option<i64>,
    /// Round trip of the exchange that gave the offset, ns.
    pub round_trip_ns: Option<i64>,
}

impl Vehicle {
    /// Figures since the start.
    pub fn figures(&mut self) -> Figures {
        let refusals = self.telemetry.refusals();
        let mut figures = Figures {
            refused: refusals.not_finite
                + refusals.old
                + self.ground.refused_controls
                + self.ground.waiting.dropped(),
            unforwarded: self.ground.waiting.dropped(),
            outputs: self.outputs,
            clamped: self.mapping.clamped(),
            ..Figures::default()
        };
        match &self.source {
            Source::Mavlink(autopilot) => {
                // Datagrams of unknown senders are counted as refused elsewhere, and here only by the kind of
                // their content.
                let (c, all) = (autopilot.counts(), autopilot.counts_with_strangers());
                (figures.bytes, figures.messages, figures.signature) =
                    (all.bytes, all.messages, all.signature());
                figures.lost = c.lost;
                (figures.dropped, figures.noise_bytes) = (c.dropped(), c.noise_bytes);
            }
            Source::Crsf { parser, .. } => {
                let c = parser.counts();
                (figures.bytes, figures.messages) = (c.bytes, c.frames);
                (figures.dropped, figures.noise_bytes) = (c.checksum + c.malformed, c.noise_bytes);
            }
        }
        let (pilot, ground) = (self.pilot_crsf.counts(), self.ground.deframer.counts());
        figures.dropped += pilot.checksum + pilot.malformed + ground.dropped();
        figures.noise_bytes += pilot.noise_bytes + self.pilot_sbus.counts().noise_bytes;
        if let Some((offset, trip)) = self.telemetry.clock().offset() {
            (figures.clock_offset_ns, figures.round_trip_ns) = (Some(offset), trip);
        }
        figures
    }
}
