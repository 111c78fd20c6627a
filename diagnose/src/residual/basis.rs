//! Basis functions of inputs and states that a force might follow, where no effect of the table fits.

use crate::thresholds::{
    FASTEST_MODULATION_HZ, HALF_WAVES, MAX_MODULATION_TURNS, RELAY_THRESHOLDS, SLOW_TURNS, SWITCH_SHARE,
};
use std::f64::consts::{PI, TAU};

use crate::model::fit::Model;

/// Candidate functions of the same signal, tested together as one force.
#[derive(Debug, Clone)]
pub struct Basis {
    /// Description of a force that follows these functions: "follows pitch", "swings with roll at 0.30 Hz".
    pub description: String,
    /// Functions over the steps of the record, one value per step.
    pub functions: Vec<Vec<f64>>,
}

/// Creates a basis on demand: all bases of a long record together would fill the memory.
pub type Recipe<'s> = Box<dyn Fn() -> Basis + Send + Sync + 's>;

fn recipe<'s>(make: impl Fn() -> Basis + Send + Sync + 's) -> Recipe<'s> {
    Box::new(make)
}

impl Basis {
    fn new(description: String, functions: Vec<Vec<f64>>) -> Self {
        Self { description, functions }
    }
}

/// An input or a state divided by its largest magnitude, one value per step.
#[derive(Debug, Clone)]
pub struct Signal {
    /// Name of the signal.
    pub name: String,
    /// Normalised values.
    pub values: Vec<f64>,
}

/// Signals that a force may follow.
pub struct Signals {
    /// Inputs over the steps of the record.
    pub inputs: Vec<Signal>,
    /// States over the steps of the record.
    pub states: Vec<Signal>,
    /// Largest number of cycles of a modulation over the record.
    turns: usize,
    /// Sine and cosine of one turn over the record.
    turn: Vec<(f64, f64)>,
    duration_s: f64,
}

impl Signals {
    /// Normalised inputs and states; `states` are given over the steps of the record.
    pub fn new(model: &Model<'_, '_>, states: Vec<Vec<f64>>) -> Self {
        let (data, vehicle) = (model.free_run.data, &model.free_run.vehicle);
        let signal = |(mut values, name): (Vec<f64>, &String)| {
            scale(&mut values);
            Signal { name: name.clone(), values }
        };
        let inputs = (0..data.m).map(|j| data.input(j).collect());
        let inputs = inputs.zip(vehicle.inputs.iter().map(|i| &i.name)).map(signal).collect();
        let states = states.into_iter().zip(vehicle.states.iter().map(|s| &s.name)).map(signal).collect();
        let duration_s = data.duration_s();
        let turns = MAX_MODULATION_TURNS.min((FASTEST_MODULATION_HZ * duration_s) as usize);
        Self { inputs, states, turns, turn: turn(data.steps), duration_s }
    }

    /// Bases of inputs and states: smooth, modulated, switched or sinusoidal functions, and products.
    pub fn all(&self) -> Vec<Recipe<'_>> {
        let mut all: Vec<Recipe<'_>> = Vec::new();
        for x in self.inputs.iter().chain(&self.states) {
            all.extend([recipe(|| smooth(x)), recipe(|| slowly(x)), recipe(|| switched(x))]);
            all.push(recipe(|| drifting(x)));
            all.extend((1..=self.turns).map(|turns| recipe(move || self.swung(x, turns))));
        }
        all.extend(self.states.iter().map(|x| recipe(|| waves(x))));
        all.extend(self.products());
        all
    }

    /// Bases of states alone, and their products with inputs.
    pub fn of_states(&self) -> Vec<Recipe<'_>> {
        let mut all: Vec<Recipe<'_>> = Vec::new();
        for x in &self.states {
            all.extend([recipe(|| smooth(x)), recipe(|| waves(x)), recipe(|| drifting(x))]);
        }
        let swung = |x| (1..=self.turns).map(move |turns| recipe(move || self.swung(x, turns)));
        all.extend(self.states.iter().flat_map(swung));
        all.extend(self.products());
        all
    }

    /// Sinusoids of several wavelengths over the range of each state, one basis each, without the part that a
    /// straight line explains.
    pub fn ripples(&self) -> Vec<Basis> {
        let of = |x: &Signal| {
            let description = wavy(x);
            (2..=HALF_WAVES).map(|n| Basis::new(description.clone(), wave(&x.values, n))).collect::<Vec<_>>()
        };
        self.states.iter().flat_map(of).collect()
    }

    /// Products of two signals: with the squares among the smooth functions, all terms of second order.
    fn products(&self) -> impl Iterator<Item = Recipe<'_>> {
        let all = || self.states.iter().chain(&self.inputs);
        let of = |x: &Signal, y: &Signal| {
            Basis::new(format!("follows {} times {}", x.name, y.name), vec![product(x, y)])
        };
        let pairs = all().enumerate().flat_map(move |(i, x)| all().skip(i + 1).map(move |y| (x, y)));
        pairs.map(move |(x, y)| recipe(move || of(x, y)))
    }

    /// A signal whose gain oscillates with `turns` cycles over the record.
    fn swung(&self, x: &Signal, turns: usize) -> Basis {
        let hz = turns as f64 / self.duration_s;
        let functions = swing(&x.values, turns, &self.turn).into();
        Basis::new(format!("follows {} modulated at {hz:.2} Hz", x.name), functions)
    }
}

/// Bases of a static curve, a hysteresis or a varying gain of a signal: all shapes together, and each shape alone
/// beside the signal's own gain.
pub fn curves(u: &Signal) -> Vec<Recipe<'_>> {
    let beside = |make: fn(&Signal) -> Basis, shape: usize| {
        recipe(move || {
            let Basis { description, mut functions } = make(u);
            Basis::new(description, vec![u.values.clone(), functions.swap_remove(shape)])
        })
    };
    let mut all = vec![recipe(|| smooth(u))];
    // The first shape is the signal itself.
    all.extend((1..SHAPES.len()).map(|shape| beside(smooth, shape)));
    all.extend((0..RELAY_THRESHOLDS.len()).map(|shape| beside(switched, shape)));
    all.extend([recipe(|| slowly(u)), recipe(|| drifting(u))]);
    all
}

fn map(v: &[f64], f: &dyn Fn(f64) -> f64) -> Vec<f64> {
    v.iter().map(|v| f(*v)).collect()
}

/// Static functions of a signal: the signal, its powers, its positive and negative parts, and a switch.
pub const SHAPES: [fn(f64) -> f64; 6] =
    [|v| v, f64::abs, |v| v * v, |v| v * v.abs(), |v| v * v * v, |v| (v / SWITCH_SHARE).tanh()];

/// Powers, positive and negative parts and a switch of a signal: components of a static curve.
pub fn smooth(x: &Signal) -> Basis {
    Basis::new(format!("follows {}", x.name), SHAPES.iter().map(|f| map(&x.values, f)).collect())
}

/// A signal behind hysteresis relays of several widths.
pub fn switched(x: &Signal) -> Basis {
    let sides = RELAY_THRESHOLDS.iter().map(|t| relay(&x.values, *t, 0.0)).collect();
    Basis::new(format!("switches with {}", x.name), sides)
}

/// Sine and cosine of every step of a record, of which the whole is one turn.
fn turn(steps: usize) -> Vec<(f64, f64)> {
    (0..steps).map(|k| (TAU * k as f64 / steps as f64).sin_cos()).collect()
}

/// A signal times the sine, and times the cosine, of this many turns over the record.
fn swing(v: &[f64], turns: usize, turn: &[(f64, f64)]) -> [Vec<f64>; 2] {
    let at = |k: usize| turn[turns * k % turn.len()];
    let swung = |of: fn((f64, f64)) -> f64| v.iter().enumerate().map(|(k, v)| v * of(at(k))).collect();
    [swung(|(sine, _)| sine), swung(|(_, cosine)| cosine)]
}

/// A signal whose gain drifts steadily.
pub fn drifting(x: &Signal) -> Basis {
    let steps = x.values.len() as f64;
    let drift = x.values.iter().enumerate().map(|(k, v)| v * (2.0 * k as f64 / steps - 1.0)).collect();
    Basis::new(format!("follows {} with a gain that drifts", x.name), vec![x.values.clone(), drift])
}

/// A signal whose gain varies slowly, over few cycles in the record.
pub fn slowly(x: &Signal) -> Basis {
    let turn = turn(x.values.len());
    let swings = (1..=SLOW_TURNS).flat_map(|turns| swing(&x.values, turns, &turn)).collect();
    Basis::new(format!("follows {} with a slowly varying gain", x.name), swings)
}

fn wavy(x: &Signal) -> String {
    format!("is a periodic function of {}", x.name)
}

fn waves(x: &Signal) -> Basis {
    Basis::new(wavy(x), (1..=HALF_WAVES).flat_map(|n| wave(&x.values, n)).collect())
}

fn wave(v: &[f64], n: usize) -> Vec<Vec<f64>> {
    [0.0, 0.5 * PI].map(|phase| map(v, &|v| (PI * n as f64 * v + phase).sin())).to_vec()
}

/// Product of two signals.
pub fn product(x: &Signal, y: &Signal) -> Vec<f64> {
    x.values.iter().zip(&y.values).map(|(x, y)| x * y).collect()
}

/// Output of a hysteresis relay: +1 from where a signal rises above a threshold until it falls below minus
/// that, then -1; delayed by `late` steps and averaged over each step.
pub fn relay(signal: &[f64], threshold: f64, late: f64) -> Vec<f64> {
    // Times at which the signal crosses a threshold, between samples, and the new side.
    let mut turns: Vec<(f64, f64)> = Vec::new();
    let mut now = 0.0;
    for (k, x) in signal.iter().enumerate() {
        let side = x.signum();
        if x.abs() > threshold && side != now {
            let last = if k > 0 { signal[k - 1] } else { *x };
            let share =
                if x == &last { 0.0 } else { ((side * threshold - last) / (x - last)).clamp(0.0, 1.0) };
            turns.push((k.saturating_sub(1) as f64 + share + late, side));
            now = side;
        }
    }
    let mut values = vec![0.0; signal.len()];
    for (i, (from, side)) in turns.iter().enumerate() {
        let until = turns.get(i + 1).map_or(signal.len() as f64, |t| t.0);
        let (first, last) = (*from as usize, (until.ceil() as usize).min(signal.len()));
        for (k, value) in values.iter_mut().enumerate().take(last).skip(first) {
            let (begin, end) = (from.max(k as f64), until.min(k as f64 + 1.0));
            *value += side * (end - begin).max(0.0);
        }
    }
    values
}

/// Divides values by the largest magnitude.
pub(crate) fn scale(values: &mut [f64]) {
    let peak = values.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    if peak > 0.0 {
        values.iter_mut().for_each(|v| *v /= peak);
    }
}

#[cfg(test)]
mod tests {
    use super::{Signal, Signals, relay};

    #[test]
    fn products_are_those_of_any_two_signals() {
        let signal = |name: &str, values: [f64; 2]| Signal { name: name.into(), values: values.to_vec() };
        let signals = Signals {
            inputs: vec![signal("u", [1.0, 2.0]), signal("v", [3.0, 5.0])],
            states: vec![signal("x", [7.0, 11.0])],
            turns: 0,
            turn: Vec::new(),
            duration_s: 1.0,
        };
        let products = signals.products().map(|make| make());
        let products: Vec<_> = products.map(|basis| (basis.description, basis.functions)).collect();
        let product = |of: &str, values: [f64; 2]| (format!("follows {of}"), vec![values.to_vec()]);
        let all = [
            product("x times u", [7.0, 22.0]),
            product("x times v", [21.0, 55.0]),
            product("u times v", [3.0, 10.0]),
        ];
        assert_eq!(products, all);
    }

    #[test]
    fn a_switch_turns_between_samples_and_comes_late() {
        let signal: Vec<f64> = (0..9).map(|k| 1.0 - 0.5 * f64::from(k)).collect();
        // Above 0.25 immediately; below -0.25 at 2.5 steps.
        let at_once = relay(&signal, 0.25, 0.0);
        assert_eq!(at_once[..5], [1.0, 1.0, 0.0, -1.0, -1.0]);
        let late = relay(&signal, 0.25, 1.75);
        assert_eq!(late[..7], [0.0, 0.25, 1.0, 1.0, -0.5, -1.0, -1.0]);
        // Inside the thresholds nothing changes.
        let still = relay(&[0.5, 0.1, -0.1, 0.1, -0.1], 0.2, 0.0);
        assert_eq!(still, [1.0; 5]);
    }
}
