//! Score of the predictions of one channel.

use std::ops::Range;

use whirlstand_logs::stats::{mean, rms};

use crate::data::record::Channel;

/// Scores of one channel's predictions.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Score {
    /// Fit, %; `None` when the channel does not change.
    pub fit: Option<f64>,
    /// Root of the mean square error; `None` without samples.
    pub rmse: Option<f64>,
}

/// Score of a channel's predictions from step `cut` on; samples without a prediction do not count.
pub(crate) fn score(channel: &Channel, predicted: &[f64], cut: usize) -> Score {
    score_within(channel, predicted, cut..usize::MAX)
}

/// Score of a channel's predictions within some steps; samples without a prediction do not count.
pub(crate) fn score_within(channel: &Channel, predicted: &[f64], steps: Range<usize>) -> Score {
    let rows = (0..channel.values.len())
        .filter(|k| channel.good[*k] && steps.contains(&channel.step(*k)) && predicted[*k].is_finite());
    let (measured, errors): (Vec<f64>, Vec<f64>) =
        rows.map(|k| (channel.values[k], channel.values[k] - predicted[k])).unzip();
    let middle = mean(&measured);
    let spread = rms(&measured.iter().map(|y| y - middle).collect::<Vec<_>>());
    let rmse = (!errors.is_empty()).then(|| rms(&errors));
    Score { fit: rmse.filter(|_| spread > 0.0).map(|e| 100.0 * (1.0 - e / spread)), rmse }
}

/// Prediction error power as a share of the power about the mean, 0 to 1: all of it without a prediction, and nothing of a
/// channel that does not change.
pub(crate) fn share(score: Score) -> f64 {
    match score {
        Score { fit: Some(fit), .. } => (1.0 - fit / 100.0).powi(2).min(1.0),
        Score { rmse: None, .. } => 1.0,
        Score { .. } => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::{Score, share};

    #[test]
    fn what_is_not_predicted_is_left_to_noise() {
        let of = |fit, rmse| share(Score { fit, rmse });
        assert_eq!(of(None, None), 1.0, "no prediction");
        assert_eq!(of(None, Some(0.1)), 0.0, "a channel that does not change");
        assert_eq!((of(Some(100.0), Some(0.0)), of(Some(-50.0), Some(2.0))), (0.0, 1.0));
    }
}
