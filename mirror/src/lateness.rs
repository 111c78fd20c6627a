//! How late the measurements of a real vehicle are, and what was expected when they were taken.
//!
//! A command takes time to the vehicle, a measurement back, and neither clock waits for the other: what arrives at a
//! step belongs to an earlier moment. All of it shows as one age of the measurements, which [`MeasurementAge`]
//! estimates from the innovations. A vehicle that stands still does not show it, and then it does not matter. Whole
//! periods of it are taken off by [holding the inputs back](HeldInputs), so that what is simulated is what is measured;
//! the rest is a time between two steps of the simulation.

use std::ops::Range;

use nalgebra::DMatrix;
use whirlstand_control::kalman::{AgeSpread, KalmanFilter, MeasurementAge};

/// Age at the beginning, in periods: half of one until the measurement is read, half of one until the command is.
const FIRST_AGE: f64 = 1.0;

/// Standard deviation of the age at the beginning, in periods.
const UNCERTAIN: f64 = 2.0;

/// Standard deviation of the change of the age within a second, in periods: where a sample more or less lies between
/// two steps, the age jumps by a period, and clocks that differ by a thousandth let that happen every few seconds.
const JUMPS: f64 = 1.0;

/// Standard deviation of the time of a single message, in periods: it takes a time that differs by up to a period, and
/// then waits for a step for up to a period. The variance of an equal distribution is a twelfth; this is the root of a
/// sixth.
const JITTER: f64 = 0.408_248_290_463_863;

/// Ages between which the inputs are held back for as many periods as they are, in periods, and the standard
/// deviation from which on the age is known.
const HELD_WELL: Range<f64> = -0.25..2.25;
const KNOWN: f64 = 0.75;

/// Longest time for which inputs are held back, s; a link that is later has its delay in the vehicle file.
const LONGEST_HELD_S: f64 = 0.2;

/// Rows of expected outputs that are kept. Where the inputs are held back well, four are enough; until then the age may
/// be larger.
const ROWS: usize = 16;

/// Standard deviation of the time of a single message, s.
pub(crate) fn jitter_s(period_s: f64) -> f64 {
    JITTER * period_s
}

/// The age of the measurements, and the outputs that were expected in the last steps.
#[derive(Debug, Clone)]
pub(crate) struct Lateness {
    estimator: MeasurementAge,
    period_s: f64,
    age_s: f64,
    /// Outputs that were expected after the last steps, the newest first, and how many there are.
    rows: [Vec<f64>; ROWS],
    filled: usize,
    /// Inputs that led to them.
    inputs: [Vec<f64>; ROWS],
    expected: Vec<f64>,
    slope: Vec<f64>,
    /// Input and output matrix of the states.
    b: DMatrix<f64>,
    c: DMatrix<f64>,
    /// Variance of the outputs that nobody predicts.
    shaken: Vec<f64>,
    /// What the moments of the inputs' changes add to the uncertainty of states and measurements.
    pushes: Vec<f64>,
    more: Vec<f64>,
}

impl Lateness {
    /// For a filter whose first states are the vehicle's own, with the input matrix `b` and the output matrix `c`;
    /// `shaken` is variance of the outputs that nobody predicts.
    pub fn new(
        filter: &KalmanFilter,
        (b, c): (&DMatrix<f64>, &DMatrix<f64>),
        shaken: Vec<f64>,
        period_s: f64,
    ) -> Self {
        let spread = AgeSpread { initial_s: UNCERTAIN * period_s, per_second_s: JUMPS * period_s };
        let outputs = c.nrows();
        Self {
            estimator: MeasurementAge::new(filter, period_s, spread),
            period_s,
            age_s: FIRST_AGE * period_s,
            rows: std::array::from_fn(|_| vec![0.0; outputs]),
            filled: 0,
            inputs: std::array::from_fn(|_| vec![0.0; b.ncols()]),
            expected: vec![0.0; outputs],
            slope: vec![0.0; outputs],
            b: b.clone(),
            c: c.clone(),
            shaken,
            pushes: vec![0.0; 2 * filter.x().len()],
            more: vec![0.0; outputs],
        }
    }

    /// The age and its standard deviation, s.
    pub fn age(&self) -> [f64; 2] {
        [self.age_s, self.estimator.std()]
    }

    /// Begins anew with an age and its standard deviation, s.
    pub fn begin(&mut self, [age_s, std_s]: [f64; 2]) {
        self.filled = 0;
        self.age_s = age_s;
        self.estimator.begin(std_s);
    }

    /// Begins anew where the inputs are held back for `more` periods more than beside `other`.
    pub fn know(&mut self, other: &Self, more: f64) {
        let [age_s, std_s] = other.age();
        self.begin([age_s - more * self.period_s, std_s]);
    }

    /// Whether the age is known. It is not before the vehicle has moved, and until then nothing can be said of what
    /// its motion is expected to be.
    pub fn is_known(&self) -> bool {
        self.estimator.std() < KNOWN * self.period_s
    }

    /// Periods by which the inputs should be held back more than they are; 0 where they are held back well, or where
    /// the age is not known.
    pub fn amiss(&self) -> f64 {
        let age = self.age_s / self.period_s;
        if self.is_known() && !HELD_WELL.contains(&age) { (age - FIRST_AGE).round() } else { 0.0 }
    }

    /// Takes in the inputs of a step and the outputs that are expected at its end, and returns those that are expected
    /// of the measurements that are known now.
    pub fn expect(&mut self, u: &[f64], end: &[f64]) -> &[f64] {
        self.rows.rotate_right(1);
        self.inputs.rotate_right(1);
        self.rows[0].copy_from_slice(end);
        self.inputs[0].copy_from_slice(u);
        self.filled = (self.filled + 1).min(ROWS);
        let steps = self.age_s / self.period_s;
        // Before enough is known, the outputs go on backwards along the oldest slope.
        let whole = (steps.max(0.0) as usize).min(self.filled.saturating_sub(2));
        let share = steps - whole as f64;
        let before = (whole + 1).min(self.filled - 1);
        let both = self.rows[whole].iter().zip(&self.rows[before]);
        for ((expected, slope), (late, earlier)) in self.expected.iter_mut().zip(&mut self.slope).zip(both) {
            *expected = late + share * (earlier - late);
            *slope = (late - earlier) / self.period_s;
        }
        // The change of the inputs before the measurements were taken, and the next one, which may have come already.
        self.uncertain([[whole, before], [whole.saturating_sub(1), whole]]);
        &self.expected
    }

    /// What is uncertain of the measurements, and of the states when they were taken: the inputs changed somewhat
    /// earlier or later than they were expected to.
    fn uncertain(&mut self, changes: [[usize; 2]; 2]) {
        let jitter_s = jitter_s(self.period_s);
        self.pushes.fill(0.0);
        let count = self.pushes.len() / 2;
        for (push, [now, before]) in self.pushes.chunks_exact_mut(count).zip(changes) {
            for ((now, before), b) in
                self.inputs[now].iter().zip(&self.inputs[before]).zip(self.b.column_iter())
            {
                push.iter_mut().zip(b.iter()).for_each(|(p, b)| *p += b * (now - before) * jitter_s);
            }
        }
        for ((more, slope), shaken) in self.more.iter_mut().zip(&self.slope).zip(&self.shaken) {
            *more = (slope * jitter_s).powi(2) + shaken;
        }
    }

    /// A step of the filter with the residual of what was [expected](Self::expect), whose errors are corrected by what
    /// the age explains as well. Without `gains` of the same step, they are computed.
    pub fn step(
        &mut self,
        filter: &mut KalmanFilter,
        (residual, fresh): (&[f64], u64),
        gains: &[f64],
        errors: &mut [f64],
    ) {
        if gains.is_empty() {
            filter.step_uncertain(residual, fresh, (&self.pushes, &self.more));
        } else {
            filter.step_by(residual, fresh, gains);
        }
        errors.copy_from_slice(filter.x());
        let change = self.estimator.step(filter, &self.slope);
        self.age_s += change;
        errors.iter_mut().zip(self.estimator.change()).for_each(|(e, change)| *e += change);
        // What the states turn out to be wrong by, they were wrong by some periods ago as well.
        for (error, c) in errors.iter().zip(self.c.column_iter()) {
            for row in &mut self.rows {
                row.iter_mut().zip(c.iter()).for_each(|(y, c)| *y += c * error);
            }
        }
    }

    /// Innovations of the last step, whitened.
    pub fn whitened(&self) -> &[f64] {
        self.estimator.whitened()
    }
}

/// Inputs of a real vehicle, held back by whole periods.
#[derive(Debug, Clone)]
pub(crate) struct HeldInputs {
    rows: Vec<f64>,
    count: usize,
    inputs: usize,
    newest: usize,
    held: usize,
    u: Vec<f64>,
}

impl HeldInputs {
    /// Holds back so many inputs, by no period yet.
    pub fn new(inputs: usize, period_s: f64) -> Self {
        let count = (LONGEST_HELD_S / period_s).ceil() as usize + 1;
        Self { rows: vec![0.0; count * inputs], count, inputs, newest: 0, held: 0, u: vec![0.0; inputs] }
    }

    /// Takes in the inputs of a step, and returns those of the step by whose end the present measurements were taken.
    pub fn hold(&mut self, u: &[f64]) -> &[f64] {
        self.newest = (self.newest + 1) % self.count;
        let row = |index: usize| index * self.inputs..(index + 1) * self.inputs;
        self.rows[row(self.newest)].copy_from_slice(u);
        self.u.copy_from_slice(&self.rows[row((self.newest + self.count - self.held) % self.count)]);
        &self.u
    }

    /// Holds them back for `more` periods more, and returns by how many it does.
    pub fn hold_more(&mut self, more: f64) -> f64 {
        let before = self.held as f64;
        self.held = (before + more).clamp(0.0, (self.count - 1) as f64) as usize;
        self.held as f64 - before
    }
}
