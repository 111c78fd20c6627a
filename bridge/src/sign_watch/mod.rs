//! Notices a vehicle that turns the other way than it is commanded, before it has gone far.
//!
//! The vehicle file says which angular acceleration the inputs that act make, and which the vehicle makes by itself. What is
//! not known is the gain of each axis, that is how much of its commands the vehicle obeys: 1 by the file, and less than 0 with
//! a sign turned somewhere between the controller and the motors. Kalman filters that differ in what else is not known, how
//! late commands act, how far the air pushes and how exact the attitude is, estimate it from the attitude alone, or from attitude and rates; what they
//! found is weighed by how likely each makes what was seen. The test is sequential (Wald, Sequential Analysis, 1947): an axis is
//! right or turned as soon as the odds are great enough, and until then it is neither.

mod filter;

use std::time::Duration;

use nalgebra::SMatrix;

use crate::channels::Input;
use crate::turning::OwnMotion;
use filter::{Belief, Filter, Transition};

/// Step of the filters.
const TICK: Duration = Duration::from_millis(10);

/// How late a command may act and be seen at most, in ticks, and in which steps: up to 200 ms of actuators, telemetry and radio.
const LATEST: usize = 20;
const DELAY_STEP: usize = 5;

/// How far the air may push at first, and change that in a second, in shares of what the inputs can do.
const DISTURBANCES: [f64; 3] = [0.03, 0.3, 3.0];

/// Noise of angles that come without rates, in shares of what the file says: a vehicle that estimates them tells them far more
/// smoothly than a sensor does. How late a command acts then shows to so many ticks.
const SMOOTH: f64 = 0.1;
const SMOOTH_DELAY_STEP: usize = 2;

/// Gains of a turned vehicle: twice as much or half as much as the file says, and a margin. What is beyond is something else.
const TURNED: std::ops::Range<f64> = -3.0..-0.33;

/// A gain of less is neither right nor turned.
const RIGHT: f64 = 0.33;

/// Odds at which it is decided that an axis is right, or turned.
const SURE: f64 = 1e6;

/// Odds at which it is turned where rates are told: they show the very beginning of a gust, which is not quite the jump that the
/// filters take it for, and are soon enough for greater odds.
const SURE_WITH_RATES: f64 = 1e8;

/// What inputs without limits are taken to be able to do, and the least that any can, rad/s^2.
const AUTHORITY: std::ops::RangeInclusive<f64> = 0.1..=10.0;

/// Standard deviations that no telemetry is better than, rad and rad/s: 0.1 deg, 0.7 deg/s.
const LEAST_NOISE: [f64; 2] = [0.00175, 0.0122];

/// A pause after which what was seen does not belong together.
const PAUSE: Duration = Duration::from_millis(300);

/// What the inputs accelerate: axes by the axes that the inputs steer, rad/s^2.
type Commanded = SMatrix<f64, 3, 3>;

/// An attitude as the vehicle told it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Attitude {
    /// Roll, pitch and yaw, rad.
    pub angles: [f64; 3],
    /// Their rates, rad/s, where they are told.
    pub rates: Option<[f64; 3]>,
    /// When it was measured; one that was seen already is not taken in again.
    pub at: Duration,
}

/// What was seen since somebody took charge.
#[derive(Debug, Clone)]
struct Flight {
    /// What the filters have reached.
    time: Duration,
    attitude_at: Duration,
    acts: Commanded,
    /// What acted in the last ticks, the newest at `newest`.
    acted: [Commanded; LATEST + 1],
    newest: usize,
    /// One for each noise, delay in ticks and size of disturbance, in this order.
    filters: Vec<(usize, Filter)>,
}

/// Watches the sign of each axis while the controller is in charge.
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

    /// Begins anew, because somebody took charge or gave it up.
    pub fn reset(&mut self) {
        (self.flight, self.right, self.wrong) = (None, [false; 3], None);
    }

    /// The axis, 0 to 2, that answers with the wrong sign.
    pub fn wrong(&self) -> Option<usize> {
        self.wrong
    }

    /// Takes in the inputs that act from now on, and the newest attitude.
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

    /// Decides about each axis for which the odds are great enough: it takes `sure` to call one turned.
    fn judge(&mut self, filters: &[(usize, Filter)], sure: f64) {
        let most = filters.iter().fold(f64::NEG_INFINITY, |most, (_, f)| most.max(f.log_likelihood()));
        for axis in (0..3).filter(|axis| self.steered[*axis]) {
            // Of the gain: turned, not turned, right, and less than that of a right vehicle turned.
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
    /// Lets the filters follow until now.
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

/// What a gain of 1 of each steered axis, by columns, accelerates.
fn commanded(inputs: &[Input], acting: &[f64]) -> Commanded {
    let mut commanded = Commanded::zeros();
    for (input, u) in inputs.iter().zip(acting) {
        if let Some(steers) = input.axis() {
            (0..3).for_each(|axis| commanded[(axis, steers)] += input.turns[axis] * u);
        }
    }
    commanded
}

/// The probability that a normal variable of deviation 1 is below.
fn normal_below(z: f64) -> f64 {
    0.5 * libm::erfc(-z * std::f64::consts::FRAC_1_SQRT_2)
}

#[cfg(test)]
mod tests;
