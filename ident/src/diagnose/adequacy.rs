//! Whether what is left is noise: a test against everything smooth that the table does not name.
//!
//! Products and powers of inputs, states and outputs, as forces on the states and as errors of the sensors, are fitted
//! to the whitened residual all at once. Nobody needs to know which it is: if together they explain more than chance
//! would, the named causes are not the whole truth, and perhaps not the truth at all.

use nalgebra::{DMatrix, DVector};
use whirlstand_vehicle::Vehicle;

use super::forces::Forces;
use super::library::Sizes;
use super::model::{Fit, Model, dot};
use super::screen::Frame;
use crate::identify::quality::chi_square_tail;

/// Forces are tried on so many states at most.
const FORCED: usize = 3;
/// Products of states are tried up to so many states.
const FEW_STATES: usize = 4;

/// Share of an input's largest magnitude from which on a switch is through.
const SMALL: f64 = 0.1;
/// How often an input's effect may swing over the record.
const SWINGS: usize = 6;
/// Functions of an input that are the same at all times.
const STATIC: usize = 5 + THRESHOLDS.len();
/// Thresholds of relays, as shares of a signal's largest magnitude.
pub(super) const THRESHOLDS: [f64; 5] = [0.05, 0.1, 0.2, 0.35, 0.6];

/// Samples of all channels that are looked at, at most.
const LOOKED_AT: usize = 100_000;

/// What is left, against chance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Left {
    /// Energy of what is left beyond chance, in the scale of detectability.
    pub energy: f64,
    /// By how many standard deviations that is more than chance.
    pub sigmas: f64,
    /// Probability that chance leaves as much.
    pub chance: f64,
}

/// What is left by all functions together, and by those of the one signal that explains most.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lack {
    /// All functions.
    pub all: Left,
    /// Functions of one signal, as one force or one sensor's error; the one that stands out most.
    pub one: Left,
}

/// All functions together tell beyond so many standard deviations of chance,
const SIGMAS: f64 = 5.0;
/// from this energy on, twice what a single effect needs to be told at all,
const SURE: f64 = 40.0;
/// and from this share on of what the causes explain.
const BELIEVED: f64 = 0.004;
/// One signal tells below this probability of chance, of all looks together,
const CHANCE: f64 = 1e-3;
/// and from this share on: a cause that is true leaves next to nothing that follows a signal.
const TRUE: f64 = 0.01;

/// Beside turbulence, of whose spectrum a short record shows little, one signal tells below this probability.
const CERTAIN: f64 = 1e-7;

impl Lack {
    /// True when what is left follows a signal, whatever the spectrum of turbulence.
    pub fn is_certain(&self) -> bool {
        self.one.chance < CERTAIN
    }

    fn all_tell(&self) -> bool {
        self.all.sigmas > SIGMAS && self.all.energy > SURE
    }

    fn one_tells(&self) -> bool {
        self.one.chance < CHANCE
    }

    /// With functions of one signal that explain so much in BIC, when that is more.
    pub fn or_one(self, gain: f64) -> Self {
        let told = Left { energy: gain, sigmas: gain.sqrt(), chance: (-0.5 * gain).exp() };
        if told.energy > self.one.energy { Self { one: told, ..self } } else { self }
    }

    /// True when what is left is no noise.
    pub fn is_told(&self) -> bool {
        self.all_tell() || self.one_tells()
    }

    /// True when it is too much for causes that explain this energy to be true.
    pub fn outweighs(&self, explained: f64) -> bool {
        self.all_tell() && self.all.energy > BELIEVED * explained
            || self.one_tells() && self.one.energy > TRUE * explained
    }
}

/// Tests the residual of a fit, but for the channels that are `known` to have errors of their own. `None` when nothing
/// could be tried.
pub fn lack(model: &Model<'_, '_>, fit: &Fit, sizes: &Sizes, known: &[usize]) -> Option<Lack> {
    let data = model.runner.data;
    let frame = Frame::new(data, &fit.profile.noise, &fit.residual, &fit.columns);
    let ranges = data.ranges();
    // Of a long record the beginning is enough; all of it would fill the memory.
    let rows = LOOKED_AT / ranges.len().max(1);
    let counted = |samples: &[f64]| -> Vec<f64> {
        let channels = ranges.iter().enumerate().filter(|(c, _)| !known.contains(c));
        channels.flat_map(|(_, r)| samples[r.clone()].iter().take(rows).copied()).collect()
    };
    let vehicle = model.vehicle(&fit.values)?;
    let states = states(&vehicle, model, fit)?;
    let functions = functions(model, &states);
    let forced: Vec<usize> = {
        let dynamic = |i: &usize| {
            let row = vehicle.a.row(*i);
            row.iter().filter(|v| **v != 0.0).count() > 1 || vehicle.b.row(*i).iter().any(|v| *v != 0.0)
        };
        let mut all: Vec<usize> = (0..vehicle.states.len()).filter(dynamic).collect();
        let driven = |i: usize| vehicle.b.row(i).iter().any(|v| *v != 0.0);
        all.sort_by_key(|i| !driven(*i));
        all.truncate(FORCED);
        all
    };
    let values: Vec<&[f64]> = functions.iter().map(|f| f.values.as_slice()).collect();
    let forced: Vec<(usize, f64)> = forced.into_iter().map(|s| (s, sizes.slopes[s])).collect();
    let forces = Forces::new(model, fit, &vehicle, &forced, values[0]);
    // Of each column, which state it forces and which signal it follows; sensors come behind.
    let mut columns: Vec<(usize, usize, Vec<f64>)> = forces.each(&values, |state, function, response| {
        (state, functions[function].of, counted(&frame.signature(&response)))
    });
    let n = vehicle.states.len();
    columns.extend(sensors(model, fit).iter().map(|(c, s)| (n, *c, counted(&frame.signature(s)))));
    columns.retain_mut(|(_, _, c)| {
        let norm = dot(c, c).sqrt();
        // What nuisances explain tells nothing.
        let told = norm > 1e-6 && norm.is_finite();
        if told {
            c.iter_mut().for_each(|v| *v /= norm);
        }
        told
    });
    if columns.is_empty() {
        return None;
    }
    let n = columns.len();
    let residual = counted(frame.residual());
    let right = DVector::from_iterator(n, columns.iter().map(|(_, _, c)| dot(c, &residual)));
    let of: Vec<(usize, usize)> = columns.iter().map(|(s, f, _)| (*s, *f)).collect();
    let gram = gram(&columns.into_iter().map(|(_, _, c)| c).collect::<Vec<_>>());
    let mut groups = of.clone();
    groups.sort_unstable();
    groups.dedup();
    let looks = groups.len() as f64;
    let one = groups.into_iter().map(|group| {
        let own: Vec<usize> = (0..n).filter(|i| of[*i] == group).collect();
        explained(gram.select_rows(&own).select_columns(&own), &right.select_rows(&own))
    });
    let one = one.min_by(|a, b| a.chance.total_cmp(&b.chance))?;
    Some(Lack { all: explained(gram, &right), one: Left { chance: (looks * one.chance).min(1.0), ..one } })
}

/// What columns explain, given by their products with each other and with the residual.
fn explained(gram: DMatrix<f64>, right: &DVector<f64>) -> Left {
    // Directions that repeat others carry rounding only.
    let eigen = gram.symmetric_eigen();
    let strongest = eigen.eigenvalues.max();
    let (mut energy, mut degrees) = (0.0, 0.0);
    for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        if *value > 1e-6 * strongest {
            energy += vector.dot(right).powi(2) / value;
            degrees += 1.0;
        }
    }
    Left {
        energy: energy - degrees,
        sigmas: (energy - degrees) / (2.0f64 * degrees).sqrt(),
        chance: chi_square_tail(energy, degrees),
    }
}

/// States of the fitted run, over the steps of the record, each over its largest magnitude.
fn states(vehicle: &Vehicle, model: &Model<'_, '_>, fit: &Fit) -> Option<Vec<Vec<f64>>> {
    let mut states = motion(vehicle, model, fit)?;
    states.iter_mut().for_each(|s| scale(s));
    Some(states)
}

/// States of the fitted run, over the steps of the record, SI.
pub(super) fn motion(vehicle: &Vehicle, model: &Model<'_, '_>, fit: &Fit) -> Option<Vec<Vec<f64>>> {
    let data = model.runner.data;
    let n = vehicle.states.len();
    let mut simulator = data.begin(vehicle, 0)?;
    let mut states = vec![Vec::with_capacity(data.steps); n];
    for (k, u) in data.inputs.chunks_exact(data.m).enumerate() {
        if let Some(record) = data.starts.iter().position(|s| *s == k) {
            simulator = data.begin(vehicle, k)?;
            simulator.set_state(&fit.values[record * n..(record + 1) * n]);
        }
        states.iter_mut().zip(simulator.state()).for_each(|(column, x)| column.push(*x));
        simulator.step(u);
    }
    Some(states)
}

/// Over the largest magnitude.
pub(super) fn scale(values: &mut [f64]) {
    let peak = values.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    if peak > 0.0 {
        values.iter_mut().for_each(|v| *v /= peak);
    }
}

/// What a force could follow.
struct Function {
    /// Which signal it is made from: inputs, then states.
    of: usize,
    values: Vec<f64>,
}

/// Plus one from where a signal rises above a threshold until it falls below minus that, then minus one.
pub(super) fn relayed(signal: &[f64], threshold: f64) -> Vec<f64> {
    let mut now = 0.0;
    let mut switched = |v: &f64| {
        if v.abs() > threshold {
            now = v.signum();
        }
        now
    };
    signal.iter().map(&mut switched).collect()
}

/// Functions of time that a force could follow.
fn functions(model: &Model<'_, '_>, states: &[Vec<f64>]) -> Vec<Function> {
    let data = model.runner.data;
    let mut inputs: Vec<Vec<f64>> = (0..data.m).map(|j| data.input(j).collect()).collect();
    inputs.iter_mut().for_each(|u| scale(u));
    let mut all = Vec::new();
    let map = |v: &[f64], f: fn(f64) -> f64| v.iter().map(|v| f(*v)).collect::<Vec<f64>>();
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).collect::<Vec<f64>>();
    let m = inputs.len();
    for (j, u) in inputs.iter().enumerate() {
        let mut own = vec![map(u, |u| u), map(u, f64::abs), map(u, |u| u * u), map(u, |u| u * u * u)];
        own.push(map(u, |u| (u / SMALL).tanh()));
        own.extend(THRESHOLDS.map(|t| relayed(u, t)));
        // An input that acts now more, now less.
        for turns in 1..=SWINGS {
            let angle = |k: usize| std::f64::consts::TAU * (turns * k) as f64 / data.steps as f64;
            own.push(u.iter().enumerate().map(|(k, u)| u * angle(k).sin()).collect());
            own.push(u.iter().enumerate().map(|(k, u)| u * angle(k).cos()).collect());
        }
        all.extend(
            own.into_iter().enumerate().map(|(i, values)| Function {
                of: if i < STATIC { j } else { m + states.len() + j },
                values,
            }),
        );
    }
    for (i, x) in states.iter().enumerate() {
        let mut own = vec![map(x, |x| x), map(x, |x| x * x), map(x, |x| x * x.abs()), map(x, |x| x * x * x)];
        if states.len() <= FEW_STATES {
            own.extend(states[i + 1..].iter().map(|y| product(x, y)));
            own.extend(inputs.iter().map(|u| product(x, u)));
        }
        all.extend(own.into_iter().map(|values| Function { of: m + i, values }));
    }
    all
}

/// Rows of a block.
const ROWS: usize = 2048;

/// Products of all columns with each other, a block of rows at a time.
fn gram(columns: &[Vec<f64>]) -> DMatrix<f64> {
    let n = columns.len();
    let rows = columns.first().map_or(0, Vec::len);
    let mut gram = DMatrix::zeros(n, n);
    for from in (0..rows).step_by(ROWS) {
        let until = (from + ROWS).min(rows);
        let flat: Vec<f64> = columns.iter().flat_map(|c| &c[from..until]).copied().collect();
        let block = DMatrix::from_vec(until - from, n, flat);
        gram.gemm(1.0, &block.transpose(), &block, 1.0);
    }
    gram
}

/// By channel, errors of a sensor that follow what it measures, or what another measures.
fn sensors(model: &Model<'_, '_>, fit: &Fit) -> Vec<(usize, Vec<f64>)> {
    let data = model.runner.data;
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
