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

/// Functions of the same signal.
#[derive(Debug, Clone)]
pub struct Family {
    /// What a force that is one of them does: "follows pitch", "swings with roll at 0.30 Hz".
    pub words: String,
    /// One value a step each.
    pub functions: Vec<Vec<f64>>,
}

impl Family {
    fn new(words: String, functions: Vec<Vec<f64>>) -> Self {
        Self { words, functions }
    }
}

/// An input or a state over its largest magnitude, a value a step.
#[derive(Debug, Clone)]
pub struct Signal {
    /// Its name.
    pub name: String,
    /// Its values.
    pub values: Vec<f64>,
}

/// What a force may follow.
pub struct Signals {
    inputs: Vec<Signal>,
    /// States over the steps of the record.
    pub states: Vec<Signal>,
    /// Turns of a swing over the record, at most.
    turns: usize,
    duration_s: f64,
}

impl Signals {
    /// `states` over the steps of the record.
    pub fn new(model: &Model<'_, '_>, states: Vec<Vec<f64>>) -> Self {
        let (data, vehicle) = (model.runner.data, &model.runner.vehicle);
        let signal = |(mut values, name): (Vec<f64>, &String)| {
            scale(&mut values);
            Signal { name: name.clone(), values }
        };
        let inputs = (0..data.m).map(|j| data.input(j).collect());
        let inputs = inputs.zip(vehicle.inputs.iter().map(|i| &i.name)).map(signal).collect();
        let states = states.into_iter().zip(vehicle.states.iter().map(|s| &s.name)).map(signal).collect();
        let duration_s = data.duration_s();
        let turns = MOST_TURNS.min((FASTEST_HZ * duration_s) as usize);
        Self { inputs, states, turns, duration_s }
    }

    /// Of inputs and states: smooth, swinging, switched or in waves, and products.
    pub fn all(&self) -> Vec<Family> {
        let mut all: Vec<Family> = Vec::new();
        for signal in self.inputs.iter().chain(&self.states) {
            all.extend([smooth(signal), slowly(signal), switched(signal)]);
            all.extend((SWINGS + 1..=self.turns).map(|turns| self.swung(signal, turns)));
        }
        all.extend(self.states.iter().map(waves));
        all.extend(self.products());
        all
    }

    /// Of states alone, and their products with inputs.
    pub fn of_states(&self) -> Vec<Family> {
        let mut all: Vec<Family> = self.states.iter().flat_map(|x| [smooth(x), waves(x)]).collect();
        let turns = || 1..=self.turns;
        all.extend(self.states.iter().flat_map(|x| turns().map(|turns| self.swung(x, turns))));
        all.extend(self.products());
        all
    }

    /// Of one input: all shapes, and each shape for itself beside the input's own gain.
    pub fn of_input(&self, j: usize) -> Vec<Family> {
        let u = &self.inputs[j];
        let mut all = vec![smooth(u)];
        let beside = |family: Family| {
            let words = family.words;
            let shapes = family.functions.into_iter();
            shapes.map(move |shape| Family::new(words.clone(), vec![u.values.clone(), shape]))
        };
        let mut bent = smooth(u);
        bent.functions.remove(0);
        all.extend(beside(bent).chain(beside(switched(u))));
        all.push(slowly(u));
        all
    }

    /// Waves of several lengths over each state, each for itself, that no straight line is like.
    pub fn ripples(&self) -> Vec<Family> {
        let of = |x: &Signal| {
            let words = wavy(x);
            (2..=WAVES).map(|n| Family::new(words.clone(), wave(&x.values, n))).collect::<Vec<_>>()
        };
        self.states.iter().flat_map(of).collect()
    }

    fn products(&self) -> impl Iterator<Item = Family> {
        self.states.iter().enumerate().flat_map(|(i, x)| {
            let others = self.states[i + 1..].iter().chain(&self.inputs);
            others.map(move |y| {
                let product = x.values.iter().zip(&y.values).map(|(x, y)| x * y).collect();
                Family::new(format!("follows {} times {}", x.name, y.name), vec![product])
            })
        })
    }

    /// A signal that acts now more, now less, in so many turns over the record.
    fn swung(&self, x: &Signal, turns: usize) -> Family {
        let hz = turns as f64 / self.duration_s;
        Family::new(format!("follows {} swinging at {hz:.2} Hz", x.name), swing(&x.values, turns))
    }
}

fn map(v: &[f64], f: &dyn Fn(f64) -> f64) -> Vec<f64> {
    v.iter().map(|v| f(*v)).collect()
}

fn smooth(x: &Signal) -> Family {
    let shapes: [&dyn Fn(f64) -> f64; 6] =
        [&|v| v, &f64::abs, &|v| v * v, &|v| v * v.abs(), &|v| v * v * v, &|v| (v / SMALL).tanh()];
    Family::new(format!("follows {}", x.name), shapes.iter().map(|f| map(&x.values, f)).collect())
}

fn switched(x: &Signal) -> Family {
    let sides = THRESHOLDS.iter().map(|t| relayed(&x.values, *t)).collect();
    Family::new(format!("switches with {}", x.name), sides)
}

fn swing(v: &[f64], turns: usize) -> Vec<Vec<f64>> {
    let at = |phase: f64| {
        let angle = |k: usize| TAU * (turns * k) as f64 / v.len() as f64 + phase;
        v.iter().enumerate().map(|(k, v)| v * angle(k).sin()).collect()
    };
    vec![at(0.0), at(0.5 * PI)]
}

fn slowly(x: &Signal) -> Family {
    let swings = (1..=SWINGS).flat_map(|turns| swing(&x.values, turns)).collect();
    Family::new(format!("follows {} now more, now less", x.name), swings)
}

fn wavy(x: &Signal) -> String {
    format!("goes in waves with {}", x.name)
}

fn waves(x: &Signal) -> Family {
    Family::new(wavy(x), (1..=WAVES).flat_map(|n| wave(&x.values, n)).collect())
}

fn wave(v: &[f64], n: usize) -> Vec<Vec<f64>> {
    [0.0, 0.5 * PI].map(|phase| map(v, &|v| (PI * n as f64 * v + phase).sin())).to_vec()
}
