//! Estimates frequency responses from records, with coherence.
//!
//! With several inputs at once each response is conditioned on the others: H(f) = S_uu(f)^-1 S_uy(f), and its
//! coherence is the partial one, the share of the output's power that this input explains and no other does
//! (Tischler and Remple, Aircraft and Rotorcraft System Identification, AIAA 2012, chapter 9). Spectra are Welch's
//! with Hann's window and half overlap.

use std::f64::consts::TAU;

use nalgebra::{Complex, DMatrix, DVector};
use whirlstand_linalg::fft;

type C64 = Complex<f64>;

/// The response of one output to all inputs.
#[derive(Debug, Clone, PartialEq)]
pub struct Response {
    /// Frequencies, Hz, ascending, without zero.
    pub frequency_hz: Vec<f64>,
    /// Response to every input at each frequency.
    pub gain: Vec<Vec<C64>>,
    /// Partial coherence of every input at each frequency, 0 to 1.
    pub coherence: Vec<Vec<f64>>,
}

/// Estimates the response over parts of records with one period in seconds. `inputs[part][input]` and
/// `output[part]` are equally long and free of NaN. `None` when no part is long enough for four windows.
pub fn response(inputs: &[Vec<Vec<f64>>], output: &[Vec<f64>], period_s: f64) -> Option<Response> {
    let m = inputs.first()?.len();
    let total: usize = output.iter().map(Vec::len).sum();
    let longest = output.iter().map(Vec::len).max()?;
    // Ten windows' worth of averaging, or as many as the record allows.
    let window = (total / 6).clamp(32, 8192).min(longest / 2);
    if window < 16 || m == 0 {
        return None;
    }
    let spectra = Spectra::accumulate(inputs, output, m, window);
    if spectra.windows < m + 2 {
        return None;
    }
    let mut result =
        Response { frequency_hz: Vec::new(), gain: vec![Vec::new(); m], coherence: vec![Vec::new(); m] };
    for f in 1..spectra.yy.len() {
        result.frequency_hz.push(f as f64 / (window as f64 * period_s));
        for (a, (gain, coherence)) in spectra.solve(f).into_iter().enumerate() {
            result.gain[a].push(gain);
            result.coherence[a].push(coherence);
        }
    }
    Some(result)
}

/// Auto- and cross-spectra of the inputs u and the output y at every frequency bin, summed over all windows.
struct Spectra {
    /// S_uu of each bin, inputs x inputs.
    uu: Vec<DMatrix<C64>>,
    /// S_uy of each bin, one entry per input.
    uy: Vec<DVector<C64>>,
    /// S_yy of each bin.
    yy: Vec<f64>,
    /// Number of windows summed.
    windows: usize,
}

impl Spectra {
    /// Sums the periodograms of all half-overlapping windows of `window` samples; `m` is the number of inputs.
    fn accumulate(inputs: &[Vec<Vec<f64>>], output: &[Vec<f64>], m: usize, window: usize) -> Self {
        let fft = fft::forward(window);
        let hann: Vec<f64> =
            (0..window).map(|k| 0.5 - 0.5 * (TAU * (k as f64 + 0.5) / window as f64).cos()).collect();
        let transform = |part: &[f64]| -> Vec<C64> {
            let mean = whirlstand_logs::stats::mean(part);
            let mut buffer: Vec<C64> =
                part.iter().zip(&hann).map(|(v, w)| C64::new((v - mean) * w, 0.0)).collect();
            fft.process(&mut buffer);
            buffer
        };
        let bins = window / 2;
        let mut sums = Self {
            uu: vec![DMatrix::zeros(m, m); bins],
            uy: vec![DVector::zeros(m); bins],
            yy: vec![0.0; bins],
            windows: 0,
        };
        for (inputs, output) in inputs.iter().zip(output) {
            for start in (0..=output.len().saturating_sub(window)).step_by((window / 2).max(1)) {
                if start + window > output.len() {
                    break;
                }
                let y = transform(&output[start..start + window]);
                let u: Vec<Vec<C64>> = inputs.iter().map(|u| transform(&u[start..start + window])).collect();
                sums.add(&u, &y);
            }
        }
        sums
    }

    /// Adds the periodograms of one window from the transforms of its inputs and its output.
    fn add(&mut self, u: &[Vec<C64>], y: &[C64]) {
        self.windows += 1;
        for f in 1..self.yy.len() {
            self.yy[f] += y[f].norm_sqr();
            for (a, of_a) in u.iter().enumerate() {
                self.uy[f][a] += of_a[f].conj() * y[f];
                for (b, of_b) in u.iter().enumerate() {
                    self.uu[f][(a, b)] += of_a[f].conj() * of_b[f];
                }
            }
        }
    }

    /// Response and partial coherence of every input at bin `f`; NaN and 0 where S_uu is singular.
    fn solve(&self, f: usize) -> Vec<(C64, f64)> {
        let inverse = self.uu[f].clone().try_inverse().filter(|i| i.iter().all(|v| v.re.is_finite()));
        let h = inverse.as_ref().map(|inverse| inverse * &self.uy[f]);
        // Output power that all inputs together leave unexplained.
        let explained =
            h.as_ref().map_or(0.0, |h| h.iter().zip(self.uy[f].iter()).map(|(h, s)| (h.conj() * s).re).sum());
        let left = (self.yy[f] - explained).max(0.0);
        let one = |a: usize| match (&h, &inverse) {
            (Some(h), Some(inverse)) => {
                // |h_a|^2 / (S_uu^-1)_aa is the power that only input a explains.
                let own = h[a].norm_sqr() / inverse[(a, a)].re.max(1e-300);
                (h[a], if own + left > 0.0 { own / (own + left) } else { 0.0 })
            }
            _ => (C64::new(f64::NAN, f64::NAN), 0.0),
        };
        (0..self.uy[f].len()).map(one).collect()
    }
}

/// Partial coherence from which a response can be trusted (Tischler and Remple, section 7.6).
pub const TRUSTED: f64 = 0.6;
/// Fewest trusted frequencies of a response.
const FEWEST: usize = 3;

impl Response {
    /// Index range from the first to the last trusted frequency; `None` when almost none is.
    pub fn trusted(&self, input: usize) -> Option<std::ops::RangeInclusive<usize>> {
        let good: Vec<usize> =
            (0..self.frequency_hz.len()).filter(|k| self.coherence[input][*k] >= TRUSTED).collect();
        // A single peak far beyond the others is due to chance.
        let last =
            good.windows(2).find(|w| w[1] - w[0] > 2 * w[0].max(3)).map_or(good.last(), |w| Some(&w[0]));
        let (first, last) = (*good.first()?, *last?);
        (good.iter().filter(|k| **k <= last).count() >= FEWEST).then_some(first..=last)
    }

    /// Gain in dB and phase in degrees (unwrapped) of the response to an input; NaN where `keep` is false.
    pub fn bode(&self, input: usize, keep: impl Fn(usize) -> bool) -> (Vec<f64>, Vec<f64>) {
        let count = self.frequency_hz.len();
        let (mut gain, mut phase) = (vec![f64::NAN; count], vec![f64::NAN; count]);
        let mut before: Option<f64> = None;
        for (k, h) in self.gain[input].iter().enumerate().filter(|(k, _)| keep(*k)) {
            gain[k] = 20.0 * h.norm().log10();
            let wrapped = h.arg().to_degrees();
            // The phase of a lag falls from zero: the first one lies between a lead of 90 deg and a lag of
            // 270 deg.
            let near = before.unwrap_or(-90.0);
            phase[k] = wrapped - 360.0 * ((wrapped - near) / 360.0).round();
            if phase[k].is_finite() {
                before = Some(phase[k]);
            }
        }
        (gain, phase)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_vehicle::Stream;

    #[test]
    fn two_correlated_inputs_are_told_apart() {
        let mut stream = Stream::new(1, "response");
        let n = 20_000;
        let u1: Vec<f64> = (0..n).map(|_| stream.normal()).collect();
        let u2: Vec<f64> = u1.iter().map(|u| 0.7 * u + 0.5 * stream.normal()).collect();
        // y = lag(u1) - 2 u2 + noise.
        let mut x = 0.0;
        let y: Vec<f64> = (0..n)
            .map(|k| {
                let out = x - 2.0 * u2[k] + 0.01 * stream.normal();
                x = 0.9 * x + 0.1 * u1[k];
                out
            })
            .collect();
        let r = response(&[vec![u1, u2]], &[y], 0.01).unwrap();
        let at = r.frequency_hz.iter().position(|f| *f > 1.0).unwrap();
        let z = C64::from_polar(1.0, TAU * r.frequency_hz[at] * 0.01);
        let exact = C64::new(0.1, 0.0) / (z - 0.9);
        assert!((r.gain[0][at] - exact).norm() < 0.05 * exact.norm(), "{} {exact}", r.gain[0][at]);
        assert!((r.gain[1][at] + 2.0).norm() < 0.02);
        assert!(r.coherence[0][at] > 0.98 && r.coherence[1][at] > 0.999);
        let high = r.frequency_hz.len() - 2;
        assert!(r.coherence[0][high] < r.coherence[0][at]);
        assert!(r.trusted(1).is_some_and(|range| range.contains(&at)));
        let (gain, phase) = r.bode(1, |k| k == at);
        assert!((gain[at] - 20.0 * 2f64.log10()).abs() < 0.1 && gain[high].is_nan());
        assert!((phase[at] + 180.0).abs() < 1.0, "a turned sign is half a turn: {}", phase[at]);
    }
}
