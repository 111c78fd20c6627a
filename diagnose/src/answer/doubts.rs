//! Doubts about causes: values at the end of their range, factors that equal a ratio of units, and causes of next to
//! nothing.

use whirlstand_logs::shown::number;
use whirlstand_vehicle::Kind;

use crate::answer::gains::{Gain, mean_growth};
use crate::answer::schema::Cause;
use crate::candidates::Candidate;
use crate::residual::axis::Axis;
use crate::residual::excess_noise::louder_than_declared;
use crate::residual::narrow_band::fastest_pole_hz;
use crate::stages::findings::Findings;
use crate::thresholds::{
    AT_LIMIT_SHARE, CHANCE_FACTOR_SHARE, EXPLAINED_SHARE, GREATEST_PHYSICAL_FACTOR, RIDER_SHARE, UNIT_RATIOS,
    WORSE_AHEAD_RATIO,
};

/// Sentences on what speaks against accepting the causes as the explanation.
pub(crate) fn doubts(causes: &[Cause], findings: &Findings<'_>) -> Vec<String> {
    let selection = &findings.residual.selection;
    let mut doubts = Vec::new();
    for (term, candidate) in selection.model.terms.iter().enumerate() {
        doubts.extend(at_limits(candidate, &selection.fit.values[selection.model.range(term)]));
    }
    doubts.extend(causes.iter().filter_map(unit));
    let fastest_hz = fastest_pole_hz(&selection.model.free_run.vehicle);
    doubts.extend(causes.iter().filter_map(|cause| slow_vibration(cause, fastest_hz)));
    if !causes.is_empty() {
        let (vehicle, data) = (findings.baseline.vehicle(), findings.baseline.data());
        let names = data.channels.iter().map(|c| vehicle.outputs[c.output].name.as_str());
        let gains: Vec<_> = names.zip(&findings.gains.channels).collect();
        let axes: Vec<_> = Axis::all(selection).into_iter().map(|axis| axis.channels).collect();
        doubts.extend(worse_ahead(&gains, &axes, findings.gains.heldout.horizon_s));
    }
    // A filter that follows a record leaves noise, whatever is wrong.
    if findings.baseline.data().memory_s.is_some() {
        doubts.extend(next_to_nothing(causes));
    }
    if !causes.is_empty() {
        doubts.extend(left_to_noise(&findings.gains.channels));
        doubts.extend(left_beyond_noise(findings));
        let random = findings.residual.random_forces.iter();
        doubts.extend(random.map(|state| format!("a force of unknown course acts on {state}")));
    }
    doubts
}

/// Doubt about causes that leave more than noise, where neither noise nor turbulence is a cause: a noise model of any
/// spectrum would explain it, but not the declared size.
fn left_beyond_noise(findings: &Findings<'_>) -> Option<String> {
    let residual = &findings.residual;
    let baseline = findings.baseline;
    let louder = louder_than_declared(baseline.data(), &residual.selection.fit, &baseline.sizes.noise);
    let own = |c: usize| residual.noise.iter().any(|(channel, _)| *channel == c);
    let loudest = louder.into_iter().filter(|(c, _)| !own(*c)).max_by(|a, b| a.1.total_cmp(&b.1));
    let (c, times) = loudest.filter(|_| residual.turbulence.is_none())?;
    let output = &baseline.vehicle().outputs[baseline.data().channels[c].output];
    Some(format!("what is left of {} is {times:.1} times its declared noise", output.name))
}

/// Doubt about causes beside which undeclared noise has to explain nearly all of every output.
fn left_to_noise(gains: &[Gain]) -> Option<String> {
    let all =
        gains.iter().all(|gain| gain.noise_model_share.is_some_and(|share| share > 1.0 - EXPLAINED_SHARE));
    all.then(|| {
        format!(
            "beside them more than {:.0} % of every output is left to noise",
            100.0 * (1.0 - EXPLAINED_SHARE)
        )
    })
}

/// Doubt about causes that explain next to nothing of what a filter that follows the record leaves.
fn next_to_nothing(causes: &[Cause]) -> Option<String> {
    let explained: f64 = causes.iter().map(|cause| cause.evidence.share_of_residual).sum();
    let too_little = !causes.is_empty() && explained < RIDER_SHARE;
    too_little.then(|| format!("that is {:.1} % of the residual power", 100.0 * explained))
}

/// Doubt about causes with which the model, fitted to the first part of the record, predicts the rest worse, by the mean
/// logarithm of the ratio of the errors: of the outputs of a decoupled axis with causes, where the refit of another axis is
/// no gain of theirs, or of all outputs. Whatever gains in likelihood, an extension that predicts worse is none
/// (cross-validation: Stone, J. R. Stat. Soc. B 36, 1974). `axes` has the channels of each axis with causes.
fn worse_ahead(gains: &[(&str, &Gain)], axes: &[Vec<usize>], horizon_s: f64) -> Option<String> {
    let is_worse =
        |channels: &[usize]| mean_growth(channels.iter().map(|c| gains[*c].1)) > WORSE_AHEAD_RATIO.ln();
    let mut judged: Vec<usize> = axes.iter().filter(|axis| is_worse(axis)).flatten().copied().collect();
    let all: Vec<usize> = (0..gains.len()).collect();
    if judged.is_empty() && is_worse(&all) {
        judged = all;
    }
    let told = |c: &usize| {
        let (name, gain) = gains[*c];
        let (before, after) = gain.horizon;
        let is_worse = gain.growth()? > 0.0;
        is_worse.then_some(format!("{name} {:.1} % -> {:.1} %", before.fit?, after.fit?))
    };
    let worse: Vec<String> = judged.iter().filter_map(told).collect();
    (!judged.is_empty()).then(|| {
        format!(
            "fitted to the first part of the record, the model with them predicts the rest worse than without, over {} s: fit of {}",
            number(horizon_s),
            worse.join(", ")
        )
    })
}

/// Doubts about sizes of a cause that ended at a limit of their range.
fn at_limits(candidate: &Candidate, values: &[f64]) -> impl Iterator<Item = String> {
    candidate.tunables.iter().zip(values).filter(|(t, _)| t.size).filter_map(|(tunable, value)| {
        let near = AT_LIMIT_SHARE * (tunable.upper - tunable.lower);
        let end = [tunable.lower, tunable.upper].into_iter().find(|end| (value - end).abs() < near)?;
        // The end of a range at which the effect vanishes is not a limit to warn of.
        (end != candidate.null).then(|| {
            format!(
                "{} of {} on {} is at the limit of its allowed range, {}: the record calls for more than this effect can provide",
                tunable.name,
                candidate.kind.name(),
                candidate.place,
                number(end)
            )
        })
    })
}

/// Doubt about a vibration slower than the vehicle's fastest pole: there the vehicle itself moves, and a tone can be a motion
/// that the model lacks as well as one of the sensor alone.
fn slow_vibration(cause: &Cause, fastest_hz: f64) -> Option<String> {
    let frequency =
        cause.parameters.get("frequency_hz").filter(|_| cause.effect == Kind::Vibration.name())?;
    (frequency.value < fastest_hz).then(|| {
        format!(
            "the vibration of {} Hz on {} is slower than the vehicle itself, which moves up to {} Hz: it may be a motion that the model lacks",
            number(frequency.value),
            cause.place,
            number(fastest_hz)
        )
    })
}

/// Doubt about a factor that equals the ratio of two units.
fn unit(cause: &Cause) -> Option<String> {
    let scale = [Kind::InputGain, Kind::SensorScale].iter().any(|k| k.name() == cause.effect);
    let factor = cause.parameters.get("factor").filter(|_| scale)?;
    let close = factor.high - factor.low < CHANCE_FACTOR_SHARE * GREATEST_PHYSICAL_FACTOR;
    let narrow = factor.low > GREATEST_PHYSICAL_FACTOR || close && factor.low > 0.0;
    let ratio =
        UNIT_RATIOS.iter().flat_map(|r| [*r, 1.0 / r]).find(|r| factor.low < *r && *r < factor.high)?;
    narrow.then(|| {
        format!(
            "the factor of {} on {} is the ratio of two units, {}: check in which unit the column was recorded, and write it into the header or the mapping",
            cause.effect,
            cause.place,
            number(ratio)
        )
    })
}

#[cfg(test)]
mod tests {
    use whirlstand_logs::shown::ShownUnit;

    use super::*;
    use crate::answer::schema::{Estimate, Evidence};
    use crate::answer::score::Score;
    use crate::candidates::Tunable;

    fn cause(effect: &str, low: f64, high: f64) -> Cause {
        let factor = Estimate { value: 0.5 * (low + high), low, high, unit: ShownUnit::default() };
        Cause {
            effect: effect.into(),
            place: "u_roll".into(),
            parameters: [("factor".to_string(), factor)].into(),
            text: None,
            evidence: Evidence {
                delta_bic: 900.0,
                heldout_gain_sigma: 9.0,
                share_of_residual: 0.9,
                p_value: 0.0,
                detectability: 900.0,
            },
            indistinguishable: Vec::new(),
            notes: Vec::new(),
        }
    }

    #[test]
    fn causes_with_which_the_rest_is_predicted_worse_are_doubted() {
        let score = |rmse: f64| Score { fit: Some(100.0 * (1.0 - rmse)), rmse: Some(rmse) };
        let gain = |before: f64, after: f64| Gain {
            free_run: None,
            horizon: (score(before), score(after)),
            floor: 0.01,
            noise_model_share: None,
        };
        let judged = |gains: &[Gain], axes: &[Vec<usize>]| {
            let named: Vec<_> = ["p", "q"].into_iter().zip(gains).collect();
            worse_ahead(&named, axes, 0.2)
        };
        let doubt = |gains: &[Gain]| judged(gains, &[(0..gains.len()).collect()]);
        assert_eq!(doubt(&[gain(0.3, 0.2), gain(0.3, 0.32)]), None, "one better, one a little worse");
        assert_eq!(doubt(&[gain(0.3, 0.305), gain(0.3, 0.3)]), None, "as good");
        let told = doubt(&[gain(0.3, 0.5), gain(0.3, 0.29)]).unwrap();
        assert!(told.ends_with("over 0.200 s: fit of p 70.0 % -> 50.0 %"), "{told}");
        let lost = Gain { horizon: (score(0.3), Score::default()), ..gain(0.3, 0.3) };
        assert_eq!(doubt(&[lost]), None, "without samples");
        let one_better = [gain(0.3, 0.2), gain(0.3, 0.32)];
        let told = judged(&one_better, &[vec![1]]).unwrap();
        assert!(told.ends_with("fit of q 70.0 % -> 68.0 %"), "the other has no part in it: {told}");
        assert_eq!(judged(&one_better, &[vec![0]]), None, "a cause on the better axis");
        assert!(judged(&[gain(0.3, 0.5)], &[]).is_some(), "tones alone");
    }

    #[test]
    fn causes_that_leave_every_output_to_undeclared_noise_are_doubted() {
        let gain = |noise_model_share| Gain {
            free_run: None,
            horizon: Default::default(),
            floor: 0.01,
            noise_model_share,
        };
        assert!(left_to_noise(&[gain(Some(0.95)), gain(Some(1.0))]).unwrap().contains("more than 90 %"));
        assert_eq!(left_to_noise(&[gain(Some(0.95)), gain(Some(0.5))]), None, "one is predicted");
        assert_eq!(left_to_noise(&[gain(Some(0.95)), gain(None)]), None, "declared noise is no explanation");
    }

    #[test]
    fn a_size_at_an_end_of_its_range_is_doubted_unless_that_is_nothing() {
        let tunable = |name, size| Tunable { name, lower: 0.0, upper: 2.0, scale: 0.01, size };
        let late = Candidate {
            tunables: vec![tunable("delay_s", true), tunable("at_s", false)],
            ..Candidate::bare(Kind::InputDelay, "u_roll")
        };
        let told = |value: f64| at_limits(&late, &[value, 2.0]).collect::<Vec<_>>();
        assert_eq!(told(1.999).len(), 1, "a time that is no size is never at a limit");
        assert!(
            told(2.0)[0]
                .starts_with("delay_s of input_delay on u_roll is at the limit of its allowed range, 2.00")
        );
        assert!(told(1.99).is_empty() && told(0.0).is_empty());
    }

    #[test]
    fn a_vibration_slower_than_the_vehicle_is_doubted() {
        let told = |effect: &str, frequency_hz: f64| {
            let frequency =
                cause(effect, frequency_hz - 0.001, frequency_hz + 0.001).parameters["factor"].clone();
            slow_vibration(
                &Cause { parameters: [("frequency_hz".into(), frequency)].into(), ..cause(effect, 0.0, 0.0) },
                0.16,
            )
        };
        let doubt = told("vibration", 0.034).unwrap();
        assert!(doubt.starts_with("the vibration of 0.0340 Hz on u_roll is slower"), "{doubt}");
        assert!(doubt.contains("up to 0.160 Hz"), "{doubt}");
        assert_eq!(told("vibration", 0.17), None, "faster than the vehicle");
        assert_eq!(told("step_disturbance", 0.034), None, "a force moves the vehicle");
    }

    #[test]
    fn a_factor_that_no_part_has_and_a_pair_of_units_has_is_doubted() {
        let doubted = |effect: &str, low, high| unit(&cause(effect, low, high));
        let told = doubted("input_gain", 57.0, 57.6).unwrap();
        assert!(told.contains("input_gain on u_roll is the ratio of two units, 57.3"), "{told}");
        assert!(doubted("sensor_scale", 0.0174, 0.0175).is_some(), "a radian in degrees");
        // 1 / 3.6 can also be a weak actuator: only an estimate that would hardly be so close by chance is
        // doubted.
        assert!(doubted("input_gain", 0.27, 0.29).is_some());
        assert!(doubted("input_gain", 0.2, 0.35).is_none());
        assert!(doubted("input_gain", 57.4, 58.0).is_none() && doubted("input_gain", 1.9, 2.1).is_none());
        assert!(doubted("actuator_lag", 57.0, 57.6).is_none(), "a factor of something else");
    }

    #[test]
    fn causes_of_next_to_nothing_are_doubted() {
        let of = |shares: &[f64]| {
            let one = |share: &f64| {
                let mut cause = cause("input_gain", 0.7, 0.8);
                cause.evidence.share_of_residual = *share;
                cause
            };
            next_to_nothing(&shares.iter().map(one).collect::<Vec<_>>())
        };
        assert_eq!(of(&[0.001, 0.003]).unwrap(), "that is 0.4 % of the residual power");
        assert_eq!((of(&[0.015, 0.015]), of(&[])), (None, None));
    }
}
