//! How visible an effect is: its change of the record against the noise, beyond what the initial state and the free
//! parameters could imitate. The noise model is the true one.

use whirlstand_vehicle::{Matrix, Target, Vehicle};

use super::linear::{Recursion, model};
use super::plant::Commands;
use super::sense::Noise;

/// Whitens changes of a record and takes out what a base model could imitate.
pub(crate) struct Judge {
    noise: Noise,
    period_s: f64,
    /// Orthonormal: what the initial state and the free parameters can do, whitened.
    base: Vec<Vec<f64>>,
}

impl Judge {
    /// `x0`: the true initial state.
    pub fn new(vehicle: &Vehicle, noise: &Noise, x0: &[f64], commands: &Commands) -> Self {
        let mut judge = Self { noise: noise.clone(), period_s: commands.period_s, base: Vec::new() };
        for column in initial(vehicle, commands).into_iter().chain(free(vehicle, x0, commands)) {
            let mut column = judge.whitened(column);
            let before = norm(&column);
            judge.project(&mut column);
            judge.project(&mut column);
            let after = norm(&column);
            // What is left of a dependent column is rounding.
            if after > 1e-8 * before && after > 0.0 {
                column.iter_mut().for_each(|x| *x /= after);
                judge.base.push(column);
            }
        }
        judge
    }

    /// A change of the record (samples x outputs), whitened to variance 1 and without what the base can do.
    pub fn signature(&self, change: Vec<f64>) -> Vec<f64> {
        let mut white = self.whitened(change);
        self.project(&mut white);
        white
    }

    fn whitened(&self, mut change: Vec<f64>) -> Vec<f64> {
        let p = self.noise.std.len();
        for (i, std) in self.noise.std.iter().enumerate() {
            self.noise.colour.whiten(&mut change, i, p, *std, self.period_s);
        }
        change
    }

    fn project(&self, x: &mut [f64]) {
        for b in &self.base {
            let share = dot(b, x);
            x.iter_mut().zip(b).for_each(|(x, b)| *x -= share * b);
        }
    }
}

/// Detectability of a signature.
pub(crate) fn lambda(signature: &[f64]) -> f64 {
    dot(signature, signature)
}

/// Confusability of two signatures: the cosine of the angle between them.
pub(crate) fn kappa(a: &[f64], b: &[f64]) -> f64 {
    let norms = norm(a) * norm(b);
    if norms > 0.0 { dot(a, b).abs() / norms } else { 0.0 }
}

pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

pub(crate) fn norm(a: &[f64]) -> f64 {
    dot(a, a).sqrt()
}

/// What a unit of each initial state adds to the record.
fn initial(vehicle: &Vehicle, commands: &Commands) -> Vec<Vec<f64>> {
    let n = vehicle.states.len();
    let none = Commands {
        period_s: commands.period_s,
        inputs: vec![vec![0.0; commands.samples()]; commands.inputs.len()],
    };
    let recursion = Recursion::new(&vehicle.a, &vehicle.b, commands.period_s);
    let unit = |i: usize| -> Vec<f64> { (0..n).map(|j| if i == j { 1.0 } else { 0.0 }).collect() };
    (0..n).map(|i| recursion.outputs(&vehicle.c, &vehicle.d, &unit(i), &none)).collect()
}

/// What a small change of each free entry adds to the record. Free parameters of effects are not among them.
fn free(vehicle: &Vehicle, x0: &[f64], commands: &Commands) -> Vec<Vec<f64>> {
    if vehicle.free.is_empty() {
        return Vec::new();
    }
    let nominal = model(vehicle, x0, commands);
    let mut columns = Vec::new();
    for free in &vehicle.free {
        let Target::Entry(matrix, row, column) = free.target else { continue };
        let mut changed = vehicle.clone();
        let entry = match matrix {
            Matrix::A => &mut changed.a[(row, column)],
            Matrix::B => &mut changed.b[(row, column)],
            Matrix::C => &mut changed.c[(row, column)],
            Matrix::D => &mut changed.d[(row, column)],
        };
        let nudge = 1e-5 * entry.abs().max(1e-2);
        *entry += nudge;
        let moved = model(&changed, x0, commands);
        columns.push(moved.iter().zip(&nominal).map(|(y, y0)| (y - y0) / nudge).collect());
    }
    columns
}
