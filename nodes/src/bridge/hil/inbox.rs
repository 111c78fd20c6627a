//! Collects the plant's messages of each step.

use whirlstand_bridge::sensors::{Errors, Motion, StateMap};
use whirlstand_bus::{Bus, Subscriber};
use whirlstand_msgs::{Imu, Odometry, Truth};
use whirlstand_vehicle::Vehicle;

use super::errors::ErrorMap;
use crate::error::NodeError;
use crate::ports::receive;

/// Queue length of each topic.
const DEPTH: usize = 64;

/// Motion of the vehicle at a step, and errors of its sensors.
#[derive(Debug, Clone, Copy)]
pub(super) struct VehicleSample {
    pub step: u64,
    pub motion: Motion,
    pub errors: Errors,
}

/// Subscriptions to the three topics of a step. `Imu` is published last, but not every transport keeps the
/// order of two topics.
pub(super) struct Inbox {
    imu: Subscriber<Imu>,
    odometry: Subscriber<Odometry>,
    truth: Subscriber<Truth>,
    errors: ErrorMap,
    /// The oldest measurement whose truth has not arrived yet, and the newest of the others.
    waiting: Option<Imu>,
    newest_truth: Option<Truth>,
    newest_odometry: Option<Odometry>,
    last: Option<u64>,
    refused: u64,
}

impl Inbox {
    pub(super) fn open(bus: &Bus, vehicle: &Vehicle) -> Result<Self, NodeError> {
        Ok(Self {
            imu: bus.subscriber(DEPTH)?,
            odometry: bus.subscriber(DEPTH)?,
            truth: bus.subscriber(DEPTH)?,
            errors: ErrorMap::new(vehicle),
            waiting: None,
            newest_truth: None,
            newest_odometry: None,
            last: None,
            refused: 0,
        })
    }

    /// Receives all steps of which both measurement and truth have arrived; returns the newest.
    ///
    /// # Errors
    /// The transport fails.
    pub(super) fn drain(&mut self, states: &StateMap) -> Result<Option<VehicleSample>, NodeError> {
        let mut newest = None;
        loop {
            if self.waiting.is_none() {
                self.waiting = receive(&mut self.imu, &mut self.refused)?;
            }
            let Some(imu) = self.waiting else { return Ok(newest) };
            let step = imu.head.step;
            // A step number that goes back is that of a restarted plant, whose truths come after the old
            // ones.
            let restarted = self.last.is_some_and(|last| step < last);
            while self.newest_truth.is_none_or(|t| t.head.step < step || restarted && t.head.step != step) {
                match receive(&mut self.truth, &mut self.refused)? {
                    Some(truth) => self.newest_truth = Some(truth),
                    None => return Ok(newest),
                }
            }
            while let Some(odometry) = receive(&mut self.odometry, &mut self.refused)? {
                self.newest_odometry = Some(odometry);
            }
            self.waiting = None;
            self.last = Some(step);
            // A lost truth leaves its measurement without one.
            if let Some(truth) = self.newest_truth.filter(|t| t.head.step == step) {
                newest = self.see(&imu, &truth, states).or(newest);
            }
        }
    }

    fn see(&mut self, imu: &Imu, truth: &Truth, states: &StateMap) -> Option<VehicleSample> {
        let x = truth.x.get(..truth.states as usize).unwrap_or_default();
        if x.iter().any(|x| !x.is_finite()) {
            self.refused += 1;
            return None;
        }
        let step = imu.head.step;
        let odometry = self.newest_odometry.filter(|o| o.head.step == step);
        let motion = states.motion(x);
        let errors = self.errors.of(imu, odometry.as_ref(), &motion);
        Some(VehicleSample { step, motion, errors })
    }

    /// Number of messages lost on the way to this node.
    pub(super) fn lost(&self) -> u64 {
        self.imu.lost().saturating_add(self.truth.lost()).saturating_add(self.odometry.lost())
    }

    /// Number of unusable messages.
    pub(super) fn refused(&self) -> u64 {
        self.refused
    }
}
