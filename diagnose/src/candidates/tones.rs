//! Tones: frequencies at which a residual's spectrum stands out of its noise floor.

use crate::thresholds::{MIN_PERIODS, TONE_POWER_RATIO, TONES_FOLLOWED};
use rayon::prelude::*;
use whirlstand_linalg::{C64, fft};
use whirlstand_vehicle::Kind;

use crate::candidates::excited_lines::Explained;
use crate::candidates::library::{Candidate, Sizes, tone};
use crate::model::fit::{Fit, Model};
use crate::model::score_test::ScoreTest;
use crate::model::step_response::Responses;
use crate::model::wave::Wave;
use whirlstand_logs::stats::median;

/// Candidates: a vibration of the channel, and a periodic disturbance of every state, at every tone of a channel.
pub fn tones(
    model: &Model<'_, '_>,
    fit: &Fit,
    score_test: &ScoreTest<'_>,
    sizes: &Sizes,
    responses: &Responses,
) -> Vec<Candidate> {
    let data = score_test.data();
    let rest = score_test.without_nuisances(&fit.residual);
    let vehicle = &model.free_run.vehicle;
    let looks = (data.steps / 2) as f64;
    let channels: Vec<_> = data.channels.iter().zip(data.ranges()).collect();
    let mut sensed: Vec<(f64, f64, Candidate)> = channels
        .into_par_iter()
        .flat_map_iter(|(channel, range)| {
            let place = &vehicle.outputs[channel.output].name;
            let step_s = data.period_s * channel.stride as f64;
            let explained = Explained::new(data, &channel.values, &rest[range.clone()], step_s);
            lines(&rest[range], step_s)
                .into_iter()
                .filter(|(_, f)| !explained.is_response(*f))
                .map(|(height, f)| {
                    let (amplitude, phase) = sine(score_test, fit, channel.output, f, data);
                    (height, f, tone(Kind::Vibration, place, (f, amplitude, phase), sizes, looks))
                })
                .collect::<Vec<_>>()
        })
        .collect();
    sensed.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut frequencies: Vec<f64> = Vec::new();
    for (_, f, _) in &sensed {
        if !frequencies.iter().any(|g| (f - g).abs() < 0.5 / data.duration_s()) {
            frequencies.push(*f);
        }
    }
    frequencies.truncate(2 * TONES_FOLLOWED);
    let forces: Vec<(f64, usize)> =
        frequencies.iter().flat_map(|f| (0..vehicle.states.len()).map(move |i| (*f, i))).collect();
    let driven = forces.into_par_iter().filter_map(|(f, i)| {
        let (s, c) = responses.waves(data, i, f)?;
        let (amplitude, phase) = pair(score_test, &s, &c).map(|(s, c)| polar(s, c))?;
        Some(tone(Kind::PeriodicDisturbance, &vehicle.states[i].name, (f, amplitude, phase), sizes, looks))
    });
    let driven: Vec<Candidate> = driven.collect();
    sensed.into_iter().map(|(_, _, candidate)| candidate).chain(driven).collect()
}

/// Spectral lines that stand out, highest first: power relative to their surroundings, and frequency, Hz.
fn lines(samples: &[f64], period_s: f64) -> Vec<(f64, f64)> {
    let n = samples.len();
    if n < 64 {
        return Vec::new();
    }
    // Hann's window keeps a strong tone, or a drift, from leaking over all the others; padding to twice the length
    // lets no tone fall between two frequencies.
    let length = (2 * n).next_power_of_two();
    let mut buffer: Vec<C64> = vec![C64::new(0.0, 0.0); length];
    for (k, (b, y)) in buffer.iter_mut().zip(samples).enumerate() {
        let w = 0.5 - 0.5 * (std::f64::consts::TAU * (k as f64 + 0.5) / n as f64).cos();
        b.re = w * y;
    }
    fft::forward(length).process(&mut buffer);
    let power: Vec<f64> = buffer[..length / 2].iter().map(|c| c.norm_sqr()).collect();
    let bin = length as f64 / n as f64;
    let lowest = (MIN_PERIODS * bin).ceil() as usize;
    let mut peaks: Vec<(f64, f64)> = Vec::new();
    // The noise floor varies slowly: one median serves all lines in a part of its window.
    let mut known: Option<(usize, f64)> = None;
    for i in lowest.max(2)..power.len() - 2 {
        if power[i] < power[i - 1] || power[i] <= power[i + 1] {
            continue;
        }
        let reach = ((40.0 * bin) as usize).max(i / 8);
        let floor = match known {
            Some((at, floor)) if i - at < reach / 8 => floor,
            _ => {
                let from = i.saturating_sub(reach).max(lowest);
                let around: Vec<f64> =
                    (from..(i + reach).min(power.len())).step_by(bin as usize).map(|j| power[j]).collect();
                // The median of an exponential distribution is ln 2 of its mean.
                let floor = median(&around) / std::f64::consts::LN_2;
                known = Some((i, floor));
                floor
            }
        };
        if floor > 0.0 && power[i] > TONE_POWER_RATIO * floor {
            let (left, middle, right) = (power[i - 1].ln(), power[i].ln(), power[i + 1].ln());
            let shift = 0.5 * (left - right) / (left - 2.0 * middle + right);
            let f = (i as f64 + shift.clamp(-0.5, 0.5)) / (length as f64 * period_s);
            // Lines are sorted by the ratio to the floor, not by power: where the noise is loud, its own
            // peaks exceed a tone elsewhere.
            peaks.push((power[i] / floor, f));
        }
    }
    peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut found: Vec<(f64, f64)> = Vec::new();
    for (height, f) in peaks {
        if found.len() < TONES_FOLLOWED
            && found.iter().all(|(_, g)| (f - g).abs() > 4.0 / (n as f64 * period_s))
        {
            found.push((height, f));
        }
    }
    found
}

/// Amplitude and phase from the coefficients of sine and cosine.
fn polar(sine: f64, cosine: f64) -> (f64, f64) {
    (sine.hypot(cosine), cosine.atan2(sine))
}

/// Least-squares amplitudes of two signatures together.
fn pair(score_test: &ScoreTest<'_>, a: &[f64], b: &[f64]) -> Option<(f64, f64)> {
    use crate::model::columns::dot;
    let (a, b, e) = (score_test.signature(a), score_test.signature(b), score_test.residual());
    let (aa, ab, bb) = (dot(&a, &a), dot(&a, &b), dot(&b, &b));
    let determinant = aa * bb - ab * ab;
    (determinant > 1e-9 * aa * bb).then(|| {
        let (ae, be) = (dot(&a, e), dot(&b, e));
        ((ae * bb - be * ab) / determinant, (be * aa - ae * ab) / determinant)
    })
}

fn sine(
    score_test: &ScoreTest<'_>,
    fit: &Fit,
    output: usize,
    f: f64,
    data: &crate::data::record::Data,
) -> (f64, f64) {
    let (mut s, mut c) = (vec![0.0; fit.residual.len()], vec![0.0; fit.residual.len()]);
    for (channel, range) in data.channels.iter().zip(data.ranges()) {
        if channel.output == output {
            let step_s = channel.stride as f64 * data.period_s;
            let mut wave = Wave::new(f * data.time_s(channel.first), f * step_s);
            let mut records = data.starts.iter().copied().skip(1).peekable();
            for (k, (s, c)) in s[range.clone()].iter_mut().zip(&mut c[range]).enumerate() {
                let now = channel.step(k);
                while records.next_if(|start| *start <= now).is_some() {
                    wave.begin(f * data.time_s(now));
                }
                (*s, *c) = wave.advance();
            }
        }
    }
    pair(score_test, &s, &c).map_or((0.0, 0.0), |(s, c)| polar(s, c))
}
