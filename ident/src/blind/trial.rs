//! A trial: drawn from its number, written for diagnosis, its answer sealed.

use std::collections::BTreeMap;
use std::fmt::Write;

use serde::{Deserialize, Serialize};
use whirlstand_vehicle::{Effect, Kind};

use super::BlindError;
use super::detect::{Judge, kappa, lambda};
use super::draft::{self, Draft};
use super::excitation::Excitation;
use super::facts::Facts;
use super::noise::Colour;
use super::outside::Outside;
use super::plan::{Case, Plan};
use super::random::Dice;
use super::scene::{Scene, Setting};
use super::strange;

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
        match plan.case {
            Case::Clean => Self::sealed(plan, scene, Vec::new(), None, &[]).map(Some),
            Case::Single => single(plan, scene, attempt),
            Case::Pair => pair(plan, scene, attempt),
            Case::Outside => outside(plan, scene, attempt),
        }
    }

    fn sealed(
        plan: &Plan,
        scene: Scene,
        effects: Vec<Effect>,
        outside: Option<Outside>,
        lambdas: &[f64],
    ) -> Result<Self, BlindError> {
        let record = scene.record(&effects, outside.as_ref())?;
        let table = effects.iter().map(|e| (e.kind().name().to_string(), e.place().to_string(), e));
        let mut truths: Vec<Truth> = table
            .zip(lambdas)
            .map(|((effect, place, e), lambda)| Truth {
                effect,
                place,
                parameters: e.parameters().map(|(name, value)| (name.to_string(), value)).collect(),
                to: e.text().map(Into::into),
                lambda: *lambda,
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

/// What the record of a scene shows of an effect.
struct Stage {
    facts: Facts,
    judge: Judge,
    clean: Vec<f64>,
}

impl Stage {
    fn new(scene: &Scene) -> Result<Self, BlindError> {
        let vehicle = &scene.nominal.vehicle;
        Ok(Self {
            facts: Facts::new(vehicle, &scene.commands, &scene.x0)?,
            judge: Judge::new(vehicle, &scene.noise, &scene.x0, &scene.commands),
            clean: scene.record(&[], None)?,
        })
    }

    fn signature(&self, with: &[f64], without: &[f64]) -> Vec<f64> {
        self.judge.signature(with.iter().zip(without).map(|(a, b)| a - b).collect())
    }

    /// Whether a record stays near what the clean one does: an effect is no crash.
    fn bounded(&self, record: &[f64]) -> bool {
        let p = self.facts.y.len();
        (0..p).all(|i| {
            let peak = |of: &[f64]| of.iter().skip(i).step_by(p).fold(0.0f64, |peak, y| peak.max(y.abs()));
            peak(record) <= 10.0 * peak(&self.clean)
        })
    }
}

/// How a size came out.
struct Fitted {
    size: f64,
    lambda: f64,
}

/// The size within its range whose detectability comes nearest to the target.
fn fit(
    sizes: (f64, f64),
    target: f64,
    mut signature: impl FnMut(f64) -> Result<Vec<f64>, BlindError>,
) -> Result<Fitted, BlindError> {
    let mut size = (sizes.0 * sizes.1).sqrt();
    let mut power = 2.0;
    let mut last: Option<(f64, f64)> = None;
    for round in 0.. {
        let lambda = lambda(&signature(size)?);
        if let Some((size_before, lambda_before)) = last
            && lambda > 0.0
            && lambda_before > 0.0
        {
            let measured = (lambda / lambda_before).ln() / (size / size_before).ln();
            if measured.is_finite() {
                power = measured.clamp(0.7, 6.0);
            }
        }
        last = Some((size, lambda));
        let next = (size * (target / lambda.max(1e-9)).powf(1.0 / power)).clamp(sizes.0, sizes.1);
        let near = (0.6..1.7).contains(&(lambda / target)) || (next / size).ln().abs() < 0.02;
        if near || round == 6 {
            return Ok(Fitted { size, lambda });
        }
        size = next;
    }
    unreachable!("the loop ends by its own rounds")
}

/// A factor for the commands that would bring the detectability to the target, where the size could not.
fn missing(lambda: f64, target: f64) -> Option<f64> {
    let ratio = target / lambda.max(1e-9);
    (!(0.3..3.0).contains(&ratio)).then(|| ratio.sqrt().clamp(0.1, 10.0))
}

/// Effects whose detectability does not grow with their size, or that must show on their own.
fn place(
    kind: Kind,
    scene: &Scene,
    stage: &Stage,
    target: f64,
    dice: &mut Dice,
) -> Result<Option<(Effect, Fitted)>, BlindError> {
    let Some(draft) = draft::draft(kind, &scene.nominal.vehicle, &stage.facts, &scene.noise, dice) else {
        return Ok(None);
    };
    let fixed = dice.scaled(draft.sizes.0, draft.sizes.1);
    // Not every effect is as small as the record can show: some are plain, and the flight is gentle.
    let (least, most) = draft.sizes;
    let sizes = (dice.scaled(least, (least * least * most).cbrt()), most);
    let of = |size: f64| at(&draft, size);
    let signature = |size: f64| -> Result<Vec<f64>, BlindError> {
        Ok(stage.signature(&scene.record(&[of(size)?], None)?, &stage.clean))
    };
    let fitted = if draft.fixed {
        Fitted { size: fixed, lambda: lambda(&signature(fixed)?) }
    } else {
        fit(sizes, target, signature)?
    };
    Ok(Some((of(fitted.size)?, fitted)))
}

fn at(draft: &Draft, size: f64) -> Result<Effect, BlindError> {
    draft.at(size).map_err(BlindError::effect)
}

fn single(plan: &Plan, mut scene: Scene, attempt: u32) -> Result<Option<Trial>, BlindError> {
    let Some(&kind) = plan.effects.first() else { return Ok(None) };
    let mut target = Dice::new(plan.number, "target");
    let target = target.scaled(10.0, 2e4);
    for _ in 0..4 {
        let stage = Stage::new(&scene)?;
        let mut dice = Dice::new(plan.number, &format!("effect {attempt}"));
        let Some((effect, fitted)) = place(kind, &scene, &stage, target, &mut dice)? else { return Ok(None) };
        if let Some(factor) = missing(fitted.lambda, target)
            && scene.rescale(factor)
        {
            continue;
        }
        if fitted.lambda < 3.0 || !stage.bounded(&scene.record(std::slice::from_ref(&effect), None)?) {
            return Ok(None);
        }
        return Trial::sealed(plan, scene, vec![effect], None, &[fitted.lambda]).map(Some);
    }
    Ok(None)
}

fn pair(plan: &Plan, mut scene: Scene, attempt: u32) -> Result<Option<Trial>, BlindError> {
    let &[first, second] = plan.effects.as_slice() else { return Ok(None) };
    for _ in 0..3 {
        let stage = Stage::new(&scene)?;
        let mut dice = Dice::new(plan.number, &format!("effects {attempt}"));
        let targets = (dice.scaled(60.0, 1e4), dice.scaled(60.0, 1e4));
        let Some((one, fitted)) = place(first, &scene, &stage, targets.0, &mut dice)? else {
            return Ok(None);
        };
        if let Some(factor) = missing(fitted.lambda, targets.0)
            && scene.rescale(factor)
        {
            continue;
        }
        let Some((two, _)) = place(second, &scene, &stage, targets.1, &mut dice)? else { return Ok(None) };
        let both = scene.record(&[one.clone(), two.clone()], None)?;
        // Each beside the other, as it acts there.
        let of_one = stage.signature(&both, &scene.record(std::slice::from_ref(&two), None)?);
        let of_two = stage.signature(&both, &scene.record(std::slice::from_ref(&one), None)?);
        let masked = kappa(&of_one, &of_two);
        let left = 1.0 - masked * masked;
        let lambdas = [lambda(&of_one) * left, lambda(&of_two) * left];
        if masked > 0.7 || lambdas.iter().any(|l| *l < 30.0) || !stage.bounded(&both) {
            return Ok(None);
        }
        return Trial::sealed(plan, scene, vec![one, two], None, &lambdas).map(Some);
    }
    Ok(None)
}

fn outside(plan: &Plan, mut scene: Scene, attempt: u32) -> Result<Option<Trial>, BlindError> {
    let Some(kind) = plan.strange else { return Ok(None) };
    let target = Dice::new(plan.number, "target").scaled(300.0, 3e4);
    for _ in 0..4 {
        let stage = Stage::new(&scene)?;
        let mut dice = Dice::new(plan.number, &format!("outside {attempt}"));
        let Some((sizes, unit)) = strange::draft(kind, &stage.facts, &scene.noise, &mut dice) else {
            return Ok(None);
        };
        let of = |size: f64| Outside { size: size * unit.size, ..unit.clone() };
        let fitted = fit(sizes, target, |size| {
            Ok(stage.signature(&scene.record(&[], Some(&of(size)))?, &stage.clean))
        })?;
        if let Some(factor) = missing(fitted.lambda, target)
            && scene.rescale(factor)
        {
            continue;
        }
        let outside = of(fitted.size);
        if fitted.lambda < 100.0 || !stage.bounded(&scene.record(&[], Some(&outside))?) {
            return Ok(None);
        }
        return Trial::sealed(plan, scene, Vec::new(), Some(outside), &[fitted.lambda]).map(Some);
    }
    Ok(None)
}
