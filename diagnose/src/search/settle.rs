//! Tests of the terms that a search has found, each beside all others: exchanged for better ones, removed when the others
//! suffice.

use crate::thresholds::{FOUND_AGAIN_SHARE, MAX_EXCHANGES, RIDER_SHARE};

use crate::data::record::Data;
use crate::model::fit::{Effort, Fit, Model};
use crate::model::optimum::ModelError;
use crate::search::acceptance::{Decision, Rival, TermEvidence, decide, rivals};
use crate::search::agreement::{Contradicted, contradicted};
use crate::search::alternative::{Alternative, SearchSpace, fitted, joined};
use crate::search::equivalence::{is_twin, simpler, single, yields};
use crate::search::merge::merged;
use crate::search::selection::{Accepted, Refused};
use crate::search::survey_cache::{SurveyCache, Surveyed};
use crate::search::without::without;

/// State of a search: the model with the terms accepted so far.
pub(super) struct Search<'r, 'd, 's> {
    pub model: Model<'r, 'd>,
    pub fit: Fit,
    pub space: &'s SearchSpace<'s>,
    pub surveys: SurveyCache,
    /// Largest number of candidates tested at once, for which probabilities are corrected.
    pub hypotheses: usize,
    pub refused: Vec<Refused>,
}

/// What the tests of the terms have led to so far.
#[derive(Default)]
struct Contests {
    /// Number of terms that were exchanged or merged.
    exchanges: usize,
    /// Rivals for which a term was dropped: a survey beside other terms may not have fitted them.
    won: Vec<Rival>,
}

impl<'r, 'd> Search<'r, 'd, '_> {
    /// Tests every term beside all others, exchanges it where a rival is better, and drops it where the
    /// others suffice; repeats after every change. Returns the evidence of the remaining terms.
    pub fn settle(&mut self) -> Result<Vec<Accepted>, ModelError> {
        let mut accepted = Vec::new();
        let mut contests = Contests::default();
        while accepted.len() < self.model.terms.len() {
            let kept = self.tested(accepted.len(), &mut contests)?;
            let changed = kept.is_none();
            accepted.extend(kept);
            let all = accepted.len() == self.model.terms.len();
            if changed || all && self.changed_as_a_whole(&accepted, &mut contests)? {
                accepted.clear();
            }
        }
        Ok(accepted)
    }

    /// Tests a term beside all others: what it is accepted with, or `None` where it was exchanged or dropped.
    fn tested(&mut self, term: usize, contests: &mut Contests) -> Result<Option<Accepted>, ModelError> {
        let (reduced, rest) = without(&self.model, &self.fit, term)?;
        let own = own_alternative(&reduced, &rest, &self.model, &self.fit, term);
        let evidence = own.as_ref().and_then(|own| self.evidence(&reduced, &rest, own));
        let (Some(own), Some(evidence)) = (own, evidence) else {
            (self.model, self.fit) = (reduced, rest);
            return Ok(None);
        };
        let known = self.known(&reduced, &rest, &own, &contests.won);
        let rivals = rivals(&reduced, &rest, &own, &known);
        if contests.exchanges < MAX_EXCHANGES
            && let Some(better) = self.better(&reduced, &rest, &own, &rivals)
        {
            contests.exchanges += 1;
            (self.model, self.fit) = better;
            return Ok(None);
        }
        if let Some(rival) = self.excluding(&reduced, &rest, &own, &rivals) {
            let why = format!(
                "{} explains as much with a different signature (gains in BIC differ by {:.1}, similarity of signatures {:.2})",
                rival.candidate.name(),
                rival.gap.abs(),
                rival.kappa
            );
            contests.won.push(rival.clone());
            self.refused.insert(0, Refused { contested: true, ..Refused::new(own, why) });
            (self.model, self.fit) = (reduced, rest);
            return Ok(None);
        }
        Ok(Some(Accepted { evidence, rivals }))
    }

    /// Candidates beside the other terms, with their fits; those that won a contest before are fitted in any case.
    fn known(
        &mut self,
        reduced: &Model<'_, '_>,
        rest: &Fit,
        own: &Alternative,
        won: &[Rival],
    ) -> Vec<Surveyed> {
        if self.space.watch.is_stopped() {
            return Vec::new();
        }
        let mut known = self.surveys.known(reduced, rest, self.space);
        let is_fitted =
            |r: &&Rival| known.iter().any(|k| k.values.is_some() && k.candidate.name() == r.candidate.name());
        let missing = won.iter().filter(|r| !is_fitted(r));
        let fitted = missing.filter_map(|r| in_its_place(reduced, rest, own, r));
        let fitted: Vec<Surveyed> = fitted.map(|alternative| Surveyed::from(&alternative)).collect();
        known.extend(fitted);
        known
    }

    /// The model with the first rival to which a term yields in the term's place, where it passes the tests.
    fn better(
        &self,
        reduced: &Model<'r, 'd>,
        rest: &Fit,
        own: &Alternative,
        rivals: &[Rival],
    ) -> Option<(Model<'r, 'd>, Fit)> {
        let data = self.model.free_run.data;
        let kind = own.candidate.kind;
        let rival = rivals.iter().find(|r| yields((kind, own.delta_bic), r.candidate.kind, r.gap, data))?;
        let better = in_its_place(reduced, rest, own, rival)?;
        self.evidence(reduced, rest, &better)?;
        better.whole(reduced, rest)
    }

    /// A rival that explains as much with another signature, so that neither can be named.
    fn excluding<'v>(
        &self,
        reduced: &Model<'_, '_>,
        rest: &Fit,
        own: &Alternative,
        rivals: &'v [Rival],
    ) -> Option<&'v Rival> {
        let data = self.model.free_run.data;
        // An undetermined rival does not explain as much.
        let determined = |r: &&Rival| {
            let fitted = in_its_place(reduced, rest, own, r);
            let decision = fitted.map(|t| decide(reduced, rest, &t, self.hypotheses));
            !matches!(decision, Some(Decision::Undetermined(_)))
        };
        // Of two causes that a short record cannot distinguish, either is named if it is the only cause;
        // beside another cause, a second one is less likely a priori than none.
        let alone = self.model.terms.len() == 1;
        // A twin that is as good as the preferred one says nothing against it.
        let excluding = |r: &&Rival| {
            let twin = is_twin((r.candidate.kind, own.delta_bic - r.gap), own.candidate.kind, -r.gap, data);
            !twin && if alone { r.excludes() } else { r.is_as_good() }
        };
        rivals.iter().filter(excluding).find(determined)
    }

    /// Merges terms, or drops one, once each has passed beside the others; true where it did.
    fn changed_as_a_whole(
        &mut self,
        accepted: &[Accepted],
        contests: &mut Contests,
    ) -> Result<bool, ModelError> {
        if contests.exchanges < MAX_EXCHANGES
            && let Some(merged) = merged(&self.model, &self.fit, self.space, self.hypotheses)?
        {
            contests.exchanges += 1;
            (self.model, self.fit) = merged;
            return Ok(true);
        }
        if let Some(rider) = rider(accepted, self.model.free_run.data) {
            (self.model, self.fit) = without(&self.model, &self.fit, rider)?;
            return Ok(true);
        }
        // While it was in the model, it kept others from explaining the noise that it stands for.
        let Some(Contradicted { term, why }) = contradicted(&self.model, &self.fit) else { return Ok(false) };
        let (reduced, rest) = without(&self.model, &self.fit, term)?;
        if let Some(own) = own_alternative(&reduced, &rest, &self.model, &self.fit, term) {
            self.refused.insert(0, Refused::new(own, why));
        }
        (self.model, self.fit) = (reduced, rest);
        Ok(true)
    }

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
pub(super) fn own_alternative(
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
