//! Functions of inputs and states that a force could be, where no effect of the table is it.

use std::f64::consts::{PI, TAU};

use super::adequacy::{THRESHOLDS, relayed, scale};
use super::model::Model;

/// Share of a signal's largest magnitude from which on a switch is through.
const SMALL: f64 = 0.05;
/// How often an effect may swing over the record, all of it together.
const SWINGS: usize = 6;
/// Fastest swing of a stiffness or a gain that is looked for, Hz, and the most turns.
const FASTEST_HZ: f64 = 2.0;
const MOST_TURNS: usize = 64;
/// Half waves of a force over the reach of a state.
const WAVES: usize = 4;

/// Functions of the same signal, one value a step each.
pub type Family = Vec<Vec<f64>>;

/// What a force may follow, each over its largest magnitude.
pub struct Signals {
    inputs: Vec<Vec<f64>>,
    /// States over the steps of the record.
    pub states: Vec<Vec<f64>>,
    /// Turns of a swing over the record, at most.
    turns: usize,
}

impl Signals {
    /// `states` over the steps of the record.
    pub fn new(model: &Model<'_, '_>, states: Vec<Vec<f64>>) -> Self {
        let data = model.runner.data;
        let mut inputs: Vec<Vec<f64>> = (0..data.m).map(|j| data.input(j).collect()).collect();
        inputs.iter_mut().for_each(|u| scale(u));
        let turns = MOST_TURNS.min((FASTEST_HZ * data.duration_s()) as usize);
        Self { inputs, states, turns }
    }

    /// Of inputs and states: smooth, swinging, switched or in waves, and products.
    pub fn all(&self) -> Vec<Family> {
        let mut all: Vec<Family> = Vec::new();
        for signal in self.inputs.iter().chain(&self.states) {
            all.extend([smooth(signal), slowly(signal), switched(signal)]);
            all.extend((SWINGS + 1..=self.turns).map(|turns| swung(signal, turns)));
        }
        all.extend(self.states.iter().map(|x| waves(x)));
        all.extend(self.products());
        all
    }

    /// Of states alone, and their products with inputs.
    pub fn of_states(&self) -> Vec<Family> {
        let mut all: Vec<Family> = self.states.iter().flat_map(|x| [smooth(x), waves(x)]).collect();
        all.extend(self.states.iter().flat_map(|x| (1..=self.turns).map(|turns| swung(x, turns))));
        all.extend(self.products());
        all
    }

    /// Of one input: all shapes, and each shape for itself beside the input's own gain.
    pub fn of_input(&self, j: usize) -> Vec<Family> {
        let u = &self.inputs[j];
        let mut all = vec![smooth(u)];
        let shapes = smooth(u).into_iter().skip(1).chain(switched(u));
        all.extend(shapes.map(|shape| vec![u.clone(), shape]));
        all.push(slowly(u));
        all
    }

    fn products(&self) -> impl Iterator<Item = Family> {
        self.states.iter().enumerate().flat_map(|(i, x)| {
            let others = self.states[i + 1..].iter().chain(&self.inputs);
            others.map(move |y| vec![x.iter().zip(y).map(|(x, y)| x * y).collect()])
        })
    }
}

fn map(v: &[f64], f: &dyn Fn(f64) -> f64) -> Vec<f64> {
    v.iter().map(|v| f(*v)).collect()
}

fn smooth(v: &[f64]) -> Family {
    let shapes: [&dyn Fn(f64) -> f64; 6] =
        [&|v| v, &f64::abs, &|v| v * v, &|v| v * v.abs(), &|v| v * v * v, &|v| (v / SMALL).tanh()];
    shapes.iter().map(|f| map(v, f)).collect()
}

fn switched(v: &[f64]) -> Family {
    THRESHOLDS.iter().map(|t| relayed(v, *t)).collect()
}

/// A signal that acts now more, now less, in so many turns over the record.
fn swung(v: &[f64], turns: usize) -> Family {
    let at = |phase: f64| {
        let angle = |k: usize| TAU * (turns * k) as f64 / v.len() as f64 + phase;
        v.iter().enumerate().map(|(k, v)| v * angle(k).sin()).collect()
    };
    vec![at(0.0), at(0.5 * PI)]
}

fn slowly(v: &[f64]) -> Family {
    (1..=SWINGS).flat_map(|turns| swung(v, turns)).collect()
}

fn waves(v: &[f64]) -> Family {
    (1..=WAVES).flat_map(|n| wave(v, n)).collect()
}

fn wave(v: &[f64], n: usize) -> Family {
    [0.0, 0.5 * PI].map(|phase| map(v, &|v| (PI * n as f64 * v + phase).sin())).to_vec()
}

/// Waves of several lengths, each for itself, that no straight line is like.
pub fn ripples(v: &[f64]) -> impl Iterator<Item = Family> {
    (2..=WAVES).map(|n| wave(v, n))
}
