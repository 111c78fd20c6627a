//! Detectability of an effect: the change of the record relative to the noise, without the part that the
//! initial state and the free parameters could imitate. The true noise model is used.

use rustfft::FftPlannerScalar;
use rustfft::num_complex::Complex;
use whirlstand_vehicle::{Matrix, Target, Vehicle};

use super::commands::Commands;
use super::linear::{Recursion, model};
use super::sense::Noise;

/// Whitens changes of a record and removes the part that a base model could imitate.
pub(crate) struct Detector {
    noise: Noise,
    period_s: f64,
    /// Orthonormal basis of the whitened responses to the initial state and the free parameters.
    base: Vec<Vec<f64>>,
}

impl Detector {
    /// Computes the basis; `x0` is the true initial state.
    pub fn new(vehicle: &Vehicle, noise: &Noise, x0: &[f64], commands: &Commands) -> Self {
        let mut detector = Self { noise: noise.clone(), period_s: commands.period_s, base: Vec::new() };
        for column in initial(vehicle, commands).into_iter().chain(free(vehicle, x0, commands)) {
            let mut column = detector.whitened(column);
            let before = norm(&column);
            detector.project(&mut column);
            detector.project(&mut column);
            let after = norm(&column);
            // The remainder of a linearly dependent column is rounding error.
            if after > 1e-8 * before && after > 0.0 {
                column.iter_mut().for_each(|x| *x /= after);
                detector.base.push(column);
            }
        }
        detector
    }

    /// A change of the record (samples x outputs), whitened to variance 1 and without the part that lies in
    /// the span of the base.
    pub fn signature(&self, change: Vec<f64>) -> Vec<f64> {
        let mut white = self.whitened(change);
        self.project(&mut white);
        white
    }

    /// Detectability of a change of the record that is a random process. The base is not projected out: the
    /// projection would mix channels, and no base response lasts as long as the process.
    pub fn random(&self, change: Vec<f64>) -> f64 {
        random_lambda(&self.whitened(change), self.noise.std.len())
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

/// Detectability of a signature: its squared norm.
pub(crate) fn lambda(signature: &[f64]) -> f64 {
    dot(signature, signature)
}

/// Detectability of a random signature of `outputs` channels (samples x outputs) whose time course is
/// unknown: twice the expected log-likelihood ratio between a model that knows its spectrum and the
/// correlation of its channels and a model that takes it for additional independent noise of each channel,
/// with the right spectrum. Noise of single channels is thereby removed, as the base parameters are removed
/// from a known signature; a signature in one channel alone has detectability 0. With the signal-to-noise
/// ratios r of the channels, it is twice the sum, over all frequencies, of (sum of ln(1 + r) over the
/// channels) - ln(1 + sum of r).
fn random_lambda(signature: &[f64], outputs: usize) -> f64 {
    let samples = signature.len() / outputs.max(1);
    if samples < 16 {
        return 0.0;
    }
    let fft = FftPlannerScalar::new().plan_fft_forward(samples);
    let (mut single, mut joint) = (0.0, vec![0.0; samples / 2]);
    for channel in 0..outputs {
        let column = signature.iter().skip(channel).step_by(outputs);
        let mut buffer: Vec<Complex<f64>> = column.map(|w| Complex::new(*w, 0.0)).collect();
        fft.process(&mut buffer);
        let power: Vec<f64> = buffer[..samples / 2].iter().map(|b| b.norm_sqr() / samples as f64).collect();
        // The periodogram is averaged over neighbouring frequencies to estimate the spectrum.
        for (k, joint) in joint.iter_mut().enumerate() {
            let reach = 4.max(k / 8);
            let around = &power[k.saturating_sub(reach)..(k + reach + 1).min(power.len())];
            let ratio = around.iter().sum::<f64>() / around.len() as f64;
            single += ratio.ln_1p();
            *joint += ratio;
        }
    }
    2.0 * (single - joint.iter().map(|r| r.ln_1p()).sum::<f64>())
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

/// Response of the record to a unit value of each initial state.
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

/// Sensitivity of the record to each free matrix entry (forward difference); free parameters of effects are
/// left out.
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
    fn a_random_signature_tells_what_channels_have_in_common() {
        let mut stream = crate::random::RandomStream::new(5, "signature");
        let white: Vec<f64> = (0..8000).map(|_| stream.normal()).collect();
        for size in [3.0f64, 1.0, 0.3] {
            let signature: Vec<f64> = white.iter().map(|w| size * w).collect();
            let r = size * size;
            // A channel has half as many frequencies as samples.
            let expected = 2.0 * 2000.0 * (2.0 * r.ln_1p() - (2.0 * r).ln_1p());
            let two = random_lambda(&signature, 2);
            assert!((two / expected - 1.0).abs() < 0.1, "{size}: {two} {expected}");
            // A signature in only one channel is indistinguishable from noise of that channel.
            let one: Vec<f64> = white.iter().flat_map(|w| [size * w, 0.0]).collect();
            assert!(random_lambda(&one, 2).abs() < 1e-6 * lambda(&one));
        }
    }
}
