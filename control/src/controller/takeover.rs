//! Bumpless transfer: one law takes over from another in flight.
//!
//! The new law first runs in parallel: it receives the commands of the active law, so that its past commands
//! are the true ones. At every such step its integrals are set so that its command equals the active one
//! (conditioning, Hanus, Kinnaert and Henrotte 1987, Automatica 23); a remaining difference becomes an offset
//! of the command, which decays once the law is active (Graebe and Ahlen 1996, IEEE Transactions on Control
//! Systems Technology 4). The offset is a decaying disturbance at the input, which does not affect the
//! stability of a linear loop.

use super::Controller;
use crate::actuation::Actuation;

impl Controller {
    /// Number of steps after which a law that runs in parallel has only true commands in its memory.
    pub fn memory_steps(&self) -> usize {
        self.past.iter().copied().max().unwrap_or(0)
    }

    /// Runs in parallel with the active law `flying`, which has just taken the step with the same estimate
    /// and reference: switching to this law at the next step leaves the command unchanged. False when
    /// `flying` is a law for another vehicle.
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

    /// Runs in parallel with manual control that has just given the inputs `u` in place of this law's:
    /// switching to the law at the next step leaves the command unchanged. False, without effect, when `u` is
    /// not finite or not as long as the plant has inputs.
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
            // The compensation of effects is not part of the law's command.
            actuation.take_off(command);
        });
        self.refusals = 0;
        true
    }

    /// Takes a step, and replaces its command by the one actually given.
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

    /// Copies the state of the active sliding law, where that is one too.
    fn take_memory_of_sliding(&mut self, flying: &Self) {
        let Some(sliding) = &mut self.sliding else { return };
        if self.integral == flying.integral {
            self.integrals.copy_from_slice(&flying.integrals);
        }
        if let Some(other) = &flying.sliding {
            sliding.twist.copy_from_slice(&other.twist);
        }
    }

    /// Sets the integrals to provide most of the missing command; the remainder stays in `missing`.
    fn condition(&mut self, missing: &mut [f64]) {
        if self.loop_gain == 0.0 || self.handover.tracking.nrows() == 0 {
            return;
        }
        let (q, m) = self.handover.tracking.shape();
        for k in 0..q {
            let change: f64 = (0..m).map(|i| self.handover.tracking[(k, i)] * missing[i]).sum();
            // The demand decreases by the integrals' gain times the integrals, and the feedback is multiplied
            // by the loop gain.
            self.integrals[k] -= change / self.loop_gain;
            self.reached(k, change);
        }
        for (missing, reached) in missing.iter_mut().zip(&mut self.handover.offset) {
            *missing -= std::mem::take(reached);
        }
    }

    /// Accumulates the effect of a change of an integral on the command.
    fn reached(&mut self, k: usize, change: f64) {
        for (i, reached) in self.handover.offset.iter_mut().enumerate() {
            *reached += self.integral_matrix[(i, k)] * change;
        }
    }
}
