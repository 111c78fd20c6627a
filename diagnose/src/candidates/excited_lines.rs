//! Lines of the excitation: at the frequency of a sine in an input, what a model gets wrong looks like a tone.

use crate::data::record::Data;
use crate::thresholds::{INPUT_LINE_RATIO, WRONG_RESPONSE_SHARE};
use whirlstand_linalg::C64;
use whirlstand_logs::stats::median;

/// Distances at which the surroundings of a line are taken, in frequency bins of the record: beyond the reach of the window.
const SURROUNDINGS: std::ops::RangeInclusive<usize> = 4..=8;

/// The part of a channel that a model explains, and what it leaves.
pub struct Explained<'d> {
    data: &'d Data,
    modelled: Vec<f64>,
    left: &'d [f64],
    step_s: f64,
}

impl<'d> Explained<'d> {
    /// For the measured values of a channel and the residual that a model leaves of them, `step_s` apart.
    pub fn new(data: &'d Data, measured: &[f64], left: &'d [f64], step_s: f64) -> Self {
        let modelled = measured.iter().zip(left).map(|(y, e)| y - e).collect();
        Self { data, modelled, left, step_s }
    }

    /// True when a tone of the residual at `f`, Hz, is a wrong response to the excitation: an input has a line there, to which the
    /// model responds far more than it leaves. Amplitude and phase of such a response, and a tone, are the same two columns: no
    /// record tells them apart, and a model is wrong more often than a disturbance has the frequency of an input. A law answers a
    /// true tone with a line in the input as well, but then the response does not exceed what caused it.
    pub fn is_response(&self, f: f64) -> bool {
        let Data { inputs, m, period_s, .. } = self.data;
        let has_line = |input: usize| {
            let samples: Vec<f64> = inputs.iter().copied().skip(input).step_by(*m).collect();
            let bin = 1.0 / (samples.len() as f64 * period_s);
            let around = SURROUNDINGS.flat_map(|k| [f - k as f64 * bin, f + k as f64 * bin]);
            let around: Vec<f64> =
                around.filter(|g| *g > 0.0).map(|g| amplitude(&samples, *period_s, g).powi(2)).collect();
            amplitude(&samples, *period_s, f).powi(2) > INPUT_LINE_RATIO * median(&around)
        };
        let of = |samples: &[f64]| amplitude(samples, self.step_s, f);
        of(self.left) < WRONG_RESPONSE_SHARE * of(&self.modelled) && (0..*m).any(has_line)
    }
}

/// Amplitude of the sine of frequency `f`, Hz, under Hann's window.
fn amplitude(samples: &[f64], step_s: f64, f: f64) -> f64 {
    let n = samples.len() as f64;
    let turn = C64::from_polar(1.0, -std::f64::consts::TAU * f * step_s);
    let (mut phasor, mut sum) = (C64::new(1.0, 0.0), C64::new(0.0, 0.0));
    for (k, y) in samples.iter().enumerate() {
        let weight = 0.5 - 0.5 * (std::f64::consts::TAU * (k as f64 + 0.5) / n).cos();
        sum += phasor * (weight * y);
        phasor *= turn;
    }
    4.0 * sum.norm() / n
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;
    use whirlstand_vehicle::Stream;

    const STEPS: usize = 2000;

    /// A record of one input; what a model leaves of a sensor at 1.3 Hz, as a share of the response.
    fn is_response(input: impl FnMut(usize) -> f64, share: f64) -> bool {
        let data = Data {
            origin: "x".into(),
            start_s: 0.0,
            period_s: 0.01,
            steps: STEPS,
            inputs: (0..STEPS).map(input).collect(),
            m: 1,
            starts: vec![0],
            clocks: vec![0],
            held: false,
            memory_s: None,
            likeliest_s: None,
            likeliest_filter: None,
            channels: Vec::new(),
        };
        let wave = |size: f64| -> Vec<f64> {
            (0..STEPS).map(|k| size * (TAU * 1.3 * k as f64 * 0.01 + 0.4).sin()).collect()
        };
        let (left, measured) = (wave(share), wave(1.0 + share));
        Explained::new(&data, &measured, &left, 0.01).is_response(1.3)
    }

    #[test]
    fn only_at_the_lines_of_an_input_a_small_tone_is_a_wrong_response() {
        let sines = |k: usize| [0.4, 1.3, 2.9].map(|f| (TAU * f * k as f64 * 0.01).sin()).iter().sum::<f64>();
        assert!(is_response(sines, 0.05));
        // A law may answer a tone as large as this.
        assert!(!is_response(sines, 1.0));
        let other = |k: usize| [0.4, 1.9, 2.9].map(|f| (TAU * f * k as f64 * 0.01).sin()).iter().sum::<f64>();
        assert!(!is_response(other, 0.05));
        // Sweeps, steps and noise have no lines.
        let seconds = |k: usize| k as f64 * 0.01;
        assert!(!is_response(|k| (TAU * (0.2 + 0.1 * seconds(k)) * seconds(k)).sin(), 0.05));
        assert!(!is_response(|k| if (k / 150) % 4 == 1 { 1.0 } else { 0.0 }, 0.05));
        for seed in 0..50 {
            let mut stream = Stream::new(seed, "lines");
            let mut pilot = 0.0;
            assert!(
                !is_response(
                    |_| {
                        pilot = 0.95 * pilot + stream.normal();
                        pilot
                    },
                    0.05
                ),
                "{seed}"
            );
        }
    }
}
