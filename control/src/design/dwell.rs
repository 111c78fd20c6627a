//! Memory of a loop, used as the dwell time between switched laws.

use super::Design;

/// Longest memory reported, s.
const LONGEST_S: f64 = 60.0;

impl Design {
    /// Time after which at most half of any initial state of the loop is left, in the scales of its states,
    /// s: the first power of two of periods over which the norm of its transition is below a half, 60 s at
    /// most. Between laws that are each active for at least that time, the loop stays stable however often
    /// they alternate (Morse 1996, IEEE Transactions on Automatic Control 41: dwell time).
    pub fn memory_s(&self) -> f64 {
        let sizes = self.sizes();
        let mut power = self.linear.closed_loop(&self.plant);
        if power.nrows() == sizes.len() {
            for (i, size) in sizes.iter().enumerate() {
                power.column_mut(i).scale_mut(*size);
                power.row_mut(i).scale_mut(1.0 / size);
            }
        }
        let mut time = self.plant.period_s();
        // Frobenius' norm is never below the spectral one.
        while time < LONGEST_S && power.norm() >= 0.5 {
            power = &power * &power;
            time *= 2.0;
            if power.iter().any(|v| !v.is_finite()) {
                return LONGEST_S;
            }
        }
        time.min(LONGEST_S)
    }

    /// Scales of the states of the delayed loop: plant, command in force, integrals over one second, and the
    /// state of super-twisting.
    fn sizes(&self) -> Vec<f64> {
        let scales = self.plant.all_scales();
        let authorities = || self.plant.inputs().iter().map(|i| i.authority());
        let integrals = self.integral.iter().map(|&i| self.plant.scales()[i]);
        let twisting = authorities().take(self.linear.memory.nrows().saturating_sub(self.integral.len()));
        scales.iter().copied().chain(authorities()).chain(integrals).chain(twisting).collect()
    }
}
