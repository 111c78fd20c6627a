//! The control law of a closed-loop trial: a linear-quadratic regulator with a Kalman filter, designed on the
//! nominal vehicle by value iteration.

use nalgebra::{DMatrix, DVector};
use whirlstand_vehicle::Vehicle;

use super::linear::Recursion;

/// Largest number of steps of the value iteration.
const MOST_STEPS: usize = 4000;
/// Relative change of the gain from step to step below which the iteration ends.
const SETTLED: f64 = 1e-9;

/// Scales of the outputs, inputs and noise in the design of a control law.
pub(crate) struct Weights<'a> {
    /// Root mean square of each output and, in `inputs`, of each input, SI; each has weight 1 at this size.
    pub outputs: &'a [f64],
    pub inputs: &'a [f64],
    /// Standard deviation of each output's noise, SI.
    pub noise: &'a [f64],
}

/// A control law with its state estimate.
#[derive(Debug, Clone)]
pub(crate) struct Law {
    f: DMatrix<f64>,
    g: DMatrix<f64>,
    c: DMatrix<f64>,
    d: DMatrix<f64>,
    /// State feedback gain, inputs x states.
    feedback: DMatrix<f64>,
    /// Predictor gain, states x outputs.
    observer: DMatrix<f64>,
    estimate: DVector<f64>,
    limits: Vec<(f64, f64)>,
}

impl Law {
    /// Designs the law of a vehicle at this period, before its first sample; `None` without a gain.
    pub fn new(vehicle: &Vehicle, period_s: f64, weights: &Weights<'_>) -> Option<Self> {
        let Recursion { f, g } = Recursion::new(&vehicle.a, &vehicle.b, period_s);
        let (c, d) = (vehicle.c.clone(), vehicle.d.clone());
        let inverse = |sizes: &[f64]| diagonal(sizes, |size| size.max(1e-12).powi(-2));
        let square = |sizes: &[f64]| diagonal(sizes, |size| size * size);
        let cost = c.transpose() * inverse(weights.outputs) * &c;
        let feedback = gain(&f, &g, &cost, &inverse(weights.inputs))?;
        // The process noise enters only through the inputs, with the commands' root mean square as its
        // standard deviation.
        let unrest = &g * square(weights.inputs) * g.transpose();
        let observer = gain(&f.transpose(), &c.transpose(), &unrest, &square(weights.noise))?.transpose();
        let estimate = DVector::zeros(f.nrows());
        let limits = vehicle.inputs.iter().map(|u| (u.lower, u.upper)).collect();
        Some(Self { f, g, c, d, feedback, observer, estimate, limits })
    }

    /// The command of this sample: `reference` plus feedback of the state that the last measurements predict,
    /// limited.
    pub fn command(&self, reference: &[f64]) -> Vec<f64> {
        let back = &self.feedback * &self.estimate;
        let limited =
            |(i, (lower, upper)): (usize, &(f64, f64))| (reference[i] - back[i]).clamp(*lower, *upper);
        self.limits.iter().enumerate().map(limited).collect()
    }

    /// Updates the state estimate with this sample's command and measurement.
    pub fn measure(&mut self, command: &[f64], measured: &[f64]) {
        let u = DVector::from_column_slice(command);
        let new = DVector::from_column_slice(measured) - &self.c * &self.estimate - &self.d * &u;
        self.estimate = &self.f * &self.estimate + &self.g * u + &self.observer * new;
    }
}

fn diagonal(sizes: &[f64], of: impl Fn(f64) -> f64) -> DMatrix<f64> {
    DMatrix::from_diagonal(&DVector::from_iterator(sizes.len(), sizes.iter().map(|s| of(*s))))
}

/// Stationary gain K = (R + G' P G)^-1 G' P F by iteration of P = Q + F' P (F - G K); `None` where it does
/// not exist.
///
/// Sampled regulators: Astrom and Wittenmark, Computer-Controlled Systems, chapter 11.
fn gain(
    f: &DMatrix<f64>,
    g: &DMatrix<f64>,
    cost: &DMatrix<f64>,
    effort: &DMatrix<f64>,
) -> Option<DMatrix<f64>> {
    let mut p = cost.clone();
    let mut gain = DMatrix::zeros(g.ncols(), f.nrows());
    for _ in 0..MOST_STEPS {
        let pg = &p * g;
        let next = (effort + g.transpose() * &pg).cholesky()?.solve(&(pg.transpose() * f));
        p = cost + f.transpose() * &p * (f - g * &next);
        p = 0.5 * (&p + p.transpose());
        let settled = (&next - &gain).norm() <= SETTLED * next.norm();
        gain = next;
        if settled {
            break;
        }
    }
    gain.iter().all(|k| k.is_finite()).then_some(gain)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::poles::fastest;

    #[test]
    fn the_gain_of_one_state_solves_its_equation() {
        // The scalar Riccati equation P = q + f^2 P r / (r + g^2 P) gives P^2 g^2 + P (r (1 - f^2) - q g^2) -
        // q r = 0.
        let (f, g, q, r) = (1.1f64, 0.5f64, 2.0f64, 3.0f64);
        let b = r * (1.0 - f * f) - q * g * g;
        let p = (-b + (b * b + 4.0 * g * g * q * r).sqrt()) / (2.0 * g * g);
        let one = |v: f64| DMatrix::from_element(1, 1, v);
        let found = gain(&one(f), &one(g), &one(q), &one(r)).unwrap()[(0, 0)];
        assert!((found - g * p * f / (r + g * g * p)).abs() < 1e-9, "{found}");
    }

    #[test]
    fn the_law_damps_what_it_flies() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let (p, m) = (vehicle.outputs.len(), vehicle.inputs.len());
        let noise: Vec<f64> = vehicle.outputs.iter().map(|y| y.noise).collect();
        let weights = Weights { outputs: &vec![0.05; p], inputs: &vec![1.0; m], noise: &noise };
        let law = Law::new(&vehicle, 0.01, &weights).unwrap();
        let closed = fastest(&(&law.f - &law.g * &law.feedback));
        assert!(closed < fastest(&law.f), "{closed}");
        assert!(fastest(&(&law.f - &law.observer * &law.c)) < 1.0);
    }
}
