//! Correlations of the estimation errors of the causes' parameters.

use super::schema::{Correlation, ParameterPlace};
use crate::stages::findings::Findings;

/// Correlations of the errors of all fitted parameters, each pair once (Cramer-Rao bound at the fit). Empty
/// where the record does not determine them.
pub(crate) fn correlations(findings: &Findings<'_>) -> Vec<Correlation> {
    let (model, fit) = (&findings.residual.selection.model, &findings.residual.selection.fit);
    let Ok(covariance) = model.covariance(fit) else { return Vec::new() };
    let mut fitted: Vec<(usize, ParameterPlace)> = Vec::new();
    for (term, candidate) in model.terms.iter().enumerate() {
        for (at, tunable) in model.range(term).zip(&candidate.tunables) {
            let place = ParameterPlace {
                effect: candidate.kind.name().into(),
                place: candidate.place.clone(),
                parameter: tunable.name.into(),
            };
            fitted.push((at, place));
        }
    }
    let mut all = Vec::new();
    for (k, (i, first)) in fitted.iter().enumerate() {
        for (j, second) in &fitted[k + 1..] {
            let size = (covariance[(*i, *i)] * covariance[(*j, *j)]).sqrt();
            let coefficient = covariance[(*i, *j)] / size;
            if coefficient.is_finite() {
                all.push(Correlation {
                    between: [first.clone(), second.clone()],
                    coefficient: coefficient.clamp(-1.0, 1.0),
                });
            }
        }
    }
    all
}
