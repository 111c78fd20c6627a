//! Log messages of the outputs to the vehicle with their source, and of what it reports.

use std::time::Duration;

use whirlstand_msgs::{MAX_INPUTS, Message, Reported, Sent, armed, charge};

use super::reported::Report;
use super::{Source, Vehicle};
use crate::arming::{Mode, Reason};

impl Vehicle {
    /// Last output and its source. The caller fills in the head.
    pub fn sent(&self, now: Duration) -> Sent {
        let mut sent = Sent { channels: [f64::NAN; 16], stick: [f64::NAN; 16], ..Sent::zeroed() };
        let has_left = !self.delivery.is_lost();
        for ((to, us), carried) in sent.channels.iter_mut().zip(self.mapping.us()).zip(self.carried()) {
            if carried && has_left && !self.released {
                *to = *us;
            }
        }
        if let Some(pilot) = self.pilot.as_ref().filter(|p| p.is_present(now)) {
            sent.stick = *pilot.all_us();
        }
        let count = self.acting.len().min(MAX_INPUTS);
        if !has_left {
            sent.u[..count].fill(f64::NAN);
        } else if !self.released {
            sent.u[..count].copy_from_slice(&self.acting[..count]);
        }
        (sent.count, sent.messages) = (count as u32, self.outputs);
        (sent.in_charge, sent.reason) = match self.arming.mode() {
            Mode::Disarmed => (charge::NOBODY, self.arming.refused().map_or(0, Reason::number)),
            Mode::Manual => (charge::PILOT, 0),
            Mode::Automatic => (charge::CONTROLLER, 0),
            Mode::Failed(reason) => (charge::FAILSAFE, reason.number()),
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

    /// What the vehicle has reported. The caller fills in the head.
    pub fn reported(&self, now: Duration) -> Reported {
        match &self.source {
            Source::Mavlink(autopilot) => autopilot.report.message(now),
            Source::Crsf { .. } => Report::default().message(now),
        }
    }
}
