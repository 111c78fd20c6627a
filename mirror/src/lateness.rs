//! The age of a real vehicle's measurements, and the outputs expected at the time when they were taken.
//!
//! Commands and measurements take time, and the clocks are not synchronized: a measurement that arrives at a
//! step belongs to an earlier time. All these delays together act as one age of the measurements, which
//! [`MeasurementAge`] estimates from the innovations. A vehicle at rest does not show the age, but then it
//! does not matter. Whole periods of the age are compensated by [holding the inputs back](HeldInputs), so
//! that simulation and measurement agree; the remainder is a time between two steps of the simulation.

use std::ops::Range;

use nalgebra::DMatrix;
use whirlstand_control::kalman::{AgeSpread, KalmanFilter, MeasurementAge};

/// Initial age, in periods: half a period until the measurement is read, half a period until the command is
/// read.
const FIRST_AGE: f64 = 1.0;

/// Initial standard deviation of the age, in periods.
const UNCERTAIN: f64 = 2.0;

/// Standard deviation of the change of the age per second, in periods: the age jumps by one period wherever
/// the number of samples between two steps differs by one; with clocks that differ by a thousandth, this
/// happens every few seconds.
const JUMPS: f64 = 1.0;

/// Standard deviation of the delay of a single message, in periods: the transmission time varies uniformly
/// over a period, and so does the waiting time until a step. A uniform distribution has a variance of 1/12;
/// this is the square root of 1/6.
const JITTER: f64 = 0.408_248_290_463_863;

/// Ages, in periods, at which the inputs need not be held back further; `KNOWN` is the standard deviation of
/// the age, in periods, below which it counts as known.
const HELD_WELL: Range<f64> = -0.25..2.25;
const KNOWN: f64 = 0.75;

/// Longest time by which inputs are held back, s; a larger delay belongs in the vehicle file.
const LONGEST_HELD_S: f64 = 0.2;

/// Number of stored rows of expected outputs. When the inputs are held back correctly, four are enough;
/// before that the age may be larger.
const ROWS: usize = 16;

/// Standard deviation of the delay of a single message, s.
pub(crate) fn jitter_s(period_s: f64) -> f64 {
    JITTER * period_s
}

/// The age of the measurements, and the outputs that were expected in the last steps.
#[derive(Debug, Clone)]
pub(crate) struct Lateness {
    estimator: MeasurementAge,
    period_s: f64,
    age_s: f64,
    /// Expected outputs after the last steps, a ring of which `filled` rows are valid.
    rows: [Vec<f64>; ROWS],
    filled: usize,
    newest: usize,
    /// Inputs that led to the expected outputs.
    inputs: [Vec<f64>; ROWS],
    expected: Vec<f64>,
    slope: Vec<f64>,
    /// Rows of the inputs that changed about when the measurements were taken: each now, and before.
    changes: [[usize; 2]; 2],
    /// What a correction of the states changes in the outputs.
    correction: Vec<f64>,
    /// Input and output matrices of the vehicle's own states.
    b: DMatrix<f64>,
    c: DMatrix<f64>,
    /// Variance of the unpredictable part of each output.
    shaken: Vec<f64>,
    /// Additional uncertainty of states (`pushes`) and measurements (`more`) from the uncertain times of
    /// input changes.
    pushes: Vec<f64>,
    more: Vec<f64>,
}

impl Lateness {
    /// The estimator for a filter whose first states are the vehicle's own, with the input matrix `b` and the
    /// output matrix `c`; `shaken` is the variance of the unpredictable part of each output.
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
            newest: 0,
            inputs: std::array::from_fn(|_| vec![0.0; b.ncols()]),
            expected: vec![0.0; outputs],
            slope: vec![0.0; outputs],
            changes: [[0; 2]; 2],
            correction: vec![0.0; outputs],
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

    /// Restarts with an age and its standard deviation, s.
    pub fn begin(&mut self, [age_s, std_s]: [f64; 2]) {
        self.filled = 0;
        self.age_s = age_s;
        self.estimator.begin(std_s);
    }

    /// Restarts with an age and its standard deviation, s, and holds it.
    pub fn hold(&mut self, age: [f64; 2]) {
        self.age_s = age[0];
        self.estimator.begin(age[1]);
        self.estimator.hold();
    }

    /// Restarts with the age known to `other`, for inputs that are held back by `more` additional periods.
    pub fn know(&mut self, other: &Self, more: f64) {
        let [age_s, std_s] = other.age();
        self.begin([age_s - more * self.period_s, std_s]);
    }

    /// Whether the age is known. Before the vehicle has moved it is not, and the expected outputs are then
    /// unreliable.
    pub fn is_known(&self) -> bool {
        self.estimator.std() < KNOWN * self.period_s
    }

    /// Number of additional periods by which the inputs should be held back; 0 where this is correct already,
    /// or where the age is unknown.
    pub fn amiss(&self) -> f64 {
        let age = self.age_s / self.period_s;
        if self.is_known() && !HELD_WELL.contains(&age) { (age - FIRST_AGE).round() } else { 0.0 }
    }

    /// Stores the inputs of a step and the outputs that are expected at its end. Returns the outputs that are
    /// expected for the measurements that are available now.
    pub fn expect(&mut self, u: &[f64], end: &[f64]) -> &[f64] {
        self.newest = (self.newest + 1) % ROWS;
        self.rows[self.newest].copy_from_slice(end);
        self.inputs[self.newest].copy_from_slice(u);
        self.filled = (self.filled + 1).min(ROWS);
        let steps = self.age_s / self.period_s;
        // Until enough rows are stored, the outputs are extrapolated backwards along the oldest slope.
        let whole = (steps.max(0.0) as usize).min(self.filled.saturating_sub(2));
        let share = steps - whole as f64;
        let before = (whole + 1).min(self.filled - 1);
        let row = |steps_ago: usize| (self.newest + ROWS - steps_ago) % ROWS;
        let both = self.rows[row(whole)].iter().zip(&self.rows[row(before)]);
        for ((expected, slope), (late, earlier)) in self.expected.iter_mut().zip(&mut self.slope).zip(both) {
            *expected = late + share * (earlier - late);
            *slope = (late - earlier) / self.period_s;
        }
        // Include the input change before the measurements were taken and the next one, which may have acted
        // already.
        self.changes = [[whole, before], [whole.saturating_sub(1), whole]].map(|pair| pair.map(row));
        &self.expected
    }

    /// Computes the uncertainty of the measurements and of the states at their time, since the inputs changed
    /// somewhat earlier or later than expected.
    fn uncertain(&mut self) {
        let jitter_s = jitter_s(self.period_s);
        self.pushes.fill(0.0);
        let count = self.pushes.len() / 2;
        for (push, [now, before]) in self.pushes.chunks_exact_mut(count).zip(self.changes) {
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

    /// A filter step with the residual of the [expected](Self::expect) outputs; its errors are also corrected
    /// by the part that the age explains. With empty `gains` they are computed, otherwise those given are
    /// used.
    pub fn step(
        &mut self,
        filter: &mut KalmanFilter,
        (residual, fresh): (&[f64], u64),
        gains: &[f64],
        errors: &mut [f64],
    ) {
        if gains.is_empty() {
            self.uncertain();
            filter.step_uncertain(residual, fresh, (&self.pushes, &self.more));
        } else {
            filter.step_by(residual, fresh, gains);
        }
        errors.copy_from_slice(filter.x());
        let change = self.estimator.step(filter, &self.slope);
        self.age_s += change;
        errors.iter_mut().zip(self.estimator.change()).for_each(|(e, change)| *e += change);
        // The error found in the states also corrects the expected outputs of earlier steps.
        self.correction.fill(0.0);
        for (error, c) in errors.iter().zip(self.c.as_slice().chunks_exact(self.correction.len())) {
            self.correction.iter_mut().zip(c).for_each(|(y, c)| *y += c * error);
        }
        for row in &mut self.rows {
            row.iter_mut().zip(&self.correction).for_each(|(y, change)| *y += change);
        }
    }

    /// Whitened innovations of the last step.
    pub fn whitened(&self) -> &[f64] {
        self.estimator.whitened()
    }
}

/// Inputs of a real vehicle, delayed by whole periods.
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
    /// A delay line for `inputs` inputs, initially without delay.
    pub fn new(inputs: usize, period_s: f64) -> Self {
        let count = (LONGEST_HELD_S / period_s).ceil() as usize + 1;
        Self { rows: vec![0.0; count * inputs], count, inputs, newest: 0, held: 0, u: vec![0.0; inputs] }
    }

    /// Stores the inputs of a step, and returns those of the step at whose end the present measurements were
    /// taken.
    pub fn hold(&mut self, u: &[f64]) -> &[f64] {
        self.newest = (self.newest + 1) % self.count;
        let row = |index: usize| index * self.inputs..(index + 1) * self.inputs;
        self.rows[row(self.newest)].copy_from_slice(u);
        self.u.copy_from_slice(&self.rows[row((self.newest + self.count - self.held) % self.count)]);
        &self.u
    }

    /// Increases the delay by `more` periods within its limits, and returns the actual increase.
    pub fn hold_more(&mut self, more: f64) -> f64 {
        let before = self.held as f64;
        self.held = (before + more).clamp(0.0, (self.count - 1) as f64) as usize;
        self.held as f64 - before
    }
}
