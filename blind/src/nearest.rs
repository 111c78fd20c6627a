//! Similarity of an effect outside the table to the effects of the table: an effect that a table effect
//! imitates could rightly be named as such.

use whirlstand_vehicle::Kind;

use super::baseline::Baseline;
use super::detect::kappa;
use super::draft::draft;
use super::error::BlindError;
use super::experiment::Experiment;
use super::random::RandomStream;

/// Number of places and sizes that are tried for each effect.
const TRIES: usize = 3;

/// Effects of the table that are compared. Effects with a time or a frequency of their own are left out,
/// since they depend on no input and no state; random effects have no signature.
const COMPARED: [Kind; 20] = [
    Kind::InputDelay,
    Kind::ActuatorLag,
    Kind::InputGain,
    Kind::GainDrift,
    Kind::InputBias,
    Kind::DeadZone,
    Kind::InputSaturation,
    Kind::RateLimit,
    Kind::Backlash,
    Kind::InputCoupling,
    Kind::ParameterChange,
    Kind::QuadraticDrag,
    Kind::CoulombFriction,
    Kind::CubicStiffness,
    Kind::UnmodelledMode,
    Kind::SensorScale,
    Kind::SensorDelay,
    Kind::SensorLag,
    Kind::Misalignment,
    Kind::OutputSaturation,
];

/// The effect of the table whose signature is most similar to `signature`, and their similarity (|cos|).
pub(crate) fn nearest(
    signature: &[f64],
    experiment: &Experiment,
    baseline: &Baseline,
) -> Result<Option<(String, f64)>, BlindError> {
    let mut stream = RandomStream::new(experiment.number, "nearest");
    let mut best: Option<(String, f64)> = None;
    for kind in COMPARED {
        for _ in 0..TRIES {
            let vehicle = &experiment.nominal.vehicle;
            let ranges = &experiment.ranges.effects;
            let Some(draft) = draft(kind, vehicle, &baseline.facts, &experiment.noise, ranges, &mut stream)
            else {
                break;
            };
            let effect = draft.at(stream.scaled(draft.sizes.0, draft.sizes.1)).map_err(BlindError::effect)?;
            let own = match experiment.record(std::slice::from_ref(&effect), None) {
                Ok(record) => baseline.signature(&record, &baseline.clean),
                Err(BlindError::Diverged { .. }) => continue,
                Err(e) => return Err(e),
            };
            let alike = kappa(signature, &own);
            if best.as_ref().is_none_or(|(_, most)| alike > *most) {
                best = Some((format!("{}({})", effect.kind(), effect.place()), alike));
            }
        }
    }
    Ok(best)
}
