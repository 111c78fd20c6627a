//! A trial: drawn from its number, written for diagnosis, its answer sealed.

use std::collections::BTreeMap;
use std::fmt::Write;

use serde::{Deserialize, Serialize};
use whirlstand_vehicle::Effect;

use super::BlindError;
use super::excitation::Excitation;
use super::hide::{self, Hiding};
use super::noise::Colour;
use super::outside::Outside;
use super::plan::{Case, Plan};
use super::random::Dice;
use super::scene::{Scene, Setting};

/// How often a trial is drawn anew before it is given up.
const ATTEMPTS: u32 = 10;

/// What is hidden in a record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Name of the effect.
    pub effect: String,
    /// Its place; for effects outside the table, in words.
    #[serde(rename = "where")]
    pub place: String,
    /// Parameters in SI.
    pub parameters: BTreeMap<String, f64>,
    /// Vehicle of a mode transition.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub to: Option<String>,
    /// Detectability: squared change of the whitened record that neither the initial state nor the free parameters
    /// explain, over the noise's variance; for pairs, beyond the other effect's change too.
    pub lambda: f64,
    /// For an effect outside the table: the one of the table that is most like it among some that were tried, and |cos|
    /// between their changes of the record.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub nearest: Option<(String, f64)>,
}

/// The answer of a trial, sealed while diagnosis runs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// Number of the trial.
    pub number: u64,
    /// Kind of trial.
    pub case: Case,
    /// Name of the vehicle.
    pub vehicle: String,
    /// Whether the vehicle file has free parameters.
    pub free: bool,
    /// Kind of excitation.
    pub excitation: Excitation,
    /// Length, s.
    pub duration_s: f64,
    /// Sampling, Hz.
    pub rate_hz: f64,
    /// Colour of the noise.
    pub noise: Colour,
    /// Noise of each output, SI.
    pub noise_std: Vec<f64>,
    /// What is hidden.
    pub effects: Vec<Truth>,
}

/// A record with its answer.
#[derive(Debug, Clone)]
pub struct Trial {
    /// What was hidden.
    pub answer: Answer,
    pub(crate) scene: Scene,
    pub(crate) effects: Vec<Effect>,
    pub(crate) outside: Option<Outside>,
    record: Vec<f64>,
}

impl Trial {
    /// Draws the trial of that plan; `None` when the setting has no place for its effects or cannot show them.
    ///
    /// # Errors
    /// When the user's vehicle or excitation cannot be used at all.
    pub fn draw(plan: &Plan, setting: &Setting) -> Result<Option<Self>, BlindError> {
        let mut failure = None;
        for attempt in 0..ATTEMPTS {
            let mut dice = Dice::new(plan.number, &format!("scene {attempt}"));
            match Self::attempt(plan, Scene::draw(plan, setting, &mut dice)?, attempt) {
                Ok(Some(trial)) => return Ok(Some(trial)),
                Ok(None) => {}
                // Some effects of some size make a vehicle unstable: another is drawn.
                Err(e @ BlindError::Diverged { .. }) => failure = Some(e),
                Err(e) => return Err(e),
            }
        }
        match failure {
            Some(e) if setting.commands.is_some() && plan.case == Case::Clean => Err(e),
            _ => Ok(None),
        }
    }

    fn attempt(plan: &Plan, scene: Scene, attempt: u32) -> Result<Option<Self>, BlindError> {
        let hiding = match plan.case {
            Case::Clean => {
                Some(Hiding { scene, effects: Vec::new(), outside: None, lambdas: Vec::new(), nearest: None })
            }
            Case::Single => hide::single(plan, scene, attempt)?,
            Case::Pair => hide::pair(plan, scene, attempt)?,
            Case::Outside => hide::outside(plan, scene, attempt)?,
        };
        hiding.map(|hiding| Self::sealed(plan, hiding)).transpose()
    }

    fn sealed(plan: &Plan, hiding: Hiding) -> Result<Self, BlindError> {
        let Hiding { scene, effects, outside, lambdas, nearest } = hiding;
        let record = scene.record(&effects, outside.as_ref())?;
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
                effect: outside.strange.name().into(),
                place: place_of(outside, &scene),
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
            case: plan.case,
            vehicle: scene.nominal.vehicle.name.clone(),
            free: !scene.nominal.vehicle.free.is_empty(),
            excitation: scene.excitation,
            duration_s: scene.commands.duration_s(),
            rate_hz: 1.0 / scene.commands.period_s,
            noise: scene.noise.colour,
            noise_std: scene.noise.std.clone(),
            effects: truths,
        };
        Ok(Self { answer, scene, effects, outside, record })
    }

    /// The record as CSV: `t` in s, commands and outputs in the units that the vehicle file declares.
    pub fn csv(&self) -> String {
        let vehicle = &self.scene.nominal.vehicle;
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
            let _ = write!(text, "{}", (k as f64 * self.scene.commands.period_s * 1e9).round() / 1e9);
            for (u, input) in self.scene.commands.inputs.iter().zip(&vehicle.inputs) {
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
        &self.scene.nominal.toml
    }

    /// The answer as it is sealed.
    pub fn answer_json(&self) -> String {
        // Numbers, texts and lists always serialise.
        serde_json::to_string_pretty(&self.answer).unwrap_or_default()
    }

    /// Root mean square, for each output and over the samples of `from_s` to `to_s`, of what is left of the record
    /// when the true motion is taken away: no model can do better.
    pub fn noise_floor(&self, from_s: f64, to_s: f64) -> Result<Vec<f64>, BlindError> {
        let truth = self.scene.expected(&self.effects, self.outside.as_ref())?;
        let (p, period_s) = (self.answer.noise_std.len(), self.scene.commands.period_s);
        let last = self.scene.commands.samples();
        let sample = |t: f64| ((t / period_s).round().max(0.0) as usize).min(last);
        let (from, to) = (sample(from_s), sample(to_s).max(sample(from_s) + 1).min(last));
        let rms = |i: usize| {
            let square: f64 = (from..to).map(|k| (self.record[k * p + i] - truth[k * p + i]).powi(2)).sum();
            (square / (to.saturating_sub(from)).max(1) as f64).sqrt()
        };
        Ok((0..p).map(rms).collect())
    }
}

fn place_of(outside: &Outside, scene: &Scene) -> String {
    let vehicle = &scene.nominal.vehicle;
    let state = |i: usize| vehicle.states[i].name.as_str();
    let (input, output) = (&vehicle.inputs[outside.input].name, &vehicle.outputs[outside.output].name);
    format!(
        "input {input}, output {output}, states {} and {} onto {}",
        state(outside.states.0),
        state(outside.states.1),
        state(outside.onto)
    )
}
