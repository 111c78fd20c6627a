//! What is hidden in a scene, and how large: effects are sized for a detectability.

use whirlstand_vehicle::{Effect, Kind, Vehicle};

use super::BlindError;
use super::detect::{Judge, kappa, lambda};
use super::draft::{self, Draft};
use super::facts::Facts;
use super::nearest::nearest;
use super::outside::Outside;
use super::plan::Plan;
use super::random::Dice;
use super::scene::Scene;
use super::strange;

/// A scene with what is hidden in it.
pub(crate) struct Hiding {
    pub scene: Scene,
    pub effects: Vec<Effect>,
    pub outside: Option<Outside>,
    /// Detectability of each.
    pub lambdas: Vec<f64>,
    /// For an effect outside the table: the one of the table that is most like it, and how much.
    pub nearest: Option<(String, f64)>,
}

/// An effect outside the table is drawn anew when one of the table is as like it as this.
const TOO_NEAR: f64 = 0.9;

/// What the record of a scene shows of an effect.
pub(crate) struct Stage {
    pub facts: Facts,
    judge: Judge,
    /// The record without hidden effects.
    pub clean: Vec<f64>,
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

    /// What the difference of two records tells.
    pub fn signature(&self, with: &[f64], without: &[f64]) -> Vec<f64> {
        self.judge.signature(difference(with, without))
    }

    /// A judge to whom the scatter of an effect is noise.
    fn beside(&self, scene: &Scene, other: &Effect) -> Judge {
        let vehicle = &scene.nominal.vehicle;
        let mut noise = scene.noise.clone();
        let more = match other.kind() {
            Kind::Noise => other.parameter("std").unwrap_or(0.0),
            Kind::Quantization => other.parameter("step").unwrap_or(0.0) / 12.0f64.sqrt(),
            _ => 0.0,
        };
        if let Some(i) = vehicle.output_index(other.place()) {
            noise.std[i] = noise.std[i].hypot(more);
        }
        Judge::new(vehicle, &noise, &scene.x0, &scene.commands)
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

fn difference(with: &[f64], without: &[f64]) -> Vec<f64> {
    with.iter().zip(without).map(|(a, b)| a - b).collect()
}

/// Values that a rounded channel shows, at least: with fewer it is a switch, or stands still.
const LEVELS: usize = 4;

/// Whether a rounded channel of a record still moves from level to level.
fn moves(effect: &Effect, vehicle: &Vehicle, record: &[f64]) -> bool {
    if effect.kind() != Kind::Quantization {
        return true;
    }
    let Some(i) = vehicle.output_index(effect.place()) else { return true };
    let channel = record.iter().skip(i).step_by(vehicle.outputs.len());
    let levels: std::collections::HashSet<u64> = channel.map(|y| (y + 0.0).to_bits()).collect();
    levels.len() >= LEVELS
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
    mut detectability: impl FnMut(f64) -> Result<f64, BlindError>,
) -> Result<Fitted, BlindError> {
    let mut size = (sizes.0 * sizes.1).sqrt();
    let mut power = 2.0;
    let mut last: Option<(f64, f64)> = None;
    for round in 0.. {
        let lambda = detectability(size)?;
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

/// Detectability of an effect by what it changes.
fn detectability(kind: Kind, judge: &Judge, change: Vec<f64>) -> f64 {
    if kind == Kind::Turbulence { judge.random(change) } else { lambda(&judge.signature(change)) }
}

/// A factor for the commands that would bring the detectability to the target, where the size could not.
fn missing(lambda: f64, target: f64) -> Option<f64> {
    let ratio = target / lambda.max(1e-9);
    (!(0.3..3.0).contains(&ratio)).then(|| ratio.sqrt().clamp(0.1, 10.0))
}

/// Draws an effect's place and sizes it; `None` where the vehicle has no place for it.
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
    let detectability = |size: f64| -> Result<f64, BlindError> {
        let change = difference(&scene.record(&[of(size)?], None)?, &stage.clean);
        Ok(detectability(kind, &stage.judge, change))
    };
    let fitted = if draft.fixed {
        Fitted { size: fixed, lambda: detectability(fixed)? }
    } else {
        fit(sizes, target, detectability)?
    };
    let effect = of(fitted.size)?;
    let record = scene.record(std::slice::from_ref(&effect), None)?;
    Ok(moves(&effect, &scene.nominal.vehicle, &record).then_some((effect, fitted)))
}

fn at(draft: &Draft, size: f64) -> Result<Effect, BlindError> {
    draft.at(size).map_err(BlindError::effect)
}

/// Hides the plan's effect; `None` when this scene has no place for it or cannot show it.
pub(crate) fn single(plan: &Plan, mut scene: Scene, attempt: u32) -> Result<Option<Hiding>, BlindError> {
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
        let lambdas = vec![fitted.lambda];
        return Ok(Some(Hiding { scene, effects: vec![effect], outside: None, lambdas, nearest: None }));
    }
    Ok(None)
}

/// Hides the plan's two effects so that neither masks the other.
pub(crate) fn pair(plan: &Plan, mut scene: Scene, attempt: u32) -> Result<Option<Hiding>, BlindError> {
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
        let Some(lambdas) = beside(&scene, &stage, [&one, &two], &both)? else { return Ok(None) };
        if lambdas.iter().any(|l| *l < 30.0) || !stage.bounded(&both) {
            return Ok(None);
        }
        let lambdas = lambdas.to_vec();
        return Ok(Some(Hiding { scene, effects: vec![one, two], outside: None, lambdas, nearest: None }));
    }
    Ok(None)
}

/// Detectability of each of two effects beside the other; `None` where one masks the other.
fn beside(
    scene: &Scene,
    stage: &Stage,
    [one, two]: [&Effect; 2],
    both: &[f64],
) -> Result<Option<[f64; 2]>, BlindError> {
    if !scatters(one) && !scatters(two) {
        // Each as it acts where the other is.
        let of_one = difference(both, &scene.record(std::slice::from_ref(two), None)?);
        let of_two = difference(both, &scene.record(std::slice::from_ref(one), None)?);
        let masked = kappa(&stage.judge.signature(of_one.clone()), &stage.judge.signature(of_two.clone()));
        let own = |of: &Effect, change: Vec<f64>| {
            (1.0 - masked * masked) * detectability(of.kind(), &stage.judge, change)
        };
        return Ok((masked <= 0.7).then(|| [own(one, of_one), own(two, of_two)]));
    }
    // What scatters single samples is to the other one more noise, and shows by itself.
    let own = |of: &Effect, other: &Effect| -> Result<f64, BlindError> {
        let record = scene.record(std::slice::from_ref(of), None)?;
        Ok(detectability(of.kind(), &stage.beside(scene, other), difference(&record, &stage.clean)))
    };
    Ok(Some([own(one, two)?, own(two, one)?]))
}

/// Whether an effect touches samples one by one.
fn scatters(effect: &Effect) -> bool {
    matches!(effect.kind(), Kind::Noise | Kind::Quantization | Kind::Dropouts | Kind::Outliers)
}

/// Hides an effect outside the table, well above the noise.
pub(crate) fn outside(plan: &Plan, mut scene: Scene, attempt: u32) -> Result<Option<Hiding>, BlindError> {
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
            Ok(lambda(&stage.signature(&scene.record(&[], Some(&of(size)))?, &stage.clean)))
        })?;
        if let Some(factor) = missing(fitted.lambda, target)
            && scene.rescale(factor)
        {
            continue;
        }
        let outside = of(fitted.size);
        let record = scene.record(&[], Some(&outside))?;
        if fitted.lambda < 100.0 || !stage.bounded(&record) {
            return Ok(None);
        }
        let nearest = nearest(&stage.signature(&record, &stage.clean), &scene, &stage)?;
        if nearest.as_ref().is_some_and(|(_, alike)| *alike > TOO_NEAR) {
            return Ok(None);
        }
        let lambdas = vec![fitted.lambda];
        return Ok(Some(Hiding { scene, effects: Vec::new(), outside: Some(outside), lambdas, nearest }));
    }
    Ok(None)
}
