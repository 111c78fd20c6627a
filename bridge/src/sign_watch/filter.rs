//! Kalman filter for a vehicle's rotation, and for the gain of its response to commands.

use nalgebra::{DMatrix, SMatrix, SVector};
use whirlstand_vehicle::matrix_exponential;

use crate::sensors::wrapped;
use crate::turning::OwnMotion;

/// Indices of the states: angles and rates, disturbances, and gains, three of each.
const ANGLE: usize = 0;
const RATE: usize = 3;
const DISTURBANCE: usize = 6;
const GAIN: usize = 9;
const STATES: usize = 12;

/// Prior standard deviation of a gain: that of a correct vehicle is between 0.5 and 2, that of a reversed one
/// between -2 and -0.5.
const GAIN_PRIOR: f64 = 2.0;

/// Prior standard deviation of a rate that is not measured, rad/s.
const RATE_PRIOR: f64 = 0.35;

/// Probability of a jump of a disturbance at an attitude, as by a gust, and its size relative to the inputs'
/// authority.
const JUMP_PROBABILITY: f64 = 1e-3;
const JUMP: f64 = 10.0;

/// Largest time by which a jump may precede its detection, s.
const JUMP_AGE: f64 = 0.1;

type State = SVector<f64, STATES>;
type Covariance = SMatrix<f64, STATES, STATES>;
/// Rows of the transition matrix that differ from an identity.
type Motion = SMatrix<f64, DISTURBANCE, STATES>;

/// Motion of a vehicle over one tick, as a function of angles and rates, and of accelerations that are
/// constant meanwhile.
#[derive(Debug, Clone, Copy)]
pub(super) struct Transition {
    own: SMatrix<f64, 6, 6>,
    accelerated: SMatrix<f64, 6, 3>,
}

impl Transition {
    /// Exact transition over `tick` seconds; `None` for a vehicle that overflows in that time.
    pub(super) fn new(own: &OwnMotion, tick: f64) -> Option<Self> {
        let mut rates = DMatrix::zeros(9, 9);
        for axis in 0..3 {
            rates[(ANGLE + axis, RATE + axis)] = 1.0;
            rates[(RATE + axis, DISTURBANCE + axis)] = 1.0;
            for (state, adds) in own.adds[axis].iter().enumerate() {
                rates[(RATE + axis, state)] = *adds;
            }
        }
        let over = matrix_exponential(&(rates * tick)).ok()?;
        Some(Self {
            own: over.fixed_view::<6, 6>(0, 0).into_owned(),
            accelerated: over.fixed_view::<6, 3>(0, 6).into_owned(),
        })
    }

    /// Transition with the acceleration per unit gain about each axis, by columns, 1/s^2.
    pub(super) fn motion(&self, commanded: &SMatrix<f64, 3, 3>) -> Motion {
        let mut motion = Motion::zeros();
        motion.fixed_view_mut::<6, 6>(0, 0).copy_from(&self.own);
        motion.fixed_view_mut::<6, 3>(0, DISTURBANCE).copy_from(&self.accelerated);
        motion.fixed_view_mut::<6, 3>(0, GAIN).copy_from(&(self.accelerated * commanded));
        motion
    }
}

/// Assumptions of a filter about the vehicle besides its file.
#[derive(Debug, Clone, Copy)]
pub(super) struct Belief {
    /// Authority of the inputs about each axis, rad/s^2.
    pub authority: [f64; 3],
    /// Initial standard deviation of the disturbances, and their change per second, in authorities.
    pub disturbance: f64,
    /// Standard deviations of angles and rates, rad and rad/s.
    pub noise: [f64; 6],
}

/// A Kalman filter whose states are angles, rates, disturbances as random walks with jumps, and the gains:
/// the ratio of response to command, 1 for a vehicle according to its file, and -1 for a reversed one.
#[derive(Debug, Clone)]
pub(super) struct Filter {
    belief: Belief,
    state: State,
    covariance: Covariance,
    log_likelihood: f64,
}

impl Filter {
    /// A filter at its first measurement, these angles.
    pub(super) fn new(belief: Belief, angles: [f64; 3]) -> Self {
        let (mut state, mut variances) = (State::zeros(), State::zeros());
        for axis in 0..3 {
            state[ANGLE + axis] = angles[axis];
            variances[ANGLE + axis] = belief.noise[axis].powi(2);
            variances[RATE + axis] = RATE_PRIOR.powi(2);
            variances[DISTURBANCE + axis] = (belief.disturbance * belief.authority[axis]).powi(2);
            variances[GAIN + axis] = GAIN_PRIOR.powi(2);
        }
        Self { belief, state, covariance: Covariance::from_diagonal(&variances), log_likelihood: 0.0 }
    }

    /// Predicts over a tick of `tick` seconds.
    pub(super) fn predict(&mut self, motion: &Motion, tick: f64) {
        let moved = motion * self.state;
        self.state.fixed_rows_mut::<DISTURBANCE>(0).copy_from(&moved);
        // Rows after those of the motion are unchanged, so that only a quarter of the product is computed.
        let rows: Motion = motion * self.covariance;
        let corner: SMatrix<f64, DISTURBANCE, DISTURBANCE> = rows * motion.transpose();
        let beside = rows.fixed_columns::<DISTURBANCE>(DISTURBANCE);
        self.covariance.fixed_view_mut::<6, 6>(0, 0).copy_from(&corner);
        self.covariance.fixed_view_mut::<6, 6>(0, 6).copy_from(&beside);
        self.covariance.fixed_view_mut::<6, 6>(6, 0).copy_from(&beside.transpose());
        for axis in 0..3 {
            let change = self.belief.disturbance * self.belief.authority[axis];
            self.covariance[(DISTURBANCE + axis, DISTURBANCE + axis)] += change * change * tick;
        }
    }

    /// Updates by an attitude, rad and rad/s. Whether the disturbance of an axis jumped just before is
    /// decided by likelihood.
    pub(super) fn correct(&mut self, angles: [f64; 3], rates: Option<[f64; 3]>) {
        for axis in 0..3 {
            let mut jumped = self.clone();
            self.correct_axis(axis, angles[axis], rates.map(|r| r[axis]));
            let size = JUMP * self.belief.authority[axis];
            let ages = [(ANGLE, 0.5 * JUMP_AGE * JUMP_AGE), (RATE, JUMP_AGE), (DISTURBANCE, 1.0)];
            for (state, age) in ages.map(|(of, age)| (of + axis, age)) {
                jumped.covariance[(state, state)] += (size * age).powi(2);
            }
            jumped.log_likelihood += JUMP_PROBABILITY.ln();
            jumped.correct_axis(axis, angles[axis], rates.map(|r| r[axis]));
            if jumped.log_likelihood > self.log_likelihood {
                *self = jumped;
            }
        }
    }

    fn correct_axis(&mut self, axis: usize, angle: f64, rate: Option<f64>) {
        let expected = self.state[ANGLE + axis];
        self.correct_state(ANGLE + axis, expected + wrapped(angle - expected));
        if let Some(rate) = rate {
            self.correct_state(RATE + axis, rate);
        }
    }

    fn correct_state(&mut self, state: usize, measured: f64) {
        let innovation = measured - self.state[state];
        let variance = self.covariance[(state, state)] + self.belief.noise[state].powi(2);
        let column: State = self.covariance.column(state).into();
        self.state += column * (innovation / variance);
        self.covariance -= column * column.transpose() / variance;
        self.log_likelihood -= 0.5 * (innovation * innovation / variance + variance.ln());
    }

    /// Log-likelihood of the measurements, up to a constant common to all filters.
    pub(super) fn log_likelihood(&self) -> f64 {
        self.log_likelihood
    }

    /// Mean and standard deviation of the gain about an axis.
    pub(super) fn gain(&self, axis: usize) -> (f64, f64) {
        let variance = self.covariance[(GAIN + axis, GAIN + axis)];
        (self.state[GAIN + axis], variance.max(f64::MIN_POSITIVE).sqrt())
    }
}
