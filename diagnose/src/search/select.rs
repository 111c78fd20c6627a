//! Stepwise selection of causes: added one by one, exchanged for better ones, removed when the others
//! suffice.

use crate::thresholds::{
    FOUND_AGAIN_SHARE, MAX_EXCHANGES, MAX_GUSTS, MIN_BIC_GAIN, OVERSHADOWED_BIC, RIDER_SHARE,
};
use whirlstand_vehicle::Kind;

use crate::candidates::library::Candidate;
use crate::data::record::Data;
use crate::model::fit::{Effort, Fit, Model};
use crate::model::noise::Noise;
use crate::model::optimum::ModelError;
use crate::search::acceptance::{Decision, Rival, TermEvidence, decide, rivals};
use crate::search::agreement::{Contradicted, contradicted};
use crate::search::alternative::{Alternative, SearchSpace, fitted, joined};
use crate::search::equivalence::{is_twin, lead, simpler, single, yields};
use crate::search::merge::merged;
use crate::search::selection::{Accepted, Refused, Selection};
use crate::search::survey::survey;
use crate::search::survey_cache::{SurveyCache, Surveyed};
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
    let mut start = vec![0.0; model.states()];
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

/// State of a search: the model with the terms accepted so far.
struct Search<'r, 'd, 's> {
    model: Model<'r, 'd>,
    fit: Fit,
    space: &'s SearchSpace<'s>,
    surveys: SurveyCache,
    /// Largest number of candidates tested at once, for which probabilities are corrected.
    hypotheses: usize,
    refused: Vec<Refused>,
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

    /// Tests every term beside all others, exchanges it where a rival is better, and drops it where the
    /// others suffice; repeats after every change. Returns the evidence of the remaining terms.
    fn settle(&mut self) -> Result<Vec<Accepted>, ModelError> {
        let mut accepted = Vec::new();
        let mut exchanges = 0;
        // Rivals for which a term was dropped: a survey beside other terms may not have fitted them.
        let mut contested: Vec<Rival> = Vec::new();
        while accepted.len() < self.model.terms.len() {
            let term = accepted.len();
            let (reduced, rest) = without(&self.model, &self.fit, term)?;
            let own = own_alternative(&reduced, &rest, &self.model, &self.fit, term);
            let evidence = own.as_ref().and_then(|own| self.evidence(&reduced, &rest, own));
            let (Some(own), Some(evidence)) = (own, evidence) else {
                (self.model, self.fit) = (reduced, rest);
                accepted.clear();
                continue;
            };
            let mut known = Vec::new();
            if !self.space.watch.is_stopped() {
                known = self.surveys.known(&reduced, &rest, self.space);
                let missing = contested.iter().filter(|r| {
                    !known.iter().any(|k| k.values.is_some() && k.candidate.name() == r.candidate.name())
                });
                let fitted = missing.filter_map(|r| in_its_place(&reduced, &rest, &own, r));
                let fitted: Vec<Surveyed> = fitted.map(|alternative| Surveyed::from(&alternative)).collect();
                known.extend(fitted);
            }
            let rivals = rivals(&reduced, &rest, &own, &known);
            let data = self.model.free_run.data;
            let better = rivals
                .iter()
                .find(|r| yields((own.candidate.kind, own.delta_bic), r.candidate.kind, r.gap, data))
                .filter(|_| exchanges < MAX_EXCHANGES)
                .and_then(|rival| in_its_place(&reduced, &rest, &own, rival))
                .filter(|t| self.evidence(&reduced, &rest, t).is_some());
            if let Some(better) = better.and_then(|better| better.whole(&reduced, &rest)) {
                exchanges += 1;
                (self.model, self.fit) = better;
                accepted.clear();
                continue;
            }
            // An undetermined rival does not explain as much.
            let determined = |r: &&Rival| {
                let fitted = in_its_place(&reduced, &rest, &own, r);
                let decision = fitted.map(|t| decide(&reduced, &rest, &t, self.hypotheses));
                !matches!(decision, Some(Decision::Undetermined(_)))
            };
            // Of two causes that a short record cannot distinguish, either is named if it is the only cause;
            // beside another cause, a second one is less likely a priori than none.
            let alone = self.model.terms.len() == 1;
            // A twin that is as good as the preferred one says nothing against it.
            let excluding = |r: &&Rival| {
                let twin =
                    is_twin((r.candidate.kind, own.delta_bic - r.gap), own.candidate.kind, -r.gap, data);
                !twin && if alone { r.excludes() } else { r.is_as_good() }
            };
            if let Some(rival) = rivals.iter().filter(excluding).find(determined) {
                let why = format!(
                    "{} explains as much with a different signature (gains in BIC differ by {:.1}, similarity of signatures {:.2})",
                    rival.candidate.name(),
                    rival.gap.abs(),
                    rival.kappa
                );
                contested.push(rival.clone());
                self.refused.insert(0, Refused { contested: true, ..Refused::new(own, why) });
                (self.model, self.fit) = (reduced, rest);
                accepted.clear();
                continue;
            }
            accepted.push(Accepted { evidence, rivals });
            if accepted.len() == self.model.terms.len()
                && exchanges < MAX_EXCHANGES
                && let Some((model, fit)) = merged(&self.model, &self.fit, self.space, self.hypotheses)?
            {
                exchanges += 1;
                (self.model, self.fit) = (model, fit);
                accepted.clear();
                continue;
            }
            if accepted.len() == self.model.terms.len()
                && let Some(rider) = rider(&accepted, self.model.free_run.data)
            {
                (self.model, self.fit) = without(&self.model, &self.fit, rider)?;
                accepted.clear();
            }
            // While it was in the model, it kept others from explaining the noise that it stands for.
            if accepted.len() == self.model.terms.len()
                && let Some(Contradicted { term, why }) = contradicted(&self.model, &self.fit)
            {
                let (reduced, rest) = without(&self.model, &self.fit, term)?;
                if let Some(own) = own_alternative(&reduced, &rest, &self.model, &self.fit, term) {
                    self.refused.insert(0, Refused::new(own, why));
                }
                (self.model, self.fit) = (reduced, rest);
                accepted.clear();
            }
        }
        Ok(accepted)
    }
}

impl<'r, 'd> Search<'r, 'd, '_> {
    /// Evidence for an alternative that is accepted: its own, or with one input and one output that of the twin to which it
    /// is preferred. As the record cannot tell the two apart, what speaks for either speaks for both.
    fn evidence(&self, model: &Model<'_, '_>, fit: &Fit, own: &Alternative) -> Option<TermEvidence> {
        let data = model.free_run.data;
        let decision = |alternative: &Alternative| decide(model, fit, alternative, self.hypotheses);
        match decision(own) {
            Decision::Accepted(evidence) => return Some(evidence),
            Decision::Refused(_) if single(data) => {}
            Decision::Refused(_) | Decision::Undetermined(_) => return None,
        }
        let values = &own.optimum.as_ref()?.values;
        let twins = self.space.library.iter().filter_map(|candidate| {
            let (kind, _) = simpler(candidate.kind, 0.0, data)?;
            (kind == own.candidate.kind).then_some(())?;
            joined(model, fit, candidate, values.clone(), Effort::Full)
        });
        let twin = |twin: &Alternative| {
            let gap = twin.delta_bic - own.delta_bic;
            is_twin((twin.candidate.kind, twin.delta_bic), own.candidate.kind, gap, data)
        };
        twins.filter(twin).find_map(|twin| match decision(&twin) {
            Decision::Accepted(evidence) => Some(evidence),
            _ => None,
        })
    }
}

/// The smallest cause, where its gain is so small beside the largest that it may only correct the latter's
/// shape: motors are not exactly first-order lags. Where the noise is declared and the vehicle runs free, the
/// lack-of-fit test detects such a misfit instead.
fn rider(accepted: &[Accepted], data: &Data) -> Option<usize> {
    let declared = data.channels.iter().all(|c| c.declared > 0.0);
    (data.memory_s.is_some() || !declared).then_some(())?;
    let gain = |i: &usize| accepted[*i].evidence.delta_bic;
    let least = (0..accepted.len()).min_by(|a, b| gain(a).total_cmp(&gain(b)))?;
    let largest = (0..accepted.len()).map(|i| gain(&i)).fold(0.0, f64::max);
    (gain(&least) < RIDER_SHARE * largest).then_some(least)
}

/// A term of a model as an alternative beside the others, refitted from where these end up without it. Where
/// that refit is lost (an input that never moves), from the current values.
fn own_alternative(
    reduced: &Model<'_, '_>,
    without: &Fit,
    model: &Model<'_, '_>,
    fit: &Fit,
    term: usize,
) -> Option<Alternative> {
    let candidate = &model.terms[term];
    let mut values = fit.values.clone();
    let own: Vec<f64> = values.drain(model.range(term)).collect();
    let kept = without.profile.bic(0) - fit.profile.bic(candidate.tunables.len());
    let again = fitted(reduced, without, candidate, own.clone());
    if again.as_ref().is_some_and(|t| t.delta_bic > FOUND_AGAIN_SHARE * kept) {
        return again;
    }
    values.extend(own);
    joined(reduced, without, candidate, values, Effort::Full)
}

/// Fits a rival in a cause's place: other values start from those fitted with the cause.
fn in_its_place(
    reduced: &Model<'_, '_>,
    without: &Fit,
    own: &Alternative,
    rival: &Rival,
) -> Option<Alternative> {
    let fitted = &own.optimum.as_ref()?.values;
    let others = fitted.len() - own.candidate.tunables.len();
    let values = fitted[..others].iter().chain(&rival.values).copied().collect();
    joined(reduced, without, &rival.candidate, values, Effort::Full)
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
