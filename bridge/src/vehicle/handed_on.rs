//! What happens to bytes after the bridge has written them: taken by their port, dropped, or the port is closed.

use std::time::Duration;

use super::{Port, Source, Vehicle};
use crate::arming::Mode;
use crate::config::Output;

impl Vehicle {
    /// The port through which outputs leave.
    fn output_port(&self) -> Port {
        match self.output {
            Output::Crsf | Output::Sbus if matches!(self.source, Source::Mavlink(_)) => Port::Output,
            _ => Port::Link,
        }
    }

    /// Reports how many bytes of a port were taken, and whether they left it.
    pub fn handed_on(&mut self, port: Port, bytes: usize, has_left: bool, now: Duration) {
        let is_output = port == self.output_port() && self.delivery.takes();
        if port == Port::Link && has_left {
            self.ground.waiting.sent(bytes, is_output, now);
        }
        if is_output {
            self.delivery.handed_on(&self.acting, has_left, now);
            self.outputs = self.outputs.saturating_sub(u64::from(!has_left));
            self.watch_signs(now);
        }
    }

    /// Compares the inputs that act with the vehicle's rotation.
    fn watch_signs(&mut self, now: Duration) {
        if let (Mode::Automatic, Some(attitude)) = (self.arming.mode(), self.telemetry.attitude()) {
            self.signs.observe(self.delivery.acted(), attitude, now);
        }
    }

    /// Reports that a port was closed; [`Vehicle::connected`] that it is open again.
    pub fn closed(&mut self, port: Port) {
        self.set_closed(port, true);
    }

    /// A closed link to the vehicle shows by its silence.
    pub(super) fn set_closed(&mut self, port: Port, is_closed: bool) {
        if port == Port::Output {
            self.delivery.set_closed(is_closed);
        }
    }
}
