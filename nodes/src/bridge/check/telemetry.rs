//! Receives an autopilot's telemetry from a link.

use std::time::Duration;

use whirlstand_bridge::attitude_receiver::AttitudeReceiver;

use super::super::link::Decoder;

/// Decoder of the autopilot's telemetry.
pub(super) struct Telemetry<'a> {
    pub receiver: &'a mut AttitudeReceiver,
    /// Time since the start of the check.
    pub now: Duration,
}

impl Decoder for Telemetry<'_> {
    fn recognises(&mut self, datagram: &[u8]) -> bool {
        self.receiver.recognises(datagram, self.now)
    }

    fn peer_changed(&mut self) {
        self.receiver.forget();
    }

    fn decode(&mut self, bytes: &[u8], _is_datagram: bool) -> bool {
        self.receiver.receive(bytes, self.now)
    }
}
