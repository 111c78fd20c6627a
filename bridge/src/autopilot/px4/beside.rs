//! What passes beside the loop: the ground station's messages to PX4, PX4's messages to others, and counts.

use std::time::Duration;

use super::super::{Counts, Send};
use super::station::Station;
use super::{Px4, TELEMETRY};
use crate::forward::Forward;

impl Px4 {
    /// A conversation in which the sensors are sent once in `period`.
    #[must_use]
    pub(in crate::autopilot) fn with_period(mut self, period: Duration) -> Self {
        self.station = Station::new(Forward::new(&self.options.link, period));
        self
    }

    /// Sends the station's messages for which the line has room.
    pub(super) fn forward(&mut self, now: Duration, send: &mut Send<'_>) {
        while let Some(frame) = self.station.waiting.next(now) {
            send(0, &frame);
        }
    }

    /// Processes PX4's messages to others; outputs among them do not count.
    pub(super) fn listen(&mut self, bytes: &[u8], now: Duration) -> bool {
        self.telemetry.push(bytes);
        let mut valid = false;
        while let Some(event) = self.telemetry.next(now) {
            if let crate::mavlink::Event::Message(header, message) = event {
                valid = true;
                self.heard.hear(TELEMETRY, header, &message, &mut self.notes);
            }
        }
        valid
    }

    /// Counts of this connection with PX4 and earlier ones.
    pub(super) fn past_counts(&self) -> Counts {
        let wire = self.deframer.counts();
        // A complete frame of another dialect is no damage.
        let damaged = wire.dropped() - wire.unknown + wire.noise_bytes;
        Counts {
            sent: self.past.sent + self.counts.sent,
            outputs: self.past.outputs + self.counts.outputs,
            malformed: self.past.malformed + self.counts.malformed + damaged,
            stale: self.past.stale + self.counts.stale,
            lost: self.past.lost + wire.lost,
            ..Counts::default()
        }
    }
}
