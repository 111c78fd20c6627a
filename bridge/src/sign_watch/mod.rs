//! Sign watch: detects a vehicle that turns opposite to its commands, before it has moved far.
//!
//! The vehicle file gives the angular acceleration due to the acting inputs, and that of the vehicle itself.
//! The unknown is the gain of each axis, the ratio of its response to its commands: 1 according to the file,
//! and negative with a reversed sign somewhere between the controller and the motors. Kalman filters with
//! different assumptions about the other unknowns (the delay of commands, the size of disturbances and the
//! accuracy of the attitude) estimate the gain from the attitude alone, or from attitude and rates; their
//! results are weighted by the likelihood of the measurements. The test is sequential (Wald, Sequential
//! Analysis, 1947): an axis is classified as correct or reversed once the odds are high enough, and is
//! undecided until then.

mod filter;

use std::time::Duration;

use nalgebra::SMatrix;

use crate::channels::Input;
use crate::turning::OwnMotion;
use filter::{Belief, Filter, Transition};

/// Time step of the filters.
const TICK: Duration = Duration::from_millis(10);

/// Largest total delay of commands and measurements, in ticks, and the increments tested: up to 200 ms of
/// actuators, telemetry and radio.
const LATEST: usize = 20;
const DELAY_STEP: usize = 5;

/// Initial disturbances, and their change per second, relative to the inputs' authority.
const DISTURBANCES: [f64; 3] = [0.03, 0.3, 3.0];

/// Noise of angles that arrive without rates, relative to the file: a vehicle's own estimates are far
/// smoother than sensor values. The delay of a command can then be resolved to this number of ticks.
const SMOOTH: f64 = 0.1;
const SMOOTH_DELAY_STEP: usize = 2;

/// Gains of a reversed vehicle: from half to twice the magnitude in the file, with a margin. Other gains have
/// another cause.
const TURNED: std::ops::Range<f64> = -3.0..-0.33;

/// Smallest gain of a correct axis; gains between it and those of a reversed one are neither.
const RIGHT: f64 = 0.33;

/// Odds from which an axis is classified as correct, or reversed.
const SURE: f64 = 1e6;

/// Odds from which an axis is classified as reversed where rates are available: these show the very beginning
/// of a gust, which is not exactly the jump assumed by the filters, and reach higher odds soon enough.
const SURE_WITH_RATES: f64 = 1e8;

/// Assumed authority of inputs without limits, and lower bound of any authority, rad/s^2.
const AUTHORITY: std::ops::RangeInclusive<f64> = 0.1..=10.0;

/// Smallest standard deviations of any telemetry, rad and rad/s: 0.1 deg, 0.7 deg/s.
const LEAST_NOISE: [f64; 2] = [0.00175, 0.0122];

/// Pause after which earlier measurements are discarded.
const PAUSE: Duration = Duration::from_millis(300);

/// Accelerations due to the inputs: axes by controlled axes, rad/s^2.
type Commanded = SMatrix<f64, 3, 3>;

/// An attitude reported by the vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Attitude {
    /// Roll, pitch and yaw, rad.
    pub angles: [f64; 3],
    /// Rates of roll, pitch and yaw, rad/s, where reported.
    pub rates: Option<[f64; 3]>,
    /// Time of measurement; a repeated measurement is ignored.
    pub at: Duration,
}

/// Observations since a source took charge.
#[derive(Debug, Clone)]
struct Flight {
    /// Time up to which the filters have advanced.
    time: Duration,
    attitude_at: Duration,
    acts: Commanded,
    /// Accelerations due to the inputs of the last ticks, the newest at `newest`.
    acted: [Commanded; LATEST + 1],
    newest: usize,
    /// One filter for each noise, delay in ticks and size of disturbance, in this order.
    filters: Vec<(usize, Filter)>,
}

/// Monitors the sign of each axis while the controller is in charge.
#[derive(Debug, Clone)]
pub struct SignWatch {
    inputs: Vec<Input>,
    transition: Option<Transition>,
    authority: [f64; 3],
    noise: [f64; 6],
    steered: [bool; 3],
    flight: Option<Flight>,
    right: [bool; 3],
    wrong: Option<usize>,
}

impl SignWatch {
    /// A watch of a vehicle with these inputs.
    pub fn new(inputs: &[Input], own: &OwnMotion) -> Self {
        let mut steered = [false; 3];
        inputs.iter().filter_map(Input::axis).for_each(|axis| steered[axis] = true);
        let authority = std::array::from_fn(|axis| {
            let steers = inputs.iter().filter(|i| i.axis() == Some(axis));
            let most: f64 = steers.map(|i| (i.turns[axis] * i.full).abs()).sum();
            if most.is_finite() { most.max(*AUTHORITY.start()) } else { *AUTHORITY.end() }
        });
        Self {
            inputs: inputs.to_vec(),
            transition: Transition::new(own, TICK.as_secs_f64()),
            authority,
            noise: std::array::from_fn(|i| own.noise[i].max(LEAST_NOISE[i / 3])),
            steered,
            flight: None,
            right: [false; 3],
            wrong: None,
        }
    }

    /// Resets when a source takes charge or gives it up.
    pub fn reset(&mut self) {
        (self.flight, self.right, self.wrong) = (None, [false; 3], None);
    }

    /// The axis, 0 to 2, that responds with the wrong sign.
    pub fn wrong(&self) -> Option<usize> {
        self.wrong
    }

    /// Records the inputs acting from now on, and processes the newest attitude.
    pub fn observe(&mut self, inputs: &[f64], attitude: Attitude, now: Duration) {
        if self.wrong.is_some() || (0..3).all(|axis| self.right[axis] || !self.steered[axis]) {
            return;
        }
        let Some(transition) = self.transition else { return };
        if self.flight.as_ref().is_some_and(|f| now.saturating_sub(f.time) > PAUSE + TICK) {
            self.reset();
        }
        let acts = commanded(&self.inputs, inputs);
        let Some(mut flight) = self.flight.take() else {
            self.flight = Some(self.begin(acts, attitude, now));
            return;
        };
        flight.go_on(&transition, now);
        flight.acts = acts;
        if attitude.at > flight.attitude_at {
            flight.attitude_at = attitude.at;
            flight.filters.iter_mut().for_each(|(_, f)| f.correct(attitude.angles, attitude.rates));
            let sure = if attitude.rates.is_some() { SURE_WITH_RATES } else { SURE };
            self.judge(&flight.filters, sure);
        }
        self.flight = Some(flight);
    }

    fn begin(&self, acts: Commanded, attitude: Attitude, now: Duration) -> Flight {
        let filters = |share: f64, step: usize| {
            let noise = self.noise.map(|noise| share * noise);
            let filter = move |disturbance: f64| {
                Filter::new(Belief { authority: self.authority, disturbance, noise }, attitude.angles)
            };
            (0..=LATEST).step_by(step).flat_map(move |delay| DISTURBANCES.map(|push| (delay, filter(push))))
        };
        let mut all: Vec<_> = filters(1.0, DELAY_STEP).collect();
        if attitude.rates.is_none() {
            all.extend(filters(SMOOTH, SMOOTH_DELAY_STEP));
        }
        Flight {
            time: now,
            attitude_at: attitude.at,
            acts,
            acted: std::array::from_fn(|_| Commanded::zeros()),
            newest: 0,
            filters: all,
        }
    }

    /// Classifies each axis with high enough odds; a reversed one needs odds of `sure`.
    fn judge(&mut self, filters: &[(usize, Filter)], sure: f64) {
        let most = filters.iter().fold(f64::NEG_INFINITY, |most, (_, f)| most.max(f.log_likelihood()));
        for axis in (0..3).filter(|axis| self.steered[*axis]) {
            // Probabilities of the gain: within that of a reversed vehicle, outside of it, above the smallest
            // correct one, and below the negative of that.
            let [mut turned, mut otherwise, mut right, mut against] = [0.0; 4];
            for (_, filter) in filters {
                let weight = (filter.log_likelihood() - most).exp();
                let (mean, deviation) = filter.gain(axis);
                let below = |gain: f64| weight * normal_below((gain - mean) / deviation);
                let above = |gain: f64| weight * normal_below((mean - gain) / deviation);
                let outside = below(TURNED.start) + above(TURNED.end);
                (turned, otherwise) = (turned + weight - outside, otherwise + outside);
                (right, against) = (right + above(RIGHT), against + below(-RIGHT));
            }
            self.right[axis] |= right > SURE * against;
            if !self.right[axis] && turned > sure * otherwise {
                self.wrong = Some(axis);
            }
        }
    }
}

impl Flight {
    /// Advances the filters to the present.
    fn go_on(&mut self, transition: &Transition, now: Duration) {
        let count = self.acted.len();
        while now.saturating_sub(self.time) >= TICK {
            self.time += TICK;
            self.newest = (self.newest + 1) % count;
            self.acted[self.newest] = self.acts;
            for alike in self.filters.chunk_by_mut(|a, b| a.0 == b.0) {
                let motion = transition.motion(&self.acted[(self.newest + count - alike[0].0) % count]);
                alike.iter_mut().for_each(|(_, f)| f.predict(&motion, TICK.as_secs_f64()));
            }
        }
    }
}

/// Acceleration per unit gain of each controlled axis, by columns.
fn commanded(inputs: &[Input], acting: &[f64]) -> Commanded {
    let mut commanded = Commanded::zeros();
    for (input, u) in inputs.iter().zip(acting) {
        if let Some(steers) = input.axis() {
            (0..3).for_each(|axis| commanded[(axis, steers)] += input.turns[axis] * u);
        }
    }
    commanded
}

/// Probability that a standard normal variable is below `z`.
fn normal_below(z: f64) -> f64 {
    0.5 * libm::erfc(-z * std::f64::consts::FRAC_1_SQRT_2)
}

#[cfg(test)]
mod tests;
