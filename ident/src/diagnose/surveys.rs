//! What was surveyed already.

use super::library::Candidate;
use super::model::{Fit, Model};
use super::survey::{Scene, Trial, survey};

/// Candidates of each survey that may take another's place later.
const LIKELY: usize = 30;

/// A surveyed candidate, without the weight of its fit.
#[derive(Debug, Clone)]
pub(super) struct Seen {
    pub candidate: Candidate,
    /// Values of the fitted model, the candidate's last; `None` when it was not worth a fit.
    pub values: Option<Vec<f64>>,
    /// Gain in BIC.
    pub delta_bic: f64,
    /// Twice the gain in log-likelihood.
    pub ratio: f64,
}

impl From<&Trial> for Seen {
    fn from(trial: &Trial) -> Self {
        let values = trial.fit.as_ref().map(|f| f.values.clone());
        Self { candidate: trial.candidate.clone(), values, delta_bic: trial.delta_bic, ratio: trial.ratio }
    }
}

/// What was surveyed beside which terms: the search comes back to the same terms in the end.
#[derive(Debug, Default)]
pub(super) struct Surveys(Vec<(Vec<Candidate>, Vec<Seen>)>);

/// The same effects, with the same values open, in the same order: then fitted values mean the same.
fn same(a: &[Candidate], b: &[Candidate]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.is_same(b))
}

impl Surveys {
    /// Surveys, and remembers.
    pub fn survey(&mut self, model: &Model<'_, '_>, fit: &Fit, scene: &Scene<'_>) -> Vec<Trial> {
        let trials = survey(model, fit, scene);
        let seen = trials.iter().map(Seen::from).collect();
        self.0.retain(|(known, _)| !same(known, &model.terms));
        self.0.push((model.terms.clone(), seen));
        trials
    }

    /// Candidates that were near the front beside any terms.
    pub fn likely(&self, library: &[Candidate]) -> Vec<Candidate> {
        let front: std::collections::HashSet<String> = self
            .0
            .iter()
            .flat_map(|(_, seen)| seen.iter().take(LIKELY).map(|s| s.candidate.name()))
            .collect();
        library.iter().filter(|c| front.contains(&c.name())).cloned().collect()
    }

    /// What was surveyed beside these terms; surveys where nothing was.
    pub fn known(&mut self, model: &Model<'_, '_>, fit: &Fit, scene: &Scene<'_>) -> Vec<Seen> {
        if !self.0.iter().any(|(known, _)| same(known, &model.terms)) {
            self.survey(model, fit, scene);
        }
        let known = self.0.iter().find(|(known, _)| same(known, &model.terms));
        known.map_or_else(Vec::new, |(_, seen)| seen.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::same;
    use crate::diagnose::library::{Candidate, Sizes, library};
    use whirlstand_vehicle::{Kind, Vehicle};

    /// Values beside a limit of one side have another number, and mean something else, than beside limits of both.
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
