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

/// What was surveyed beside which terms: the search comes back to the same terms in the end.
#[derive(Debug, Default)]
pub(super) struct Surveys(Vec<(Vec<String>, Vec<Seen>)>);

impl Surveys {
    fn names(model: &Model<'_, '_>) -> Vec<String> {
        let mut names: Vec<String> = model.terms.iter().map(Candidate::name).collect();
        names.sort_unstable();
        names
    }

    /// Surveys, and remembers.
    pub fn survey(&mut self, model: &Model<'_, '_>, fit: &Fit, scene: &Scene<'_>) -> Vec<Trial> {
        let trials = survey(model, fit, scene);
        let seen = trials.iter().map(|t| Seen {
            candidate: t.candidate.clone(),
            values: t.fit.as_ref().map(|f| f.values.clone()),
            delta_bic: t.delta_bic,
            ratio: t.ratio,
        });
        let names = Self::names(model);
        self.0.retain(|(known, _)| *known != names);
        self.0.push((names, seen.collect()));
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
        let names = Self::names(model);
        if !self.0.iter().any(|(known, _)| *known == names) {
            self.survey(model, fit, scene);
        }
        self.0.iter().find(|(known, _)| *known == names).map_or_else(Vec::new, |(_, seen)| seen.clone())
    }
}
