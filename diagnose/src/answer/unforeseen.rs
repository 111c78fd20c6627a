//! Outputs that the vehicle with all causes fails to predict.

use crate::answer::schema::Verdict;
use crate::screen;
use crate::stages::findings::Findings;

/// Reason for not calling a model with causes an explanation.
const UNFORESEEN: &str =
    "held-out data are predicted no better than by the mean or the last value at any horizon";

/// The held-out outputs that the vehicle with all causes fails to predict: all of them, or single outputs. Of a record
/// that is to be called consistent these are the ones predicted worse than by the mean or the last value; of one that is
/// explained, those that the mean over the held-out part predicts better as well: a cause may be right and its axis hardly
/// move.
pub(crate) fn unforeseen(findings: &Findings<'_>, verdict: Verdict) -> Option<String> {
    let data = findings.baseline.data();
    let selection = &findings.residual.selection;
    let Ok(vehicle) = selection.model.vehicle(&findings.values) else { return Some(UNFORESEEN.into()) };
    // A model in which nothing was fitted is validated on the whole record.
    let fitted = !selection.model.free.is_empty() || !selection.model.terms.is_empty();
    let from = if fitted { findings.gains.cut } else { 0 };
    let gains = &findings.gains.channels;
    let asked = |c: &usize| speaks_against(verdict, gains[*c].horizon.1.fit);
    let found = screen::foresight(&vehicle, data, from, (0..gains.len()).any(|c| asked(&c)));
    if !found.some {
        return Some(UNFORESEEN.into());
    }
    let name = |c: &usize| vehicle.outputs[data.channels[*c].output].name.clone();
    let names: Vec<String> = found.contradicted.iter().filter(|c| asked(c)).map(name).collect();
    let are = if names.len() == 1 { "is" } else { "are" };
    (!names.is_empty()).then(|| {
        format!(
            "{} {are} predicted worse than by the mean or the last value at one horizon, and not better at any",
            names.join(", ")
        )
    })
}

/// True when an output that is predicted worse than by the mean or the last value speaks against a verdict; `fit` is that
/// of its predictions over the held-out part, %.
fn speaks_against(verdict: Verdict, fit: Option<f64>) -> bool {
    verdict == Verdict::Consistent || fit.is_some_and(|fit| fit < 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A flight was called explained of which one axis was predicted with -373 %.
    #[test]
    fn an_axis_that_is_not_predicted_speaks_against_an_explanation_of_others() {
        assert!(speaks_against(Verdict::Explained, Some(-373.0)));
        assert!(!speaks_against(Verdict::Explained, Some(12.0)) && !speaks_against(Verdict::Explained, None));
        assert!(speaks_against(Verdict::Consistent, Some(12.0)) && speaks_against(Verdict::Consistent, None));
    }
}
