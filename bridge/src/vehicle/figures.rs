//! Counts and figures of a bridge.

use super::{Source, Vehicle};

/// Figures of a bridge.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Figures {
    /// Bytes that came from the vehicle.
    pub bytes: u64,
    /// Messages from the vehicle.
    pub messages: u64,
    /// Messages given up, of the vehicle, the pilot's receiver or a ground station: damaged, unknown, unsigned.
    pub dropped: u64,
    /// Bytes outside of messages, of the vehicle or the pilot's receiver.
    pub noise_bytes: u64,
    /// Messages from the vehicle's link that were refused for their signature.
    pub signature: u64,
    /// Messages that never came, from gaps in their numbers.
    pub lost: u64,
    /// Measurements refused: repeated, overtaken, or not finite.
    pub refused: u64,
    /// Outputs sent.
    pub outputs: u64,
    /// Channel values that a limit or rate held back.
    pub clamped: u64,
    /// Offset of the vehicle's clock to ours, ns.
    pub clock_offset_ns: Option<i64>,
    /// Round trip of the exchange that the offset comes from, ns.
    pub round_trip_ns: Option<i64>,
}

impl Vehicle {
    /// Figures since the start.
    pub fn figures(&mut self) -> Figures {
        let refusals = self.telemetry.refusals();
        let mut figures = Figures {
            refused: refusals.not_finite + refusals.old + self.refused_controls,
            outputs: self.outputs,
            clamped: self.mapping.clamped(),
            ..Figures::default()
        };
        match &self.source {
            Source::Mavlink(autopilot) => {
                // What strangers said is a refused datagram of its own, and here only what it was.
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
        let (pilot, ground) = (self.pilot_crsf.counts(), self.ground.counts());
        figures.dropped += pilot.checksum + pilot.malformed + ground.dropped();
        figures.noise_bytes += pilot.noise_bytes + self.pilot_sbus.counts().noise_bytes;
        if let Some((offset, trip)) = self.telemetry.clock().offset() {
            (figures.clock_offset_ns, figures.round_trip_ns) = (Some(offset), trip);
        }
        figures
    }
}
