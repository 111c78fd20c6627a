//! Draws the sampled commands of each kind of excitation.

use std::f64::consts::TAU;

use super::excitation::Excitation;
use super::random::RandomStream;
use super::ranges::ExcitationRanges;

impl ExcitationRanges {
    /// Draws one of the kinds of excitation.
    pub(crate) fn draw(&self, stream: &mut RandomStream) -> Excitation {
        self.kinds[stream.below(self.kinds.len())]
    }
}

/// Number, length and sampling period of the commands.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CommandFormat {
    pub inputs: usize,
    pub samples: usize,
    pub period_s: f64,
    /// Highest frequency that the vehicle follows, Hz.
    pub highest_hz: f64,
}

/// Draws commands between -1 and 1 (inputs x samples).
pub(crate) fn commands(
    kind: Excitation,
    ranges: &ExcitationRanges,
    format: CommandFormat,
    stream: &mut RandomStream,
) -> Vec<Vec<f64>> {
    match kind {
        Excitation::Doublets => steps(ranges, format, stream, |_| vec![1.0, 1.0]),
        Excitation::Steps3211 => steps(ranges, format, stream, |_| vec![3.0, 2.0, 1.0, 1.0]),
        Excitation::Multisteps => steps(ranges, format, stream, |stream| {
            (0..2 + stream.below(5)).map(|_| stream.scaled(0.5, 4.0)).collect()
        }),
        Excitation::Sweep => sweeps(ranges, format, stream),
        Excitation::Chirp => chirps(ranges, format, stream),
        Excitation::Prbs => binary(ranges, format, stream),
        Excitation::Pilot | Excitation::Given => pilot(ranges, format, stream),
    }
}

/// Manoeuvres of steps of alternating sign, on one input at a time in turn, with pauses between them.
/// `lengths` draws the step lengths of a manoeuvre, in time units.
fn steps(
    ranges: &ExcitationRanges,
    format: CommandFormat,
    stream: &mut RandomStream,
    lengths: impl Fn(&mut RandomStream) -> Vec<f64>,
) -> Vec<Vec<f64>> {
    let CommandFormat { inputs, samples, period_s, highest_hz } = format;
    let mut all = vec![vec![0.0; samples]; inputs];
    let mut k = (stream.within(ranges.rest_s) / period_s) as usize;
    let mut turn = 0;
    while k < samples {
        let unit_s = stream.within(ranges.unit) / highest_hz;
        let mut level = stream.sign() * stream.within(ranges.level);
        for length in lengths(stream) {
            let end = k + ((length * unit_s / period_s).round() as usize).max(1);
            for value in all[turn % inputs].iter_mut().take(end).skip(k) {
                *value = level;
            }
            k = end;
            level = -level;
        }
        k += (stream.within(ranges.pause) * unit_s / period_s) as usize;
        turn += 1;
    }
    all
}

/// Lowest and highest frequency of a sweep, Hz; the record holds at least one and a half periods of the
/// lowest.
fn band(ranges: &ExcitationRanges, format: CommandFormat, stream: &mut RandomStream) -> (f64, f64) {
    let duration = format.samples as f64 * format.period_s;
    let lowest = (format.highest_hz * stream.within(ranges.sweep_lowest)).max(1.5 / duration);
    (lowest, format.highest_hz.max(2.0 * lowest))
}

/// Sines of the given phase function of time, faded in; every second input runs through it backwards in time.
fn turns(format: CommandFormat, lowest: f64, phase: impl Fn(f64) -> f64) -> Vec<Vec<f64>> {
    let duration = format.samples as f64 * format.period_s;
    let fade = (0.5 / lowest).min(0.05 * duration);
    let one = |falling: bool| -> Vec<f64> {
        (0..format.samples)
            .map(|k| {
                let t = k as f64 * format.period_s;
                let along = if falling { duration - t } else { t };
                (t / fade).min(1.0) * phase(along).sin()
            })
            .collect()
    };
    (0..format.inputs).map(|i| one(i % 2 == 1)).collect()
}

/// Sweeps with log-linear frequency in time.
fn sweeps(ranges: &ExcitationRanges, format: CommandFormat, stream: &mut RandomStream) -> Vec<Vec<f64>> {
    let (lowest, highest) = band(ranges, format, stream);
    let rate = (highest / lowest).ln() / (format.samples as f64 * format.period_s);
    turns(format, lowest, |t| TAU * lowest * ((rate * t).exp() - 1.0) / rate)
}

/// Linear sweeps: the frequency is linear in time.
fn chirps(ranges: &ExcitationRanges, format: CommandFormat, stream: &mut RandomStream) -> Vec<Vec<f64>> {
    let (lowest, highest) = band(ranges, format, stream);
    let rate = (highest - lowest) / (format.samples as f64 * format.period_s);
    turns(format, lowest, |t| TAU * (lowest + 0.5 * rate * t) * t)
}

/// Pseudo-random binary sequences: the sign is drawn anew at every time unit.
fn binary(ranges: &ExcitationRanges, format: CommandFormat, stream: &mut RandomStream) -> Vec<Vec<f64>> {
    let CommandFormat { inputs, samples, period_s, highest_hz } = format;
    let unit_s = stream.within(ranges.unit) / highest_hz;
    let unit = ((unit_s / period_s).round() as usize).max(1);
    let level = stream.within(ranges.level);
    let mut one = || -> Vec<f64> {
        let sides: Vec<f64> = (0..samples.div_ceil(unit)).map(|_| level * stream.sign()).collect();
        (0..samples).map(|k| sides[k / unit]).collect()
    };
    (0..inputs).map(|_| one()).collect()
}

/// White noise filtered by two first-order lags, scaled to an rms of 0.4 and limited to 1 (2.5 of its rms).
fn pilot(ranges: &ExcitationRanges, format: CommandFormat, stream: &mut RandomStream) -> Vec<Vec<f64>> {
    let CommandFormat { inputs, samples, period_s, highest_hz } = format;
    let decay = (-TAU * ranges.pilot_corner * highest_hz * period_s).exp();
    let mut one = || -> Vec<f64> {
        let (mut first, mut second) = (0.0, 0.0);
        let raw: Vec<f64> = (0..samples)
            .map(|_| {
                first = decay * first + (1.0 - decay) * stream.normal();
                second = decay * second + (1.0 - decay) * first;
                second
            })
            .collect();
        let rms = (raw.iter().map(|x| x * x).sum::<f64>() / samples.max(1) as f64).sqrt().max(1e-12);
        raw.iter().map(|x| (x / rms * 0.4).clamp(-1.0, 1.0)).collect()
    };
    (0..inputs).map(|_| one()).collect()
}
