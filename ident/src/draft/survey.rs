//! Finds the input that explains each output, by regressions on held-out data, and refuses unsuitable
//! records.

use rayon::prelude::*;
use whirlstand_logs::Record;
use whirlstand_logs::stats::{mean, rms, white_noise_std};

use super::answer::LeftOut;
use super::blocks::{HELD_OUT, Pair, horizons, least_steps, range};
use super::comparison::{Comparison, takes_away};
use super::cross_validation::Parts;
use super::error::DraftError;
use super::feedback::reacts;

use super::proposal::Chosen;
use super::reading::{input_interval, interval, own_samples, samples};

/// Longest sampling interval of an input, a rate or an acceleration, s, whatever it looks like. Such a motion of a small
/// vehicle has a rise time of some 0.2 s, which needs four to ten samples (Astrom and Wittenmark, Computer-Controlled Systems,
/// 3rd ed., section 2.9).
const LONGEST_INTERVAL_S: f64 = 0.05;
/// Largest error of a signal halfway between its neighbours, as a share of its spread, with which a slower vehicle is known
/// between its samples: a sine sampled N times a period leaves 1 - cos(2 pi / N), one half for six samples a period.
const SMOOTH_SHARE: f64 = 0.5;
/// Time between two rows from which the unit of the times is doubted, s: ten milliseconds told in milliseconds.
const LEAST_STRANGE_STEP_S: f64 = 10.0;
/// Standard errors by which the inputs must predict better than the past alone, as several pairs and horizons
/// are tried.
const EXPLAINED_SIGMAS: f64 = 3.0;
/// Ratio of spread to noise below which an output is at rest.
const REST_RATIO: f64 = 3.0;
/// Spread below which a rate is at rest, rad/s: that of a small gyroscope on a table, 0.01 deg/s and root Hz
/// over some hundred Hz, with a margin for a draught.
const REST_RATE: f64 = 0.01;

/// An output and the input that explains it best.
#[derive(Debug, Clone)]
pub struct Link {
    /// The input of the link.
    pub input: Chosen,
    /// The output of the link.
    pub output: Chosen,
    /// Data of both, split for validation.
    pub pair: Pair,
    /// Prediction horizon, steps.
    pub horizon: usize,
    /// Errors of the prediction of the held-out data from the output's own past alone.
    pub own_past: Vec<f64>,
    /// Comparison of the prediction from the past alone with that from past and input.
    pub comparison: Comparison,
}

impl Link {
    /// Share by which the input reduces the mean square error.
    pub fn share(&self) -> f64 {
        1.0 - self.comparison.second / self.comparison.first.max(f64::MIN_POSITIVE)
    }

    fn explains(&self) -> bool {
        self.comparison.most_sigmas() > EXPLAINED_SIGMAS && takes_away(&self.comparison)
    }
}

/// True when a signal is not constant.
pub fn moves(record: &Record, chosen: &Chosen) -> bool {
    record.get(&chosen.name).is_some_and(|signal| {
        let (middle, deviation) = range(&signal.values);
        deviation > 1e-9 * middle.abs().max(1e-9)
    })
}

/// Refuses a record with constant motor commands.
///
/// # Errors
/// [`DraftError::MotorsOff`].
pub fn check_motors(record: &Record, motors: &[Chosen], inputs: &[Chosen]) -> Result<(), DraftError> {
    if motors.is_empty() || motors.iter().any(|motor| moves(record, motor)) {
        return Ok(());
    }
    let list = |all: &[Chosen], of: fn(&Chosen) -> &str| all.iter().map(of).collect::<Vec<_>>().join(", ");
    Err(DraftError::MotorsOff {
        log: record.origin.clone(),
        motors: list(motors, |c| &c.source),
        inputs: list(inputs, |c| &c.source),
    })
}

/// The inputs and outputs with a sufficient sampling rate.
///
/// # Errors
/// [`DraftError::TooSlow`] when no input or no output is left.
pub fn fast_enough(
    record: &Record,
    inputs: &[Chosen],
    outputs: &[Chosen],
    left_out: &mut Vec<LeftOut>,
) -> Result<(Vec<Chosen>, Vec<Chosen>), DraftError> {
    let slow = |c: &&Chosen, every_s: Option<f64>| {
        every_s.is_some_and(|s| s > LONGEST_INTERVAL_S && !is_smooth(&samples(record, c, every_s)))
    };
    let fast_inputs: Vec<Chosen> =
        inputs.iter().filter(|c| !slow(c, input_interval(record, c))).cloned().collect();
    let (slow_outputs, fast_outputs): (Vec<&Chosen>, Vec<&Chosen>) =
        outputs.iter().partition(|c| slow(c, interval(record, c)));
    if fast_inputs.is_empty() || fast_outputs.is_empty() {
        return Err(too_slow(record, inputs, outputs));
    }
    left_out.extend(slow_outputs.into_iter().map(|output| {
        let text = late(output, interval(record, output)).unwrap_or_default();
        LeftOut { output: output.name.clone(), why: format!("logged too slowly ({text})") }
    }));
    Ok((fast_inputs, fast_outputs.into_iter().cloned().collect()))
}

/// The refusal of a record of which no input acts: where all inputs or all outputs come late, that is the likely reason.
pub fn or_too_slow(record: &Record, inputs: &[Chosen], outputs: &[Chosen], why: DraftError) -> DraftError {
    let late_input = |c: &Chosen| late(c, input_interval(record, c)).is_some();
    let late_output = |c: &Chosen| late(c, interval(record, c)).is_some();
    match why {
        DraftError::Unexplained { .. } | DraftError::NoStructure { .. }
            if inputs.iter().all(late_input) || outputs.iter().all(late_output) =>
        {
            too_slow(record, inputs, outputs)
        }
        why => why,
    }
}

/// A signal that comes less often than the motion of a small vehicle requires, as text.
fn late(chosen: &Chosen, every_s: Option<f64>) -> Option<String> {
    every_s.filter(|s| *s > LONGEST_INTERVAL_S).map(|s| format!("{} every {:.0} ms", chosen.source, 1e3 * s))
}

fn too_slow(record: &Record, inputs: &[Chosen], outputs: &[Chosen]) -> DraftError {
    let inputs = inputs.iter().filter_map(|c| late(c, input_interval(record, c)));
    let signals: Vec<String> =
        inputs.chain(outputs.iter().filter_map(|c| late(c, interval(record, c)))).collect();
    DraftError::TooSlow {
        log: record.origin.clone(),
        signals: signals.join(", "),
        longest_ms: 1e3 * LONGEST_INTERVAL_S,
        unit: unit_remark(record),
    }
}

/// True when a signal lies so near to the middle of its neighbours that it is known between its samples.
fn is_smooth(values: &[f64]) -> bool {
    let level = mean(values);
    let spread = rms(&values.iter().map(|v| v - level).collect::<Vec<_>>());
    let off: Vec<f64> = values.windows(3).map(|w| w[1] - 0.5 * (w[0] + w[2])).collect();
    rms(&off) < SMOOTH_SHARE * spread
}

/// What to do where the rows of a record are so far apart that its times are probably in a smaller unit than seconds.
fn unit_remark(record: &Record) -> String {
    let step_s = record.period().unwrap_or(0.0);
    if step_s < LEAST_STRANGE_STEP_S {
        return String::new();
    }
    format!(
        ". The rows are {step_s} s apart: if their times are in another unit, give it as in --time COLUMN[us]"
    )
}

/// Links every output to the input that explains it best, each input to one output at most. `record` has the
/// steps of the fit, `raw` those of the log.
///
/// # Errors
/// [`DraftError`]: the record is too short, no signal moves, or no output is explained.
pub fn link(
    record: &Record,
    raw: &Record,
    inputs: &[Chosen],
    outputs: &[Chosen],
    left_out: &mut Vec<LeftOut>,
) -> Result<Vec<Link>, DraftError> {
    let pairs: Vec<(&Chosen, &Chosen)> =
        outputs.iter().flat_map(|output| inputs.iter().map(move |input| (input, output))).collect();
    let found = pairs.par_iter().map(|(input, output)| one(record, input, output));
    let found: Vec<Option<Link>> = found.collect::<Result<_, _>>()?;
    let mut all: Vec<Link> = found.into_iter().flatten().collect();
    if all.is_empty() {
        return Err(DraftError::TooShort {
            log: record.origin.clone(),
            seconds: record.len() as f64 * record.period().unwrap_or(0.0),
            steps: record.len(),
            needed: least_steps(),
        });
    }
    all.sort_by(|a, b| b.share().total_cmp(&a.share()));
    let remarks: Vec<String> = outputs.iter().filter_map(|o| response_remark(o, &all)).collect();
    let mut links: Vec<Link> = Vec::new();
    for candidate in all.iter().filter(|l| l.explains()) {
        let taken = |l: &Link| l.input == candidate.input || l.output == candidate.output;
        if !links.iter().any(taken) {
            let mut link = candidate.clone();
            link.pair.reacts = reacts(&link.pair, link.horizon);
            links.push(link);
        }
    }
    if links.is_empty() {
        return Err(refusal(raw, outputs, remarks));
    }
    let unlinked = outputs.iter().filter(|o| !links.iter().any(|l| l.output == **o));
    left_out.extend(unlinked.map(|output| LeftOut {
        output: output.name.clone(),
        why: match response_remark(output, &all) {
            _ if !moves(record, output) => "it does not change".into(),
            Some(best) => {
                format!("no input that is not already used for another output explains it on held-out data ({best})")
            }
            None => "too few valid samples".into(),
        },
    }));
    // In the order of the axes in the log's program.
    links.sort_by_key(|l| outputs.iter().position(|o| *o == l.output));
    Ok(links)
}

/// Remark on the best response of an output to any input.
fn response_remark(output: &Chosen, all: &[Link]) -> Option<String> {
    let best = all.iter().find(|l| l.output == *output)?;
    let (output, input) = (&output.name, &best.input.name);
    let (share, sigmas) = (100.0 * best.share(), best.comparison.most_sigmas());
    Some(if share < 0.0 && sigmas > 0.0 {
        format!(
            "{output}: with {input} most predictions are better than from the past alone ({sigmas:.1} standard errors), but a \
             few are so much worse that the mean square error grows by {:.0} %",
            -share
        )
    } else {
        let reduces =
            format!("{output}: {input} reduces the mean square error of the past alone by {share:.1} %");
        // Else the reader sees a large share and does not see why it does not count.
        let by_chance = takes_away(&best.comparison) && !best.explains();
        if by_chance {
            format!(
                "{reduces}, {sigmas:.2} standard errors where more than {EXPLAINED_SIGMAS} are needed: a longer record would \
                 tell it from chance"
            )
        } else {
            format!("{reduces}, {sigmas:.1} standard errors")
        }
    })
}

fn one(record: &Record, input: &Chosen, output: &Chosen) -> Result<Option<Link>, DraftError> {
    let Some(pair) = Pair::new(record, &input.name, &output.name)? else { return Ok(None) };
    let intervals = [input_interval(record, input), interval(record, output)];
    let slowest = intervals.into_iter().flatten().fold(0.0, f64::max);
    let ahead = horizons(&pair, slowest);
    let parts = Parts::of(&pair, &ahead);
    let compared =
        ahead.iter().enumerate().filter_map(|(at, horizon)| Some((at, *horizon, parts.compared(at)?)));
    let compared: Vec<(usize, usize, Comparison)> = compared.collect();
    // At some horizon a few errors may outweigh all others; the input has to explain at one.
    let most = |of: fn(&Comparison) -> f64, explained: bool| {
        let known = compared.iter().filter(|(.., c)| !explained || takes_away(c));
        known.max_by(|a, b| of(&a.2).total_cmp(&of(&b.2))).copied()
    };
    let usual = most(|c| c.sigmas, true).filter(|(.., c)| c.sigmas > EXPLAINED_SIGMAS);
    let chosen = usual
        .or_else(|| most(Comparison::most_sigmas, true))
        .or_else(|| most(Comparison::most_sigmas, false));
    let Some((at, horizon, comparison)) = chosen else { return Ok(None) };
    let Some(own_past) = parts.errors(HELD_OUT, at, false) else { return Ok(None) };
    Ok(Some(Link { input: input.clone(), output: output.clone(), pair, horizon, own_past, comparison }))
}

/// Error when nothing is explained: nothing moves, or the motion is not due to the actuators.
fn refusal(record: &Record, outputs: &[Chosen], found: Vec<String>) -> DraftError {
    let turns = |output: &&Chosen| record.get(&output.name).is_some_and(|s| s.unit == "rad/s");
    let rates: Vec<&Chosen> = outputs.iter().filter(turns).collect();
    // An accelerometer also shakes on the ground with running engines; only rates show motion.
    let judged: Vec<&Chosen> = if rates.is_empty() { outputs.iter().collect() } else { rates };
    let still = |output: &&Chosen| -> Option<String> {
        let values = own_samples(record, output);
        let level = mean(&values);
        let spread = rms(&values.iter().map(|v| v - level).collect::<Vec<_>>());
        // The motion between samples that come late looks like noise.
        let is_late = late(output, interval(record, output)).is_some();
        let noise = if is_late { 0.0 } else { white_noise_std(&values) };
        let least = if turns(output) { REST_RATE } else { 0.0 };
        let text = format!("{} (spread {spread:.2e}, noise {noise:.2e})", output.name);
        (spread <= (REST_RATIO * noise).max(least)).then_some(text)
    };
    let log = record.origin.clone();
    let resting: Vec<String> = judged.iter().filter_map(still).collect();
    if resting.len() == judged.len() {
        return DraftError::OutputsAtRest { log, outputs: resting.join(", ") };
    }
    DraftError::Unexplained { log, found: found.join("; ") }
}
