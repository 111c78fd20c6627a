//! Whether what is left is noise: a test against everything smooth that the table does not name.
//!
//! Products and powers of inputs, states and outputs, as forces on the states and as errors of the sensors, are fitted
//! to the whitened residual all at once. Nobody needs to know which it is: if together they explain more than chance
//! would, the named causes are not the whole truth, and perhaps not the truth at all.

use crate::thresholds::{
    GRAM_BLOCK_ROWS, LACK_CERTAIN_P_VALUE, LACK_ENERGY, LACK_P_VALUE, LACK_SIGMAS, PRODUCT_STATES,
    TESTED_SAMPLES, TESTED_STATES,
};
use nalgebra::{DMatrix, DVector};
use whirlstand_linalg::symmetric_eigen;

use super::basis::{Signals, product, scale, slowly, smooth, switched};
use crate::candidates::library::Sizes;
use crate::model::fit::{Fit, Model, dot};
use crate::model::forced_response::Forces;
use crate::model::score_test::ScoreTest;
use whirlstand_logs::stats::chi_square_tail;

/// What is left, against chance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Excess {
    /// Energy of what is left beyond chance, in the scale of detectability.
    pub energy: f64,
    /// By how many standard deviations that is more than chance.
    pub sigmas: f64,
    /// Probability that chance leaves as much.
    pub chance: f64,
}

/// What is left by all functions together, and by those of the one signal that explains most.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LackOfFit {
    /// All functions.
    pub all: Excess,
    /// Functions of one signal, as one force or one sensor's error; the one that stands out most.
    pub one: Excess,
}

impl LackOfFit {
    /// True when what is left follows a signal, whatever the spectrum of turbulence.
    pub fn is_certain(&self) -> bool {
        self.one.chance < LACK_CERTAIN_P_VALUE
    }

    fn all_tell(&self) -> bool {
        self.all.sigmas > LACK_SIGMAS && self.all.energy > LACK_ENERGY
    }

    fn one_tells(&self) -> bool {
        self.one.chance < LACK_P_VALUE
    }

    /// With functions of one signal that explain so much in BIC, when that is more.
    pub fn or_one(self, gain: f64) -> Self {
        let all = Excess { energy: gain, sigmas: gain.sqrt(), chance: (-0.5 * gain).exp() };
        if all.energy > self.one.energy { Self { one: all, ..self } } else { self }
    }

    /// Energy of what is left and no noise.
    pub fn left(&self) -> f64 {
        let all = if self.all_tell() { self.all.energy } else { 0.0 };
        if self.one_tells() { all.max(self.one.energy) } else { all }
    }

    /// True when what is left is no noise.
    pub fn is_significant(&self) -> bool {
        self.all_tell() || self.one_tells()
    }
}

/// Tests the residual of a fit, but for the channels that are `known` to have errors of their own. `None` when nothing
/// could be tried.
pub fn lack_of_fit(model: &Model<'_, '_>, fit: &Fit, sizes: &Sizes, known: &[usize]) -> Option<LackOfFit> {
    let data = model.free_run.data;
    let score_test = ScoreTest::new(data, &fit.profile.noise, &fit.residual, &fit.columns);
    let ranges = data.ranges();
    // Of a long record the beginning is enough; all of it would fill the memory.
    let rows = TESTED_SAMPLES / ranges.len().max(1);
    let counted = |samples: &[f64]| -> Vec<f64> {
        let channels = ranges.iter().enumerate().filter(|(c, _)| !known.contains(c));
        channels.flat_map(|(_, r)| samples[r.clone()].iter().take(rows).copied()).collect()
    };
    let vehicle = model.vehicle(&fit.values).ok()?;
    let states = model.free_run.run_states(&vehicle, &fit.values[..model.states()]).ok()?;
    let functions = functions(&Signals::new(model, states));
    let forced: Vec<usize> = {
        let dynamic = |i: &usize| vehicle.kinematic_row(*i).is_none();
        let mut all: Vec<usize> = (0..vehicle.states.len()).filter(dynamic).collect();
        let driven = |i: usize| vehicle.b.row(i).iter().any(|v| *v != 0.0);
        all.sort_by_key(|i| !driven(*i));
        all.truncate(TESTED_STATES);
        all
    };
    let values: Vec<&[f64]> = functions.iter().map(|f| f.values.as_slice()).collect();
    let forced: Vec<(usize, f64)> = forced.into_iter().map(|s| (s, sizes.slopes[s])).collect();
    let forces = Forces::new(model, fit, &vehicle, &forced, values[0]);
    // Of each column, which state it forces and which signal it follows; sensors come behind.
    let mut columns: Vec<(usize, usize, Vec<f64>)> = forces.each(&values, |state, function, response| {
        (state, functions[function].of, counted(&score_test.signature(&response)))
    });
    let n = vehicle.states.len();
    columns.extend(sensors(model, fit).iter().map(|(c, s)| (n, *c, counted(&score_test.signature(s)))));
    columns.retain_mut(|(_, _, c)| {
        let norm = dot(c, c).sqrt();
        // What nuisances explain tells nothing.
        let known = norm > 1e-6 && norm.is_finite();
        if known {
            c.iter_mut().for_each(|v| *v /= norm);
        }
        known
    });
    if columns.is_empty() {
        return None;
    }
    let n = columns.len();
    let residual = counted(score_test.residual());
    let right = DVector::from_iterator(n, columns.iter().map(|(_, _, c)| dot(c, &residual)));
    let of: Vec<(usize, usize)> = columns.iter().map(|(s, f, _)| (*s, *f)).collect();
    let gram = gram(&columns.into_iter().map(|(_, _, c)| c).collect::<Vec<_>>());
    let mut groups = of.clone();
    groups.sort_unstable();
    groups.dedup();
    let looks = groups.len() as f64;
    let one = groups.into_iter().filter_map(|group| {
        let own: Vec<usize> = (0..n).filter(|i| of[*i] == group).collect();
        explained(gram.select_rows(&own).select_columns(&own), &right.select_rows(&own))
    });
    let one = one.min_by(|a, b| a.chance.total_cmp(&b.chance))?;
    Some(LackOfFit {
        all: explained(gram, &right)?,
        one: Excess { chance: (looks * one.chance).min(1.0), ..one },
    })
}

/// What columns explain, given by their products with each other and with the residual; none when those are not finite.
fn explained(gram: DMatrix<f64>, right: &DVector<f64>) -> Option<Excess> {
    // Directions that repeat others carry rounding only.
    let (values, vectors) = symmetric_eigen(gram).ok()?;
    let strongest = values.max();
    let (mut energy, mut degrees) = (0.0, 0.0);
    for (value, vector) in values.iter().zip(vectors.column_iter()) {
        if *value > 1e-6 * strongest {
            energy += vector.dot(right).powi(2) / value;
            degrees += 1.0;
        }
    }
    Some(Excess {
        energy: energy - degrees,
        sigmas: (energy - degrees) / (2.0f64 * degrees).sqrt(),
        chance: chi_square_tail(energy, degrees),
    })
}

/// What a force could follow.
struct Function {
    /// Which signal it is made from, and in which way: functions of one number are tested together.
    of: usize,
    values: Vec<f64>,
}

/// Functions of time that a force could follow.
fn functions(signals: &Signals) -> Vec<Function> {
    let mut groups: Vec<Vec<Vec<f64>>> = Vec::new();
    for u in &signals.inputs {
        groups.push([smooth(u), switched(u)].into_iter().flat_map(|b| b.functions).collect());
        groups.push(slowly(u).functions);
    }
    for (i, x) in signals.states.iter().enumerate() {
        let mut own = smooth(x).functions;
        if signals.states.len() <= PRODUCT_STATES {
            let others = signals.states[i + 1..].iter().chain(&signals.inputs);
            own.extend(others.map(|y| product(x, y)));
        }
        groups.push(own);
    }
    let numbered = groups.into_iter().enumerate();
    numbered.flat_map(|(of, own)| own.into_iter().map(move |values| Function { of, values })).collect()
}

/// Products of all columns with each other, a block of rows at a time.
fn gram(columns: &[Vec<f64>]) -> DMatrix<f64> {
    let n = columns.len();
    let rows = columns.first().map_or(0, Vec::len);
    let mut gram = DMatrix::zeros(n, n);
    for from in (0..rows).step_by(GRAM_BLOCK_ROWS) {
        let until = (from + GRAM_BLOCK_ROWS).min(rows);
        let flat: Vec<f64> = columns.iter().flat_map(|c| &c[from..until]).copied().collect();
        let block = DMatrix::from_vec(until - from, n, flat);
        gram.gemm(1.0, &block.transpose(), &block, 1.0);
    }
    gram
}

/// By channel, errors of a sensor that follow what it measures, or what another measures.
fn sensors(model: &Model<'_, '_>, fit: &Fit) -> Vec<(usize, Vec<f64>)> {
    let data = model.free_run.data;
    let ranges = data.ranges();
    let mut all = Vec::new();
    for (c, range) in ranges.iter().enumerate() {
        let mut own = fit.predicted[range.clone()].to_vec();
        scale(&mut own);
        for f in [|v: f64| v, |v: f64| v * v, |v: f64| v * v.abs(), |v: f64| v * v * v] {
            let mut column = vec![0.0; fit.predicted.len()];
            column[range.clone()].iter_mut().zip(&own).for_each(|(c, v)| *c = f(*v));
            all.push((c, column));
        }
    }
    all
}
