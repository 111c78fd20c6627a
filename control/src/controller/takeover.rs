//! One law takes over from another in flight, without a bump in the command.
//!
//! The law that comes flies along first: it hears what the other commands, so that its past commands are the true ones. At every
//! such step its integrals are set to where its command is the other's (conditioning, Hanus, Kinnaert and Henrotte 1987,
//! Automatica 23); what integrals do not reach is an offset of the command, which dies away once the law is in charge (Graebe
//! and Ahlen 1996, IEEE Transactions on Control Systems Technology 4). An offset is a disturbance at the input that vanishes, so
//! that it takes nothing from the stability of a linear loop.

use super::Controller;
use crate::actuation::Actuation;

impl Controller {
    /// Steps until a law that flies along has only true commands in its memory.
    pub fn memory_steps(&self) -> usize {
        self.past.iter().copied().max().unwrap_or(0)
    }

    /// Flies along with `flying`, which has just taken the step with the same estimate and reference, and is in charge: going on
    /// with this law from the next step on leaves the command where it is. False when that is a law of another vehicle.
    pub fn fly_along(&mut self, flying: &Self, estimate: &[f64], reference: &[f64], tracked: u64) -> bool {
        if (self.n, self.m) != (flying.n, flying.m) {
            return false;
        }
        self.at = flying.at.saturating_sub(1);
        self.loop_gain = flying.loop_gain;
        self.added.copy_from_slice(&flying.added);
        self.take_memory_of_sliding(flying);
        self.step_beside(estimate, reference, tracked, |_, command| {
            command.copy_from_slice(&flying.command);
        });
        self.refusals = flying.refusals;
        true
    }

    /// Flies along with a hand that has just given the inputs `u` in the place of this law's: going on with the law from the
    /// next step on leaves the command where it is. False, and nothing is done, when `u` is not finite or not as long as the
    /// plant has inputs.
    pub fn fly_along_by_hand(
        &mut self,
        u: &[f64],
        estimate: &[f64],
        reference: &[f64],
        tracked: u64,
    ) -> bool {
        if u.len() != self.m || u.iter().any(|v| !v.is_finite()) {
            return false;
        }
        self.step_beside(estimate, reference, tracked, |actuation, command| {
            command.copy_from_slice(u);
            // What is taken back of effects is no part of what the law commands.
            actuation.take_off(command);
        });
        self.refusals = 0;
        true
    }

    /// Takes a step, and then as true what was commanded in the place of what came out of it.
    fn step_beside(
        &mut self,
        estimate: &[f64],
        reference: &[f64],
        tracked: u64,
        flown: impl FnOnce(&mut Actuation, &mut [f64]),
    ) {
        self.handover.reset();
        let mut missing = std::mem::take(&mut self.handover.command);
        self.step(estimate, reference, tracked, &mut missing);
        flown(&mut self.actuation, &mut self.command);
        self.in_force.copy_from_slice(&self.command);
        for (i, missing) in missing.iter_mut().enumerate() {
            *missing = self.command[i] - self.wanted.as_flattened()[i];
            if !missing.is_finite() {
                *missing = 0.0;
            }
        }
        self.condition(&mut missing);
        self.handover.offset.copy_from_slice(&missing);
        self.handover.command = missing;
    }

    /// The memory of a sliding law is that of the other, where that is one too.
    fn take_memory_of_sliding(&mut self, flying: &Self) {
        let Some(sliding) = &mut self.sliding else { return };
        if self.integral == flying.integral {
            self.integrals.copy_from_slice(&flying.integrals);
        }
        if let Some(other) = &flying.sliding {
            sliding.twist.copy_from_slice(&other.twist);
        }
    }

    /// Sets the integrals to what reaches most of the missing command, which keeps what they do not reach.
    fn condition(&mut self, missing: &mut [f64]) {
        if self.loop_gain == 0.0 || self.handover.tracking.nrows() == 0 {
            return;
        }
        let (q, m) = self.handover.tracking.shape();
        for k in 0..q {
            let change: f64 = (0..m).map(|i| self.handover.tracking[(k, i)] * missing[i]).sum();
            // Wanted is less by the integrals' gain times them, and the feedback is multiplied by the loop gain.
            self.integrals[k] -= change / self.loop_gain;
            self.reached(k, change);
        }
        for (missing, reached) in missing.iter_mut().zip(&mut self.handover.offset) {
            *missing -= std::mem::take(reached);
        }
    }

    /// Adds up what a change of an integral does to the command.
    fn reached(&mut self, k: usize, change: f64) {
        for (i, reached) in self.handover.offset.iter_mut().enumerate() {
            *reached += self.integral_matrix[(i, k)] * change;
        }
    }
}
