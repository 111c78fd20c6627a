//! Hides effects in an experiment, with sizes chosen for a given detectability.

use whirlstand_vehicle::{Effect, Kind, Vehicle};

use super::baseline::{Baseline, difference};
use super::detect::{Detector, kappa, lambda};
use super::draft::{self, Draft};
use super::error::BlindError;
use super::experiment::Experiment;
use super::nearest::nearest;
use super::out_of_library::{OutOfLibrary, OutOfLibraryEffect};
use super::out_of_library_draft;
use super::plan::Plan;
use super::random::RandomStream;

/// An experiment and the effects that are hidden in it.
pub(crate) struct HiddenTruth {
    pub experiment: Experiment,
    pub effects: Vec<Effect>,
    pub outside: Option<OutOfLibraryEffect>,
    /// Detectability of each hidden effect.
    pub lambdas: Vec<f64>,
    /// For an effect outside the table: the most similar effect of the table, and their similarity.
    pub nearest: Option<(String, f64)>,
}

/// Similarity to an effect of the table above which an effect outside the table is rejected and drawn anew.
const TOO_SIMILAR: f64 = 0.9;

impl HiddenTruth {
    /// Flies a closed-loop experiment again with the hidden effects, since the control law then gives other
    /// commands. `None` where the effects are no longer detectable in the record.
    pub fn flown(mut self) -> Result<Option<Self>, BlindError> {
        // A relay keeps its state from one period to the next; a chain of single periods does not.
        let relay = self.outside.as_ref().is_some_and(|o| o.kind == OutOfLibrary::InputRelay);
        if self.experiment.control.is_none() {
            return Ok(Some(self));
        }
        if relay {
            return Ok(None);
        }
        let outside = self.outside.as_ref();
        self.experiment.commands = self.experiment.commanded(&self.effects, outside)?;
        let baseline = Baseline::new(&self.experiment)?;
        let record = self.experiment.record(&self.effects, outside)?;
        if !baseline.bounded(&record) {
            return Ok(None);
        }
        let change = difference(&record, &baseline.clean);
        let (lambdas, least) = match (self.effects.as_slice(), outside) {
            ([effect], _) => (vec![detectability(effect.kind(), &baseline.detector, change)], 3.0),
            ([one, two], _) => match joint_detectability(&self.experiment, &baseline, [one, two], &record)? {
                Some(lambdas) => (lambdas.to_vec(), 30.0),
                None => return Ok(None),
            },
            (_, Some(_)) => (vec![lambda(&baseline.detector.signature(change))], 100.0),
            _ => (Vec::new(), 0.0),
        };
        if let (Some(_), Some(_)) = (outside, &self.nearest) {
            let signature = baseline.signature(&record, &baseline.clean);
            self.nearest = nearest(&signature, &self.experiment, &baseline)?;
            if self.nearest.as_ref().is_some_and(|(_, alike)| *alike > TOO_SIMILAR) {
                return Ok(None);
            }
        }
        self.lambdas = lambdas;
        Ok(self.lambdas.iter().all(|lambda| *lambda >= least).then_some(self))
    }
}

/// Least number of distinct values of a quantized channel: with fewer it acts as a switch or is constant.
const LEVELS: usize = 4;

/// Whether the quantized channel of a record still takes at least `LEVELS` distinct values.
fn moves(effect: &Effect, vehicle: &Vehicle, record: &[f64]) -> bool {
    if effect.kind() != Kind::Quantization {
        return true;
    }
    let Some(i) = vehicle.output_index(effect.place()) else { return true };
    let channel = record.iter().skip(i).step_by(vehicle.outputs.len());
    let levels: std::collections::HashSet<u64> = channel.map(|y| (y + 0.0).to_bits()).collect();
    levels.len() >= LEVELS
}

/// A size of an effect, and the detectability at this size.
struct FittedSize {
    size: f64,
    lambda: f64,
}

/// Iterates on the size within its range until the detectability is near the target.
fn fit(
    sizes: (f64, f64),
    target: f64,
    mut detectability: impl FnMut(f64) -> Result<f64, BlindError>,
) -> Result<FittedSize, BlindError> {
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
            return Ok(FittedSize { size, lambda });
        }
        size = next;
    }
    unreachable!("the loop ends by its own rounds")
}

/// Detectability of an effect, computed from its change of the record.
fn detectability(kind: Kind, detector: &Detector, change: Vec<f64>) -> f64 {
    if kind == Kind::Turbulence { detector.random(change) } else { lambda(&detector.signature(change)) }
}

/// A factor on the commands that would bring the detectability to the target, where the size alone could not.
fn command_factor(lambda: f64, target: f64) -> Option<f64> {
    let ratio = target / lambda.max(1e-9);
    (!(0.3..3.0).contains(&ratio)).then(|| ratio.sqrt().clamp(0.1, 10.0))
}

/// Draws an effect's place and fits its size; `None` where the vehicle has no place for it.
fn place(
    kind: Kind,
    experiment: &Experiment,
    baseline: &Baseline,
    target: f64,
    stream: &mut RandomStream,
) -> Result<Option<(Effect, FittedSize)>, BlindError> {
    let Some(draft) = draft::draft(
        kind,
        &experiment.nominal.vehicle,
        &baseline.facts,
        &experiment.noise,
        &experiment.ranges.effects,
        stream,
    ) else {
        return Ok(None);
    };
    let fixed = stream.scaled(draft.sizes.0, draft.sizes.1);
    // The lower limit is drawn, so that some effects are large and the excitation small instead.
    let (least, most) = draft.sizes;
    let sizes = (stream.scaled(least, (least * least * most).cbrt()), most);
    let of = |size: f64| at(&draft, size);
    let detectability = |size: f64| -> Result<f64, BlindError> {
        let change = difference(&experiment.record(&[of(size)?], None)?, &baseline.clean);
        Ok(detectability(kind, &baseline.detector, change))
    };
    let fitted = if draft.fixed {
        FittedSize { size: fixed, lambda: detectability(fixed)? }
    } else {
        fit(sizes, target, detectability)?
    };
    let effect = of(fitted.size)?;
    let record = experiment.record(std::slice::from_ref(&effect), None)?;
    Ok(moves(&effect, &experiment.nominal.vehicle, &record).then_some((effect, fitted)))
}

fn at(draft: &Draft, size: f64) -> Result<Effect, BlindError> {
    draft.at(size).map_err(BlindError::effect)
}

/// Hides the plan's effect; `None` when the experiment has no place for it or cannot show it.
pub(crate) fn single(
    plan: &Plan,
    mut experiment: Experiment,
    attempt: u32,
) -> Result<Option<HiddenTruth>, BlindError> {
    let Some(&kind) = plan.effects.first() else { return Ok(None) };
    let mut target = RandomStream::new(plan.number, "target");
    let target = target.scaled(10.0, 2e4);
    for _ in 0..4 {
        let baseline = Baseline::new(&experiment)?;
        let mut stream = RandomStream::new(plan.number, &format!("effect {attempt}"));
        let Some((effect, fitted)) = place(kind, &experiment, &baseline, target, &mut stream)? else {
            return Ok(None);
        };
        if let Some(factor) = command_factor(fitted.lambda, target)
            && experiment.rescale(factor)
        {
            continue;
        }
        if fitted.lambda < 3.0 || !baseline.bounded(&experiment.record(std::slice::from_ref(&effect), None)?)
        {
            return Ok(None);
        }
        let lambdas = vec![fitted.lambda];
        return Ok(Some(HiddenTruth {
            experiment,
            effects: vec![effect],
            outside: None,
            lambdas,
            nearest: None,
        }));
    }
    Ok(None)
}

/// Hides the plan's two effects such that neither masks the other.
pub(crate) fn pair(
    plan: &Plan,
    mut experiment: Experiment,
    attempt: u32,
) -> Result<Option<HiddenTruth>, BlindError> {
    let &[first, second] = plan.effects.as_slice() else { return Ok(None) };
    for _ in 0..3 {
        let baseline = Baseline::new(&experiment)?;
        let mut stream = RandomStream::new(plan.number, &format!("effects {attempt}"));
        let targets = (stream.scaled(60.0, 1e4), stream.scaled(60.0, 1e4));
        let Some((one, fitted)) = place(first, &experiment, &baseline, targets.0, &mut stream)? else {
            return Ok(None);
        };
        if let Some(factor) = command_factor(fitted.lambda, targets.0)
            && experiment.rescale(factor)
        {
            continue;
        }
        let Some((two, _)) = place(second, &experiment, &baseline, targets.1, &mut stream)? else {
            return Ok(None);
        };
        let both = experiment.record(&[one.clone(), two.clone()], None)?;
        let Some(lambdas) = joint_detectability(&experiment, &baseline, [&one, &two], &both)? else {
            return Ok(None);
        };
        if lambdas.iter().any(|l| *l < 30.0) || !baseline.bounded(&both) {
            return Ok(None);
        }
        let lambdas = lambdas.to_vec();
        return Ok(Some(HiddenTruth {
            experiment,
            effects: vec![one, two],
            outside: None,
            lambdas,
            nearest: None,
        }));
    }
    Ok(None)
}

/// Detectability of each of two effects in the presence of the other; `None` where one masks the other.
fn joint_detectability(
    experiment: &Experiment,
    baseline: &Baseline,
    [one, two]: [&Effect; 2],
    both: &[f64],
) -> Result<Option<[f64; 2]>, BlindError> {
    if !scatters(one) && !scatters(two) {
        // The change of each effect in the presence of the other.
        let of_one = difference(both, &experiment.record(std::slice::from_ref(two), None)?);
        let of_two = difference(both, &experiment.record(std::slice::from_ref(one), None)?);
        let masked =
            kappa(&baseline.detector.signature(of_one.clone()), &baseline.detector.signature(of_two.clone()));
        let own = |of: &Effect, change: Vec<f64>| {
            (1.0 - masked * masked) * detectability(of.kind(), &baseline.detector, change)
        };
        return Ok((masked <= 0.7).then(|| [own(one, of_one), own(two, of_two)]));
    }
    // An effect that scatters single samples counts as additional noise for the other, and is detectable by
    // itself.
    let own = |of: &Effect, other: &Effect| -> Result<f64, BlindError> {
        let record = experiment.record(std::slice::from_ref(of), None)?;
        Ok(detectability(
            of.kind(),
            &baseline.detector_with_noise_of(experiment, other),
            difference(&record, &baseline.clean),
        ))
    };
    Ok(Some([own(one, two)?, own(two, one)?]))
}

/// Whether an effect scatters single samples.
fn scatters(effect: &Effect) -> bool {
    matches!(effect.kind(), Kind::Noise | Kind::Quantization | Kind::Dropouts | Kind::Outliers)
}

/// Hides an effect outside the table, well above the noise.
pub(crate) fn outside(
    plan: &Plan,
    mut experiment: Experiment,
    attempt: u32,
) -> Result<Option<HiddenTruth>, BlindError> {
    let Some(range) = plan.outside_range() else { return Ok(None) };
    let target = RandomStream::new(plan.number, "target").scaled(300.0, 3e4);
    for _ in 0..4 {
        let baseline = Baseline::new(&experiment)?;
        let mut stream = RandomStream::new(plan.number, &format!("outside {attempt}"));
        let Some((sizes, unit)) =
            out_of_library_draft::draft(range, &baseline.facts, &experiment.noise, &mut stream)
        else {
            return Ok(None);
        };
        let of = |size: f64| OutOfLibraryEffect { size: size * unit.size, ..unit.clone() };
        let fitted = fit(sizes, target, |size| {
            Ok(lambda(&baseline.signature(&experiment.record(&[], Some(&of(size)))?, &baseline.clean)))
        })?;
        if let Some(factor) = command_factor(fitted.lambda, target)
            && experiment.rescale(factor)
        {
            continue;
        }
        let outside = of(fitted.size);
        let record = experiment.record(&[], Some(&outside))?;
        if fitted.lambda < 100.0 || !baseline.bounded(&record) {
            return Ok(None);
        }
        let nearest = nearest(&baseline.signature(&record, &baseline.clean), &experiment, &baseline)?;
        if nearest.as_ref().is_some_and(|(_, alike)| *alike > TOO_SIMILAR) {
            return Ok(None);
        }
        let lambdas = vec![fitted.lambda];
        return Ok(Some(HiddenTruth {
            experiment,
            effects: Vec::new(),
            outside: Some(outside),
            lambdas,
            nearest,
        }));
    }
    Ok(None)
}
