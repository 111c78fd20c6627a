//! Lack-of-fit test: whether the final residual is noise, against all smooth functions that the table does
//! not name.
//!
//! Products and powers of inputs, states and outputs, as forces on the states and as errors of the sensors,
//! are fitted to the whitened residual all at once. Which of them explains the residual does not matter: if
//! together they explain more than chance would, the named causes are incomplete or wrong.

use crate::thresholds::{
    GRAM_BLOCK_ROWS, GRAM_PANEL_COLUMNS, LACK_CERTAIN_P_VALUE, LACK_ENERGY, LACK_P_VALUE, LACK_SIGMAS,
    MAX_AR_ORDER, PRODUCT_STATES, RELAY_THRESHOLDS, SLOW_TURNS, TESTED_SAMPLES, TESTED_STATES,
    TESTED_TOGETHER,
};
use std::ops::Range;

use nalgebra::{DMatrix, DMatrixViewMut, DVector};
use rayon::prelude::*;
use whirlstand_linalg::symmetric_eigen;
use whirlstand_vehicle::Vehicle;

use super::basis::{SHAPES, Signal, Signals, product, scale, slowly, smooth, switched};
use crate::candidates::library::Sizes;
use crate::model::columns::dot;
use crate::model::fit::{Fit, Model};
use crate::model::forced_response::Forces;
use crate::model::score_test::ScoreTest;
use whirlstand_logs::stats::chi_square_tail;

/// Part of the residual that functions explain, compared with chance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Excess {
    /// Energy explained beyond chance, in the scale of detectability.
    pub energy: f64,
    /// Excess of that energy over chance, in standard deviations.
    pub sigmas: f64,
    /// Probability that chance explains as much.
    pub chance: f64,
}

/// Lack of fit explained by all functions together, and by those of the one signal that explains most.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LackOfFit {
    /// All functions.
    pub all: Excess,
    /// Functions of one signal, as one force or one sensor's error; the one that stands out most.
    pub one: Excess,
}

impl LackOfFit {
    /// True when the final residual follows a signal, whatever the spectrum of turbulence.
    pub fn is_certain(&self) -> bool {
        self.one.chance < LACK_CERTAIN_P_VALUE
    }

    fn all_tell(&self) -> bool {
        self.all.sigmas > LACK_SIGMAS && self.all.energy > LACK_ENERGY
    }

    fn one_tells(&self) -> bool {
        self.one.chance < LACK_P_VALUE
    }

    /// The result of a test, if one was made, with functions of one signal that gain `gain` in BIC, when that is
    /// more.
    pub fn or_one(tested: Option<Self>, gain: f64) -> Self {
        let one = Excess { energy: gain, sigmas: gain.sqrt(), chance: (-0.5 * gain).exp() };
        match tested {
            None => Self { all: one, one },
            Some(tested) if one.energy > tested.one.energy => Self { one, ..tested },
            Some(tested) => tested,
        }
    }

    /// Energy of the final residual that is not noise.
    pub fn left(&self) -> f64 {
        let all = if self.all_tell() { self.all.energy } else { 0.0 };
        if self.one_tells() { all.max(self.one.energy) } else { all }
    }

    /// True when the final residual is significantly not noise.
    pub fn is_significant(&self) -> bool {
        self.all_tell() || self.one_tells()
    }
}

/// Tests the residual of a fit, except for the channels that are `known` to have errors of their own. `None`
/// when no function could be tested.
pub fn lack_of_fit(model: &Model<'_, '_>, fit: &Fit, sizes: &Sizes, known: &[usize]) -> Option<LackOfFit> {
    let data = model.free_run.data;
    let vehicle = model.vehicle(&fit.values).ok()?;
    let states = model.free_run.run_states(&vehicle, &fit.values[..model.states()]).ok()?;
    let signals = Signals::new(model, states);
    let forced = forced(&vehicle).into_iter().map(|s| (s, sizes.slopes[s])).collect::<Vec<_>>();
    let columns = Columns {
        score_test: ScoreTest::new(data, &fit.profile.noise, &fit.residual, &fit.columns),
        forces: Forces::new(model, fit, &vehicle, &forced),
        groups: groups(&signals),
        sensors: vehicle.states.len(),
        fit,
    };
    // Of a long record the beginning suffices; testing all of it would take long. The first rows are not white: with
    // slow noise they would count many times.
    let rows = TESTED_SAMPLES / data.channels.len().max(1);
    let part = |r: Range<usize>| r.end.min(r.start + MAX_AR_ORDER)..r.end.min(r.start + rows);
    let parts: Vec<Range<usize>> = data.ranges().into_iter().map(part).collect();
    let tested: Vec<&Range<usize>> =
        parts.iter().enumerate().filter(|(c, _)| !known.contains(c)).map(|(_, part)| part).collect();
    // The inner products are sums over the channels: as many channels are processed at a time as fit into
    // memory.
    let longest = parts.iter().map(Range::len).max().unwrap_or(0);
    let together = TESTED_TOGETHER / (columns.count(forced.len()) * longest).max(1);
    let mut all = Products::default();
    for parts in tested.chunks(together.max(1)) {
        all.add(&columns, parts);
    }
    let (gram, right, of) = all.normalised()?;
    let mut groups = of.clone();
    groups.sort_unstable();
    groups.dedup();
    let looks = groups.len() as f64;
    let one = groups.into_iter().filter_map(|group| {
        let own: Vec<usize> = (0..of.len()).filter(|i| of[*i] == group).collect();
        explained(gram.select_rows(&own).select_columns(&own), &right.select_rows(&own))
    });
    let one = one.min_by(|a, b| a.chance.total_cmp(&b.chance))?;
    Some(LackOfFit {
        all: explained(gram, &right)?,
        one: Excess { chance: (looks * one.chance).min(1.0), ..one },
    })
}

/// States whose derivative is not only another state (an integral), those driven by an input first.
fn forced(vehicle: &Vehicle) -> Vec<usize> {
    let dynamic = |i: &usize| vehicle.kinematic_row(*i).is_none();
    let mut all: Vec<usize> = (0..vehicle.states.len()).filter(dynamic).collect();
    let driven = |i: usize| vehicle.b.row(i).iter().any(|v| *v != 0.0);
    all.sort_by_key(|i| !driven(*i));
    all.truncate(TESTED_STATES);
    all
}

/// Origin of a column: the state that it forces and its group of functions; errors of sensors follow after
/// the states, by channel.
type Of = (usize, usize);

/// Whitened signatures of all functions, as forces and as errors of the sensors.
struct Columns<'a> {
    score_test: ScoreTest<'a>,
    forces: Forces<'a>,
    groups: Vec<Group<'a>>,
    /// Index that stands for the sensors in place of a state.
    sensors: usize,
    fit: &'a Fit,
}

impl Columns<'_> {
    /// Largest number of columns.
    fn count(&self, forced: usize) -> usize {
        let functions: usize = self.groups.iter().map(|group| group.count).sum();
        functions * forced + self.score_test.data().channels.len() * SENSOR_ERRORS.len()
    }

    /// The samples of each column that lie in `parts`.
    fn over(&self, parts: &[&Range<usize>]) -> Vec<(Of, Vec<f64>)> {
        let counted = |samples: &[f64]| -> Vec<f64> {
            let mut white = self.score_test.signature(samples);
            let data = self.score_test.data();
            for (channel, range) in data.channels.iter().zip(data.ranges()) {
                channel.early.iter().for_each(|k| white[range.start + k] = 0.0);
            }
            parts.iter().flat_map(|part| &white[(*part).clone()]).copied().collect()
        };
        let mut columns: Vec<(Of, Vec<f64>)> = Vec::new();
        for (of, group) in self.groups.iter().enumerate() {
            let functions = (group.make)();
            let values: Vec<&[f64]> = functions.iter().map(Vec::as_slice).collect();
            columns.extend(self.forces.each(&values, |state, _, response| ((state, of), counted(&response))));
        }
        let predicted = &self.fit.predicted;
        for (c, range) in self.score_test.data().ranges().into_iter().enumerate() {
            let mut own = predicted[range.clone()].to_vec();
            scale(&mut own);
            for error in SENSOR_ERRORS {
                let mut column = vec![0.0; predicted.len()];
                column[range.clone()].iter_mut().zip(&own).for_each(|(c, v)| *c = error(*v));
                columns.push(((self.sensors, c), counted(&column)));
            }
        }
        columns
    }
}

/// Errors of a sensor as functions of its measurement.
const SENSOR_ERRORS: [fn(f64) -> f64; 4] = [|v| v, |v| v * v, |v| v * v.abs(), |v| v * v * v];

/// Inner products of all columns with each other and with the residual.
#[derive(Default)]
struct Products {
    gram: DMatrix<f64>,
    right: DVector<f64>,
    of: Vec<Of>,
}

impl Products {
    /// Adds the inner products over some parts of the samples.
    fn add(&mut self, columns: &Columns<'_>, parts: &[&Range<usize>]) {
        let residual: Vec<f64> =
            parts.iter().flat_map(|part| &columns.score_test.residual()[(*part).clone()]).copied().collect();
        let (of, columns): (Vec<Of>, Vec<Vec<f64>>) = columns.over(parts).into_iter().unzip();
        let n = columns.len();
        if self.of.is_empty() {
            *self = Self { gram: DMatrix::zeros(n, n), right: DVector::zeros(n), of };
        }
        for (right, column) in self.right.iter_mut().zip(&columns) {
            *right += dot(column, &residual);
        }
        add_gram(&mut self.gram, &columns);
    }

    /// Inner products of columns normalised to unit length, without those that nuisances explain or that are
    /// not finite; `None` when none is left.
    fn normalised(self) -> Option<(DMatrix<f64>, DVector<f64>, Vec<Of>)> {
        let norms: Vec<f64> = self.gram.diagonal().iter().map(|d| d.sqrt()).collect();
        let left: Vec<usize> =
            (0..norms.len()).filter(|i| norms[*i] > 1e-6 && norms[*i].is_finite()).collect();
        if left.is_empty() {
            return None;
        }
        let n = left.len();
        let gram =
            DMatrix::from_fn(n, n, |i, j| self.gram[(left[i], left[j])] / (norms[left[i]] * norms[left[j]]));
        let right = DVector::from_fn(n, |i, _| self.right[left[i]] / norms[left[i]]);
        Some((gram, right, left.into_iter().map(|i| self.of[i]).collect()))
    }
}

/// Part of the residual that columns explain, from their products with each other and with the residual; none
/// when those are not finite.
fn explained(gram: DMatrix<f64>, right: &DVector<f64>) -> Option<Excess> {
    // Directions that repeat others contain only rounding errors.
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

/// Functions of time that a force could follow, derived from one signal in one way, and tested together.
struct Group<'s> {
    count: usize,
    /// Creates the functions on demand.
    make: Box<dyn Fn() -> Vec<Vec<f64>> + Sync + 's>,
}

/// All functions that a force could follow.
fn groups<'a>(signals: &'a Signals) -> Vec<Group<'a>> {
    let mut all: Vec<Group<'a>> = Vec::new();
    // Of a vehicle with many states, products are too many.
    let few = signals.states.len() <= PRODUCT_STATES;
    let others = |later: &'a [Signal], inputs: &'a [Signal]| -> Vec<&'a Signal> {
        if few { later.iter().chain(inputs).collect() } else { Vec::new() }
    };
    let times = |x: &Signal, others: &[&Signal]| others.iter().map(|y| product(x, y)).collect::<Vec<_>>();
    for (j, u) in signals.inputs.iter().enumerate() {
        let others = others(&signals.inputs[j + 1..], &[]);
        let count = SHAPES.len() + RELAY_THRESHOLDS.len() + others.len();
        let bent = move || {
            let shapes = [smooth(u), switched(u)].into_iter().flat_map(|b| b.functions);
            shapes.chain(times(u, &others)).collect()
        };
        all.push(Group { count, make: Box::new(bent) });
        all.push(Group { count: 2 * SLOW_TURNS, make: Box::new(move || slowly(u).functions) });
    }
    for (i, x) in signals.states.iter().enumerate() {
        let others = others(&signals.states[i + 1..], &signals.inputs);
        all.push(Group {
            count: SHAPES.len() + others.len(),
            make: Box::new(move || smooth(x).functions.into_iter().chain(times(x, &others)).collect()),
        });
    }
    all
}

/// Adds the products of all columns with each other, a block of rows at a time: of the symmetric matrix the upper
/// half, panels of columns side by side.
fn add_gram(gram: &mut DMatrix<f64>, columns: &[Vec<f64>]) {
    let n = columns.len();
    let rows = columns.first().map_or(0, Vec::len);
    for from in (0..rows).step_by(GRAM_BLOCK_ROWS) {
        let until = (from + GRAM_BLOCK_ROWS).min(rows);
        let flat: Vec<f64> = columns.iter().flat_map(|c| &c[from..until]).copied().collect();
        let block = DMatrix::from_vec(until - from, n, flat);
        let across = block.transpose();
        let panels = gram.as_mut_slice().par_chunks_mut(n * GRAM_PANEL_COLUMNS).enumerate();
        panels.for_each(|(panel, values)| {
            let (first, width) = (panel * GRAM_PANEL_COLUMNS, values.len() / n);
            let upper = first + width;
            let mut panel = DMatrixViewMut::from_slice(values, n, width);
            panel.rows_mut(0, upper).gemm(1.0, &across.rows(0, upper), &block.columns(first, width), 1.0);
        });
    }
    gram.fill_lower_triangle_with_upper_triangle();
}
