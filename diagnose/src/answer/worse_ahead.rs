//! Causes that predict worse: whatever gains in likelihood, an extension that predicts held-out data worse than the
//! vehicle alone is none (cross-validation: Stone, J. R. Stat. Soc. B 36, 1974).

use whirlstand_logs::shown::number;

use crate::answer::gains::{Gain, Gains};
use crate::thresholds::{MIN_HELD_OUT_SIGMAS, WORSE_AHEAD_RATIO};

/// Reason to withhold causes with which the model, fitted to the first part of the record, predicts the rest worse
/// than without: all outputs together, by the mean logarithm of the ratio of their errors, and not by chance. `names`
/// are those of the outputs.
pub(crate) fn worse_ahead<'g>(names: impl Iterator<Item = &'g str>, gains: &'g Gains) -> Option<String> {
    let by_chance = gains.improvement.is_none_or(|sigmas| sigmas > -MIN_HELD_OUT_SIGMAS);
    if by_chance { None } else { worse(names.zip(&gains.channels), gains.heldout.horizon_s) }
}

fn worse<'g>(gains: impl Iterator<Item = (&'g str, &'g Gain)>, horizon_s: f64) -> Option<String> {
    let ratio = |gain: &Gain| {
        let (before, after) = gain.horizon;
        Some((after.rmse? / before.rmse?).ln()).filter(|ratio| ratio.is_finite())
    };
    let all: Vec<(&str, &Gain, f64)> =
        gains.filter_map(|(name, gain)| Some((name, gain, ratio(gain)?))).collect();
    let mean = all.iter().map(|(.., ratio)| ratio).sum::<f64>() / all.len().max(1) as f64;
    let told = |(name, gain, _): &(&str, &Gain, f64)| {
        let (before, after) = gain.horizon;
        Some(format!("{name} {:.1} % -> {:.1} %", before.fit?, after.fit?))
    };
    let worse: Vec<String> = all.iter().filter(|(.., ratio)| *ratio > 0.0).filter_map(told).collect();
    (mean > WORSE_AHEAD_RATIO.ln()).then(|| {
        format!(
            "fitted to the first part of the record, the model with what was found predicts the rest worse than without, over {} s: fit of {}",
            number(horizon_s),
            worse.join(", ")
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::answer::gains::Score;

    #[test]
    fn causes_with_which_the_rest_is_predicted_worse_are_withheld() {
        let score = |rmse: f64| Score { fit: Some(100.0 * (1.0 - rmse)), rmse: Some(rmse) };
        let gain = |before: f64, after: f64| Gain {
            free_run: None,
            horizon: (score(before), score(after)),
            floor: 0.01,
            noise_model_share: None,
        };
        let reason = |gains: &[Gain]| worse(["p", "q"].into_iter().zip(gains), 0.2);
        assert_eq!(reason(&[gain(0.3, 0.2), gain(0.3, 0.32)]), None, "one better, one a little worse");
        assert_eq!(reason(&[gain(0.3, 0.305), gain(0.3, 0.3)]), None, "as good");
        let told = reason(&[gain(0.3, 0.5), gain(0.3, 0.29)]).unwrap();
        assert!(told.ends_with("over 0.200 s: fit of p 70.0 % -> 50.0 %"), "{told}");
        let lost = Gain { horizon: (score(0.3), Score::default()), ..gain(0.3, 0.3) };
        assert_eq!(reason(&[lost]), None, "without samples");
    }
}
