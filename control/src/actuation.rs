//! From what a law wants of an input to the command: trim, and the inverse of a dead zone.

use crate::sampled_plant::SampledPlant;

/// Part of a dead zone's half-width over which a command rises to its other side.
const RAMP: f64 = 0.25;

/// Limits of the inputs as a law sees them, counted from the trim, and what is added behind the law.
#[derive(Debug, Clone)]
pub struct Actuation {
    /// Smallest values.
    pub lower: Vec<f64>,
    /// Largest values.
    pub upper: Vec<f64>,
    /// What stands for rest: zero, or the limit nearest to it.
    pub neutral: Vec<f64>,
    /// The command at which an input does nothing; empty where that is zero.
    trim: Vec<f64>,
    /// Half-width of what each input does not answer to, and which is jumped over; empty without.
    dead_zones: Vec<f64>,
}

impl Actuation {
    /// That of a plant, without dead zones.
    pub fn new(plant: &SampledPlant) -> Self {
        let mut lower: Vec<f64> = plant.inputs().iter().map(|i| i.lower).collect();
        let mut upper: Vec<f64> = plant.inputs().iter().map(|i| i.upper).collect();
        let mut neutral: Vec<f64> = lower.iter().zip(&upper).map(|(l, u)| 0f64.clamp(*l, *u)).collect();
        let trim = if plant.trim().iter().all(|t| *t == 0.0) { Vec::new() } else { plant.trim().to_vec() };
        for values in [&mut lower, &mut upper, &mut neutral] {
            values.iter_mut().zip(&trim).for_each(|(v, t)| *v -= t);
        }
        Self { lower, upper, neutral, trim, dead_zones: Vec::new() }
    }

    /// Has commands jump over dead zones of these half-widths. False, and nothing is changed, where one leaves an input no room
    /// within its limits.
    pub fn compensate_dead_zones(&mut self, widths: &[f64]) -> bool {
        let fits = |i: usize| self.lower[i] + widths[i] < 0.0 && self.upper[i] - widths[i] > 0.0;
        let count = self.lower.len();
        if widths.len() != count || !(0..count).all(|i| widths[i] == 0.0 || fits(i)) {
            return false;
        }
        for (i, width) in widths.iter().enumerate() {
            self.lower[i] += width;
            self.upper[i] -= width;
        }
        self.dead_zones = widths.to_vec();
        true
    }

    /// Takes the trim off commands.
    pub fn take_off_trim(&self, u: &mut [f64]) {
        u.iter_mut().zip(&self.trim).for_each(|(u, t)| *u -= t);
    }

    /// From what the law wants to commands.
    pub fn apply(&self, u: &mut [f64]) {
        // The inverse of a dead zone (Tao and Kokotovic 1996), its jump a ramp: a jump would chatter on noise.
        for (u, width) in u.iter_mut().zip(&self.dead_zones).filter(|(_, width)| **width > 0.0) {
            *u = beyond(*u, *width);
        }
        u.iter_mut().zip(&self.trim).for_each(|(u, t)| *u += t);
    }

    /// The same for K flights.
    #[inline(always)]
    pub fn apply_lanes<const K: usize>(&self, u: &mut [[f64; K]]) {
        for (u, width) in u.iter_mut().zip(&self.dead_zones).filter(|(_, width)| **width > 0.0) {
            *u = u.map(|u| beyond(u, *width));
        }
        u.iter_mut().zip(&self.trim).for_each(|(u, t)| *u = u.map(|u| u + t));
    }
}

/// A command on the other side of the dead zone of that half-width.
#[inline(always)]
fn beyond(u: f64, width: f64) -> f64 {
    u + width * (u / (RAMP * width)).clamp(-1.0, 1.0)
}
