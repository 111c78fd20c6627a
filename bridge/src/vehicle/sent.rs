//! Log message of the outputs to the vehicle and their source.

use std::time::Duration;

use whirlstand_msgs::{MAX_INPUTS, Message, Sent, armed, charge};

use super::{Source, Vehicle};
use crate::arming::Mode;

impl Vehicle {
    /// Last output and its source. The caller fills in the head.
    pub fn sent(&self, now: Duration) -> Sent {
        let mut sent = Sent { channels: [f64::NAN; 16], stick: [f64::NAN; 16], ..Sent::zeroed() };
        let in_use = self.mapping.in_use().iter().zip(self.mapping.us());
        for (to, (_, us)) in
            sent.channels.iter_mut().zip(in_use).filter(|(_, (in_use, _))| **in_use && !self.released)
        {
            *to = *us;
        }
        if let Some(pilot) = self.pilot.as_ref().filter(|p| p.is_present(now)) {
            sent.stick = *pilot.all_us();
        }
        let count = self.acting.len().min(MAX_INPUTS);
        if !self.released {
            sent.u[..count].copy_from_slice(&self.acting[..count]);
        }
        (sent.count, sent.messages) = (count as u32, self.outputs);
        (sent.in_charge, sent.reason) = match self.arming.mode() {
            Mode::Disarmed => (charge::NOBODY, self.arming.refused().map_or(0, |r| r as u32 + 1)),
            Mode::Manual => (charge::PILOT, 0),
            Mode::Automatic => (charge::CONTROLLER, 0),
            Mode::Failed(reason) => (charge::FAILSAFE, reason as u32 + 1),
        };
        (sent.armed, sent.link_quality) = match &self.source {
            Source::Mavlink(a) if a.is_known() => {
                (if a.is_armed() { armed::YES } else { armed::NO }, f64::NAN)
            }
            Source::Mavlink(_) => (armed::UNKNOWN, f64::NAN),
            Source::Crsf { quality, .. } => {
                (armed::UNKNOWN, quality.map_or(f64::NAN, |q| f64::from(q) / 100.0))
            }
        };
        sent
    }
}
