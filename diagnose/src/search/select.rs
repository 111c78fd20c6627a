//! Stepwise selection of causes: added one by one, exchanged for better ones, then settled.

use crate::thresholds::{MAX_GUSTS, MIN_BIC_GAIN, OVERSHADOWED_BIC};
use whirlstand_vehicle::Kind;

use crate::candidates::library::Candidate;
use crate::model::fit::{Fit, Model};
use crate::model::noise::Noise;
use crate::model::optimum::ModelError;
use crate::search::acceptance::{Decision, decide};
use crate::search::alternative::{Alternative, SearchSpace};
use crate::search::equivalence::lead;
use crate::search::selection::{Refused, Selection};
use crate::search::settle::{Search, own_alternative};
use crate::search::survey::survey;
use crate::search::survey_cache::SurveyCache;
use crate::search::without::without;

/// Searches for causes, beginning with the given terms; under one noise model for all channels, when one is
/// given. Free parameters start from the vehicle's values.
///
/// # Errors
/// When the vehicle cannot be simulated over the record.
pub fn select<'r, 'd>(
    mut model: Model<'r, 'd>,
    space: &SearchSpace<'_>,
    noise: Option<&Noise>,
    begin: &[(Candidate, Vec<f64>)],
) -> Result<Selection<'r, 'd>, ModelError> {
    let mut start = model.free_run.start();
    start.extend(model.free.iter().map(|f| model.free_run.vehicle.free_value(&f.target)));
    let null = model.fit(start.clone(), noise, None)?;
    let mut fit = null.clone();
    if !begin.is_empty() {
        model.terms.extend(begin.iter().map(|(candidate, _)| candidate.clone()));
        start.extend(begin.iter().flat_map(|(_, values)| values));
        fit = model.fit(start, noise, None)?;
    }
    let mut search =
        Search { model, fit, space, surveys: SurveyCache::default(), hypotheses: 0, refused: Vec::new() };
    while search.add() {
        exchange(&mut search.model, &mut search.fit, space, &mut search.surveys);
    }
    let accepted = search.settle()?;
    Ok(Selection { model: search.model, fit: search.fit, null, accepted, refused: search.refused })
}

impl Search<'_, '_, '_> {
    /// Adds the passing candidate with the largest gain; `false` when there is none. A candidate that the
    /// record does not determine does not block others: these are tested again without it.
    fn add(&mut self) -> bool {
        if self.space.watch.is_stopped() {
            return false;
        }
        let mut alternatives = self.surveys.survey(&self.model, &self.fit, self.space);
        self.hypotheses = self.hypotheses.max(alternatives.len());
        self.refused = Vec::new();
        let mut library = self.space.library.to_vec();
        loop {
            let before = library.len();
            let best = self.best(alternatives, &mut library);
            if let Some(whole) = best.and_then(|best| best.whole(&self.model, &self.fit)) {
                (self.model, self.fit) = whole;
                return true;
            }
            if library.len() == before || self.space.watch.is_stopped() {
                return false;
            }
            let space = SearchSpace { library: &library, ..*self.space };
            alternatives = survey(&self.model, &self.fit, &space);
        }
    }

    /// The first alternative that passes; all others are refused. Candidates that are not determined and mask
    /// others leave the library.
    fn best(&mut self, alternatives: Vec<Alternative>, library: &mut Vec<Candidate>) -> Option<Alternative> {
        let left = self.hypotheses.saturating_sub(self.model.terms.len()).max(1);
        let mut overshadowing = f64::NEG_INFINITY;
        let mut best = None;
        for alternative in alternatives {
            if best.is_some() || alternative.delta_bic < overshadowing - OVERSHADOWED_BIC {
                self.refuse(alternative, "other candidates explain more".into());
                continue;
            }
            let decision = decide(&self.model, &self.fit, &alternative, left);
            // A candidate that explains much less than a refused one is not credible either. Exceptions: a
            // gust explains a part of anything, and an undetermined candidate explains nothing for certain.
            if !alternative.candidate.is_event() && !matches!(decision, Decision::Undetermined(_)) {
                overshadowing = overshadowing.max(alternative.delta_bic);
            }
            match decision {
                Decision::Accepted(_) if room(&self.model.terms, &alternative.candidate, self.space.most) => {
                    best = Some(alternative);
                }
                Decision::Accepted(_) => {
                    let why = "as many causes of this kind as are looked for were already found".into();
                    self.refuse(alternative, why);
                }
                Decision::Undetermined(why) => {
                    // While it is in the library, candidates with a smaller gain were not even fitted.
                    let hides = alternative.delta_bic > OVERSHADOWED_BIC;
                    library.retain(|c| !hides || c.name() != alternative.candidate.name());
                    self.refuse(alternative, why);
                }
                Decision::Refused(why) => self.refuse(alternative, why),
            }
        }
        best
    }

    /// Records why an alternative was refused, once per candidate.
    fn refuse(&mut self, alternative: Alternative, why: String) {
        let name = alternative.candidate.name();
        if let Some(at) = self.refused.iter().position(|t| t.candidate.name() == name) {
            self.refused.remove(at);
        }
        self.refused.push(Refused::new(alternative, why));
    }
}

/// Exchanges terms for better ones beside the others, and drops those without which the others suffice.
fn exchange(model: &mut Model<'_, '_>, fit: &mut Fit, space: &SearchSpace<'_>, surveys: &mut SurveyCache) {
    if model.terms.len() < 2 || space.watch.is_stopped() {
        return;
    }
    let data = model.free_run.data;
    let likely = surveys.likely(space.library);
    let space = &SearchSpace { library: &likely, ..*space };
    // The newest term was already the best beside the others.
    let mut term = 0;
    while term + 1 < model.terms.len() {
        let Ok((reduced, rest)) = without(model, fit, term) else { return };
        let own = own_alternative(&reduced, &rest, model, fit, term);
        let own_bic = own.as_ref().map_or(f64::NEG_INFINITY, |t| t.delta_bic);
        let alternatives = surveys.survey(&reduced, &rest, space).into_iter();
        let mut better = alternatives.filter(|t| {
            let lead = lead((model.terms[term].kind, own_bic), t.candidate.kind, data);
            t.optimum.is_some() && t.delta_bic > MIN_BIC_GAIN.max(own_bic + lead)
        });
        let best = better.find(|t| !matches!(decide(&reduced, &rest, t, 1), Decision::Undetermined(_)));
        match best {
            Some(best) => {
                let Some(better) = best.whole(&reduced, &rest) else { return };
                (*model, *fit) = better;
            }
            _ if own_bic < MIN_BIC_GAIN => {
                *model = reduced;
                *fit = rest;
            }
            _ => {}
        }
        term += 1;
    }
}

/// True when one more cause may be named. Harmonics and aliases make several tones of one narrow-band noise:
/// tones are counted separately. Many forces on one state are a random one.
fn room(terms: &[Candidate], candidate: &Candidate, most: usize) -> bool {
    let tone = |c: &Candidate| matches!(c.kind, Kind::Vibration | Kind::PeriodicDisturbance);
    let beside = terms.iter().filter(|t| t.is_gust() && t.place == candidate.place);
    if candidate.is_gust() && beside.count() >= MAX_GUSTS {
        return false;
    }
    terms.iter().filter(|t| tone(t) == tone(candidate)).count() < most
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gusts of one record were taken for ten pushes and tones, which took four minutes.
    #[test]
    fn many_pushes_on_one_state_are_not_looked_for() {
        let of = |kind, place| Candidate::bare(kind, place);
        let rate = |kind| of(kind, "rate");
        let gusts =
            [rate(Kind::PulseDisturbance), rate(Kind::StepDisturbance), rate(Kind::PeriodicDisturbance)];
        for kind in [Kind::PulseDisturbance, Kind::StepDisturbance, Kind::PeriodicDisturbance] {
            assert!(room(&gusts[1..], &rate(kind), 5) && room(&gusts, &of(kind, "angle"), 5));
            assert!(!room(&gusts, &rate(kind), 5));
        }
        assert!(room(&gusts, &rate(Kind::QuadraticDrag), 3) && !room(&gusts, &rate(Kind::QuadraticDrag), 2));
    }
}
