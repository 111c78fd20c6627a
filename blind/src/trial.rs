//! A trial: drawn from its number, written to files for the diagnosis, with a sealed answer.

use std::collections::BTreeMap;
use std::fmt::Write;

use serde::{Deserialize, Serialize};
use whirlstand_vehicle::Effect;

use super::error::BlindError;
use super::excitation::Excitation;
use super::experiment::{Experiment, Setting};
use super::generator::Generator;
use super::hide::{self, HiddenTruth};
use super::noise::Colour;
use super::out_of_library::OutOfLibraryEffect;
use super::plan::{Case, Plan};
use super::random::RandomStream;
use super::turbulence::Spectrum;

/// Number of draws after which a trial is skipped.
const ATTEMPTS: u32 = 10;

/// A hidden effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Name of the effect.
    pub effect: String,
    /// Place at which the effect acts; for an effect outside the table, a description.
    #[serde(rename = "where")]
    pub place: String,
    /// Parameters in SI.
    pub parameters: BTreeMap<String, f64>,
    /// Target vehicle of a mode transition.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub to: Option<String>,
    /// Detectability: squared norm of the whitened change of the record that neither the initial state nor
    /// the free parameters explain, relative to the noise variance; for pairs, nor the other effect.
    pub lambda: f64,
    /// For an effect outside the table: the most similar effect of the table among those tried, and the |cos|
    /// of the angle between their signatures.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub nearest: Option<(String, f64)>,
}

/// The answer of a trial, which stays sealed while the diagnosis runs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// Number of the trial.
    pub number: u64,
    /// Generator from which it was drawn.
    #[serde(default)]
    pub generator: Generator,
    /// Kind of trial.
    pub case: Case,
    /// Name of the vehicle.
    pub vehicle: String,
    /// Whether the vehicle file has free parameters.
    pub free: bool,
    /// Kind of excitation.
    pub excitation: Excitation,
    /// Length of the record, s.
    pub duration_s: f64,
    /// Sampling rate, Hz.
    pub rate_hz: f64,
    /// Whether the vehicle was flown in closed loop.
    #[serde(default)]
    pub closed_loop: bool,
    /// Whether the vehicle file states the sensor noise.
    #[serde(default = "yes")]
    pub noise_declared: bool,
    /// Colour of the noise.
    pub noise: Colour,
    /// Noise std of each output, SI.
    pub noise_std: Vec<f64>,
    /// Spectrum of the turbulence, where there is any.
    #[serde(default)]
    pub spectrum: Spectrum,
    /// The hidden effects.
    pub effects: Vec<Truth>,
}

/// Default for trials of older runs, which declare their noise.
fn yes() -> bool {
    true
}

/// A record with its answer.
#[derive(Debug, Clone)]
pub struct Trial {
    /// The hidden truth.
    pub answer: Answer,
    pub(crate) experiment: Experiment,
    pub(crate) effects: Vec<Effect>,
    pub(crate) outside: Option<OutOfLibraryEffect>,
    pub(crate) record: Vec<f64>,
}

impl Trial {
    /// Draws the trial of a plan; `None` when the setting has no place for its effects or cannot show them.
    ///
    /// # Errors
    /// Fails when the user's vehicle or excitation cannot be used at all.
    pub fn draw(plan: &Plan, setting: &Setting) -> Result<Option<Self>, BlindError> {
        let mut failure = None;
        for attempt in 0..ATTEMPTS {
            let mut stream = RandomStream::new(plan.number, &format!("scene {attempt}"));
            match Self::attempt(plan, Experiment::draw(plan, setting, &mut stream)?, attempt) {
                Ok(Some(trial)) => return Ok(Some(trial)),
                Ok(None) => {}
                // Some effects of some sizes make the vehicle unstable: another trial is drawn.
                Err(e @ BlindError::Diverged { .. }) => failure = Some(e),
                Err(e) => return Err(e),
            }
        }
        match failure {
            Some(e) if setting.commands.is_some() && plan.case == Case::Clean => Err(e),
            _ => Ok(None),
        }
    }

    fn attempt(plan: &Plan, experiment: Experiment, attempt: u32) -> Result<Option<Self>, BlindError> {
        let hidden = match plan.case {
            Case::Clean => Some(HiddenTruth {
                experiment,
                effects: Vec::new(),
                outside: None,
                lambdas: Vec::new(),
                nearest: None,
            }),
            Case::Single => hide::single(plan, experiment, attempt)?,
            Case::Pair => hide::pair(plan, experiment, attempt)?,
            Case::Outside => hide::outside(plan, experiment, attempt)?,
        };
        let hidden = match hidden {
            Some(hidden) => hidden.flown()?,
            None => None,
        };
        hidden.map(|hidden| Self::sealed(plan, hidden)).transpose()
    }

    fn sealed(plan: &Plan, hidden: HiddenTruth) -> Result<Self, BlindError> {
        let HiddenTruth { experiment, effects, outside, lambdas, nearest } = hidden;
        let record = experiment.record(&effects, outside.as_ref())?;
        let table = effects.iter().map(|e| (e.kind().name().to_string(), e.place().to_string(), e));
        let mut truths: Vec<Truth> = table
            .zip(&lambdas)
            .map(|((effect, place, e), lambda)| Truth {
                effect,
                place,
                parameters: e.parameters().map(|(name, value)| (name.to_string(), value)).collect(),
                to: e.text().map(Into::into),
                lambda: *lambda,
                nearest: None,
            })
            .collect();
        if let (Some(outside), Some(lambda)) = (&outside, lambdas.first()) {
            truths.push(Truth {
                effect: outside.kind.name().into(),
                place: place_of(outside, &experiment),
                parameters: [("size", outside.size), ("scale", outside.scale)]
                    .map(|(name, value)| (name.to_string(), value))
                    .into(),
                to: None,
                lambda: *lambda,
                nearest,
            });
        }
        let answer = Answer {
            number: plan.number,
            generator: plan.generator,
            case: plan.case,
            vehicle: experiment.nominal.vehicle.name.clone(),
            free: !experiment.nominal.vehicle.free.is_empty(),
            excitation: experiment.excitation,
            duration_s: experiment.commands.duration_s(),
            rate_hz: 1.0 / experiment.commands.period_s,
            closed_loop: experiment.control.is_some(),
            noise_declared: experiment.declares_noise(),
            noise: experiment.noise.colour,
            noise_std: experiment.noise.std.clone(),
            spectrum: experiment.spectrum,
            effects: truths,
        };
        Ok(Self { answer, experiment, effects, outside, record })
    }

    /// The record as CSV: `t` in s, commands and outputs in the units that the vehicle file declares.
    pub fn csv(&self) -> String {
        let vehicle = &self.experiment.nominal.vehicle;
        let inputs = vehicle.inputs.iter().map(|u| (&u.name, &u.unit));
        let outputs = vehicle.outputs.iter().map(|y| (&y.name, &y.unit));
        let mut text = String::from("t");
        for (name, unit) in inputs.chain(outputs) {
            let unit = unit.to_string();
            let bracket = if unit == "1" { String::new() } else { format!("[{unit}]") };
            // Writing to a string cannot fail, here and below.
            let _ = write!(text, ",{name}{bracket}");
        }
        text.push('\n');
        let p = vehicle.outputs.len();
        for (k, row) in self.record.chunks_exact(p).enumerate() {
            let _ = write!(text, "{}", (k as f64 * self.experiment.commands.period_s * 1e9).round() / 1e9);
            for (u, input) in self.experiment.commands.inputs.iter().zip(&vehicle.inputs) {
                let _ = write!(text, ",{}", u[k] / input.unit.factor());
            }
            for (y, output) in row.iter().zip(&vehicle.outputs) {
                let _ = write!(text, ",{}", y / output.unit.factor());
            }
            text.push('\n');
        }
        text
    }

    /// The nominal vehicle file.
    pub fn vehicle_file(&self) -> &str {
        &self.experiment.nominal.toml
    }

    /// The answer as JSON, as it is sealed.
    pub fn answer_json(&self) -> String {
        // Numbers, texts and lists always serialise.
        serde_json::to_string_pretty(&self.answer).unwrap_or_default()
    }

    /// Rms of each output's record minus the true motion, over the samples from `from_s` to `to_s`: no model
    /// can have a smaller error.
    pub fn noise_floor(&self, from_s: f64, to_s: f64) -> Result<Vec<f64>, BlindError> {
        let truth = self.experiment.expected(&self.effects, self.outside.as_ref())?;
        let (p, period_s) = (self.answer.noise_std.len(), self.experiment.commands.period_s);
        let last = self.experiment.commands.samples();
        let sample = |t: f64| ((t / period_s).round().max(0.0) as usize).min(last);
        let (from, to) = (sample(from_s), sample(to_s).max(sample(from_s) + 1).min(last));
        let rms = |i: usize| {
            let square: f64 = (from..to).map(|k| (self.record[k * p + i] - truth[k * p + i]).powi(2)).sum();
            (square / (to.saturating_sub(from)).max(1) as f64).sqrt()
        };
        Ok((0..p).map(rms).collect())
    }
}

fn place_of(outside: &OutOfLibraryEffect, experiment: &Experiment) -> String {
    let vehicle = &experiment.nominal.vehicle;
    let state = |i: usize| vehicle.states[i].name.as_str();
    let (input, output) = (&vehicle.inputs[outside.input].name, &vehicle.outputs[outside.output].name);
    format!(
        "input {input}, output {output}, states {} and {} onto {}",
        state(outside.states.0),
        state(outside.states.1),
        state(outside.onto)
    )
}
