//! How visible an effect is: its change of the record against the noise, beyond what the initial state and the free
//! parameters could imitate. The noise model is the true one.

use rustfft::FftPlanner;
use rustfft::num_complex::Complex;
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

/// Detectability of a random signature of `outputs` channels (samples x outputs), whose course nobody knows beforehand:
/// twice the log-likelihood that is to be gained by who knows its spectrum, the sum of r - ln(1 + r) over all frequencies with
/// the ratio r of signal to noise. For r far above 1 it is that of a known signature.
pub(crate) fn random_lambda(signature: &[f64], outputs: usize) -> f64 {
    let samples = signature.len() / outputs.max(1);
    if samples < 16 {
        return 0.0;
    }
    let fft = FftPlanner::new().plan_fft_forward(samples);
    let mut ratio = vec![0.0; samples / 2];
    for channel in 0..outputs {
        let column = signature.iter().skip(channel).step_by(outputs);
        let mut buffer: Vec<Complex<f64>> = column.map(|w| Complex::new(*w, 0.0)).collect();
        fft.process(&mut buffer);
        ratio.iter_mut().zip(&buffer).for_each(|(r, b)| *r += b.norm_sqr() / samples as f64);
    }
    // Averaged over neighbours: one record's lines are not its spectrum.
    let mean = |k: usize| {
        let reach = 4.max(k / 8);
        let around = &ratio[k.saturating_sub(reach)..(k + reach + 1).min(ratio.len())];
        around.iter().sum::<f64>() / around.len() as f64
    };
    (0..ratio.len()).map(|k| 2.0 * (mean(k) - mean(k).ln_1p())).sum()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_random_signature_far_above_the_noise_tells_what_a_known_one_does_and_a_faint_one_less() {
        let mut dice = super::super::random::Dice::new(5, "signature");
        let white: Vec<f64> = (0..8000).map(|_| dice.normal()).collect();
        let of = |size: f64| {
            let signature: Vec<f64> = white.iter().map(|w| size * w).collect();
            random_lambda(&signature, 2) / lambda(&signature)
        };
        // Two channels: r = 2 size^2 at every frequency, and 1 - ln(1 + r) / r of what a known one would tell.
        for size in [30.0f64, 1.0, 0.1] {
            let r = 2.0 * size * size;
            let expected = 1.0 - r.ln_1p() / r;
            assert!((of(size) / expected - 1.0).abs() < 0.1, "{size}: {} {expected}", of(size));
        }
    }
}
