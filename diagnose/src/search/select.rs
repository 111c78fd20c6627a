//! The choice of causes: added one by one, exchanged while that is better, taken back when the rest does without.

use crate::thresholds::{FOUND_AGAIN_SHARE, MAX_EXCHANGES, MIN_BIC_GAIN, OVERSHADOWED_BIC, RIDER_SHARE};
use whirlstand_vehicle::Kind;

use crate::candidates::library::Candidate;
use crate::data::record::Data;
use crate::model::fit::{Effort, Fit, Model};
use crate::model::free_run::ModelError;
use crate::model::noise::Noise;
use crate::search::acceptance::{Decision, Rival, TermEvidence, decide, rivals};
use crate::search::alternative::{Alternative, SearchSpace, fitted, joined};
use crate::search::equivalence::{lead, yields};
use crate::search::mode_substitution::mode;
use crate::search::survey_cache::SurveyCache;

/// An accepted term.
#[derive(Debug, Clone, PartialEq)]
pub struct Accepted {
    /// Evidence.
    pub evidence: TermEvidence,
    /// Rivals, nearest first.
    pub rivals: Vec<Rival>,
}

/// What the search came to.
#[derive(Debug, Clone)]
pub struct Selection<'r, 'd> {
    /// The model with all accepted terms.
    pub model: Model<'r, 'd>,
    /// Its fit.
    pub fit: Fit,
    /// The fit without any term.
    pub null: Fit,
    /// Evidence of each term.
    pub accepted: Vec<Accepted>,
    /// Candidates beside the accepted ones that were not accepted, with reasons; nearest first.
    pub refused: Vec<(Alternative, String)>,
}

/// Searches for causes. Under one noise model for all channels, when one
/// is given, and from the given terms on, the free parameters as the vehicle has them.
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

/// A search on its way: the model with the terms so far.
struct Search<'r, 'd, 's> {
    model: Model<'r, 'd>,
    fit: Fit,
    space: &'s SearchSpace<'s>,
    surveys: SurveyCache,
    /// Candidates that were weighed at once, at most: what a probability by chance is corrected for.
    hypotheses: usize,
    refused: Vec<(Alternative, String)>,
}

impl Search<'_, '_, '_> {
    /// Adds the candidate that explains most of those that pass; `false` when there is none.
    fn add(&mut self) -> bool {
        if self.space.watch.is_stopped() {
            return false;
        }
        let alternatives = self.surveys.survey(&self.model, &self.fit, self.space);
        self.hypotheses = self.hypotheses.max(alternatives.len());
        self.refused = Vec::new();
        let left = self.hypotheses.saturating_sub(self.model.terms.len()).max(1);
        let lasting = alternatives.iter().find(|t| !is_event(&t.candidate)).map_or(0.0, |t| t.delta_bic);
        let mut best = None;
        for alternative in alternatives {
            // What explains less than one that was refused is no better for that; a gust explains a part of anything.
            if best.is_some() || alternative.delta_bic < lasting - OVERSHADOWED_BIC {
                self.refused.push((alternative, "others explain more".into()));
                continue;
            }
            match decide(&self.model, &self.fit, &alternative, left) {
                Decision::Accepted(_) if room(&self.model, &alternative.candidate, self.space.most) => {
                    best = Some(alternative);
                }
                Decision::Accepted(_) => {
                    let why = format!("{} causes were named already", self.space.most);
                    self.refused.push((alternative, why));
                }
                Decision::Refused(why) => self.refused.push((alternative, why)),
            }
        }
        let added = best.is_some();
        if let Some(Alternative { candidate, fit: Some(better), .. }) = best {
            self.model.terms.push(candidate);
            self.fit = better;
        }
        added
    }

    /// Tests every term beside all others, exchanges it where a rival is better, and drops it where the others do
    /// without; after every change from the first one on. The evidence of the terms that stay.
    fn settle(&mut self) -> Result<Vec<Accepted>, ModelError> {
        let mut accepted = Vec::new();
        let mut exchanges = 0;
        while accepted.len() < self.model.terms.len() {
            let term = accepted.len();
            let (reduced, without) = without(&self.model, &self.fit, term)?;
            let own = own_alternative(&reduced, &without, &self.model, &self.fit, term);
            let decision = own.as_ref().map(|own| decide(&reduced, &without, own, self.hypotheses));
            let (Some(own), Some(Decision::Accepted(evidence))) = (own, decision) else {
                (self.model, self.fit) = (reduced, without);
                accepted.clear();
                continue;
            };
            let mut known = Vec::new();
            if !self.space.watch.is_stopped() {
                known = self.surveys.known(&reduced, &without, self.space);
                known.extend(mode(&reduced, &without, &own, self.space));
            }
            let rivals = rivals(&reduced, &without, &own, &known);
            let data = self.model.free_run.data;
            let better = rivals
                .iter()
                .find(|r| yields((own.candidate.kind, own.delta_bic), r.candidate.kind, r.gap, data))
                .filter(|_| exchanges < MAX_EXCHANGES)
                .and_then(|rival| in_its_place(&reduced, &without, &own, rival))
                .filter(|t| matches!(decide(&reduced, &without, t, self.hypotheses), Decision::Accepted(_)));
            if let Some(Alternative { candidate, fit: Some(better), .. }) = better {
                exchanges += 1;
                self.model = reduced;
                self.model.terms.push(candidate);
                self.fit = better;
                accepted.clear();
                continue;
            }
            if let Some(rival) = rivals.iter().find(|r| r.is_undecided()) {
                let why = format!(
                    "{} explains as much, and the two do not look alike (gains in BIC differ by {:.1}, signatures alike to {:.2})",
                    rival.candidate.name(),
                    rival.gap.abs(),
                    rival.kappa
                );
                self.refused.insert(0, (own, why));
                (self.model, self.fit) = (reduced, without);
                accepted.clear();
                continue;
            }
            accepted.push(Accepted { evidence, rivals });
            if accepted.len() == self.model.terms.len()
                && let Some(rider) = rider(&accepted, self.model.free_run.data)
            {
                (self.model, self.fit) = self::without(&self.model, &self.fit, rider)?;
                accepted.clear();
            }
        }
        Ok(accepted)
    }
}

/// The least of the causes, where it gains so little beside the largest that it may only mend its shape: motors are no lag
/// of first order, nor is what a record of a real flight follows.
fn rider(accepted: &[Accepted], data: &Data) -> Option<usize> {
    data.memory_s?;
    let gain = |i: &usize| accepted[*i].evidence.delta_bic;
    let least = (0..accepted.len()).min_by(|a, b| gain(a).total_cmp(&gain(b)))?;
    let largest = (0..accepted.len()).map(|i| gain(&i)).fold(0.0, f64::max);
    (gain(&least) < RIDER_SHARE * largest).then_some(least)
}

impl<'r, 'd> Selection<'r, 'd> {
    /// A selection that has not looked for anything.
    ///
    /// # Errors
    /// When the vehicle cannot be simulated over the record.
    pub fn nothing(model: Model<'r, 'd>, start: Vec<f64>) -> Result<Self, ModelError> {
        let null = model.fit(start, None, None)?;
        Ok(Self { model, fit: null.clone(), null, accepted: Vec::new(), refused: Vec::new() })
    }
}

impl Selection<'_, '_> {
    /// The selection without its causes, fitted anew; `None` when there are none. A tone is believed whatever else there is.
    /// `start` are the values without any cause.
    pub fn without_causes(&self, start: Vec<f64>) -> Option<Self> {
        let tone = |c: &Candidate| c.kind == Kind::Vibration;
        self.model.terms.iter().any(|c| !tone(c)).then_some(())?;
        let mut kept = self.clone();
        kept.keep(tone);
        kept.fit.values.splice(..start.len(), start);
        kept.fit = kept.model.fit(kept.fit.values.clone(), self.fit.profile.noise.shared(), None).ok()?;
        Some(kept)
    }

    /// The selection without causes of which what is `left` is more than a misfit, fitted anew; `None` when there are none.
    pub fn beyond(&self, left: f64) -> Option<Self> {
        let enough = |a: &Accepted| RIDER_SHARE * a.evidence.detectability >= left;
        (!self.accepted.iter().all(enough)).then_some(())?;
        let mut kept = self.clone();
        let wanted: Vec<bool> = self.accepted.iter().map(enough).collect();
        kept.keep_terms(|term, _, _| wanted[term]);
        kept.fit = kept.model.fit(kept.fit.values.clone(), self.fit.profile.noise.shared(), None).ok()?;
        Some(kept)
    }

    /// Drops the terms that are not wanted, with their values and their evidence; the fit is not made anew.
    pub fn keep(&mut self, wanted: impl Fn(&Candidate) -> bool) {
        self.keep_terms(|_, candidate, _| wanted(candidate));
    }

    /// As [`Selection::keep`], by the number and the values too.
    pub fn keep_terms(&mut self, wanted: impl Fn(usize, &Candidate, &[f64]) -> bool) {
        for term in (0..self.model.terms.len()).rev() {
            let range = self.model.range(term);
            if !wanted(term, &self.model.terms[term], &self.fit.values[range.clone()]) {
                self.fit.values.drain(range);
                self.model.terms.remove(term);
                self.accepted.remove(term);
            }
        }
    }
}

/// The model without a term, fitted.
fn without<'r, 'd>(
    model: &Model<'r, 'd>,
    fit: &Fit,
    term: usize,
) -> Result<(Model<'r, 'd>, Fit), ModelError> {
    let mut reduced = model.clone();
    let range = model.range(term);
    reduced.terms.remove(term);
    let mut values = fit.values.clone();
    values.drain(range);
    let without = reduced.fit(values, fit.profile.noise.shared(), Some(&fit.columns[..model.states()]))?;
    Ok((reduced, without))
}

/// A term of a model as a alternative beside the others, found anew from where these end up without it. Where the way back from
/// there is lost (an input that never moves), from where the model is.
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

/// A rival in a cause's place: the other values start where the cause has left them.
fn in_its_place(
    reduced: &Model<'_, '_>,
    without: &Fit,
    own: &Alternative,
    rival: &Rival,
) -> Option<Alternative> {
    let fit = own.fit.as_ref()?;
    let others = fit.values.len() - own.candidate.tunables.len();
    let values = fit.values[..others].iter().chain(&rival.values).copied().collect();
    joined(reduced, without, &rival.candidate, values, Effort::Full)
}

/// Exchanges terms for better ones beside the others, and drops those that the others do without.
fn exchange(model: &mut Model<'_, '_>, fit: &mut Fit, space: &SearchSpace<'_>, surveys: &mut SurveyCache) {
    if model.terms.len() < 2 || space.watch.is_stopped() {
        return;
    }
    let data = model.free_run.data;
    let likely = surveys.likely(space.library);
    let space = &SearchSpace { library: &likely, ..*space };
    // The newest was the best beside the others already.
    let mut term = 0;
    while term + 1 < model.terms.len() {
        let Ok((reduced, without)) = without(model, fit, term) else { return };
        let own = own_alternative(&reduced, &without, model, fit, term);
        let own_bic = own.as_ref().map_or(f64::NEG_INFINITY, |t| t.delta_bic);
        let best = surveys.survey(&reduced, &without, space).into_iter().find(|t| t.fit.is_some());
        match best {
            Some(best)
                if best.delta_bic
                    > own_bic + lead((model.terms[term].kind, own_bic), best.candidate.kind, data)
                    && best.delta_bic > MIN_BIC_GAIN =>
            {
                let Some(better) = best.fit else { return };
                *model = reduced;
                model.terms.push(best.candidate);
                *fit = better;
            }
            _ if own_bic < MIN_BIC_GAIN => {
                *model = reduced;
                *fit = without;
            }
            _ => {}
        }
        term += 1;
    }
}

/// True for what happens once.
fn is_event(candidate: &Candidate) -> bool {
    matches!(candidate.kind, Kind::StepDisturbance | Kind::PulseDisturbance)
}

/// Whether one more cause may be named. Harmonics and aliases make several tones of one narrow-band noise: they count apart.
fn room(model: &Model<'_, '_>, candidate: &Candidate, most: usize) -> bool {
    let tone = |c: &Candidate| matches!(c.kind, Kind::Vibration | Kind::PeriodicDisturbance);
    model.terms.iter().filter(|t| tone(t) == tone(candidate)).count() < most
}
