//! Cache of surveys.

use crate::candidates::library::Candidate;
use crate::model::fit::{Fit, Model};
use crate::search::alternative::{Alternative, SearchSpace};
use crate::search::survey::survey;
use crate::thresholds::REMEMBERED;

/// A surveyed candidate without its fit, which would need much memory.
#[derive(Debug, Clone)]
pub(crate) struct Surveyed {
    pub candidate: Candidate,
    /// Values of the fitted model, the candidate's last; `None` when it was not worth a fit.
    pub values: Option<Vec<f64>>,
    /// Gain in BIC.
    pub delta_bic: f64,
    /// Twice the gain in log-likelihood.
    pub ratio: f64,
}

impl From<&Alternative> for Surveyed {
    fn from(alternative: &Alternative) -> Self {
        let values = alternative.optimum.as_ref().map(|f| f.values.clone());
        Self {
            candidate: alternative.candidate.clone(),
            values,
            delta_bic: alternative.delta_bic,
            ratio: alternative.ratio,
        }
    }
}

/// Results of surveys by the terms of the model: the search returns to the same terms in the end.
#[derive(Debug, Default)]
pub(crate) struct SurveyCache(Vec<(Vec<Candidate>, Vec<Surveyed>)>);

/// True for the same effects with the same free parameters in the same order, so that fitted values
/// correspond.
fn same(a: &[Candidate], b: &[Candidate]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.is_same(b))
}

impl SurveyCache {
    /// Surveys candidates and stores the result.
    pub fn survey(&mut self, model: &Model<'_, '_>, fit: &Fit, space: &SearchSpace<'_>) -> Vec<Alternative> {
        let alternatives = survey(model, fit, space);
        let seen = alternatives.iter().map(Surveyed::from).collect();
        self.0.retain(|(known, _)| !same(known, &model.terms));
        self.0.push((model.terms.clone(), seen));
        alternatives
    }

    /// Candidates that ranked high beside any terms.
    pub fn likely(&self, library: &[Candidate]) -> Vec<Candidate> {
        let front: std::collections::HashSet<String> = self
            .0
            .iter()
            .flat_map(|(_, seen)| seen.iter().take(REMEMBERED).map(|s| s.candidate.name()))
            .collect();
        library.iter().filter(|c| front.contains(&c.name())).cloned().collect()
    }

    /// The stored survey beside these terms; surveys where none is stored.
    pub fn known(&mut self, model: &Model<'_, '_>, fit: &Fit, space: &SearchSpace<'_>) -> Vec<Surveyed> {
        if !self.0.iter().any(|(known, _)| same(known, &model.terms)) {
            self.survey(model, fit, space);
        }
        let known = self.0.iter().find(|(known, _)| same(known, &model.terms));
        known.map_or_else(Vec::new, |(_, seen)| seen.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::same;
    use crate::candidates::library::{Candidate, Sizes, library};
    use whirlstand_vehicle::{Kind, Vehicle};

    /// A one-sided limit has another number of values, with another meaning, than two-sided limits.
    #[test]
    fn variants_of_one_effect_and_other_orders_are_not_the_same_terms() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let present: Vec<usize> = (0..vehicle.outputs.len()).collect();
        let all = library(&vehicle, &Sizes::ones(&vehicle, 20.0, 0.02), &present);
        let of = |kind: Kind| -> Vec<Candidate> { all.iter().filter(|c| c.kind == kind).cloned().collect() };
        let limits = of(Kind::InputSaturation);
        let first: Vec<&Candidate> = limits.iter().filter(|c| c.place == limits[0].place).collect();
        assert_eq!(first.len(), 3, "both limits, the upper one, the lower one");
        for (i, a) in first.iter().enumerate() {
            for (j, b) in first.iter().enumerate() {
                assert_eq!(same(&[(*a).clone()], &[(*b).clone()]), i == j, "{a:?} and {b:?}");
            }
        }
        let (a, b) = (of(Kind::InputGain)[0].clone(), limits[0].clone());
        assert!(same(&[a.clone(), b.clone()], &[a.clone(), b.clone()]));
        assert!(!same(&[a.clone(), b.clone()], &[b, a]));
    }
}
