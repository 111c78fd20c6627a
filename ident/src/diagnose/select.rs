//! The choice of causes: added one by one, exchanged while that is better, taken back when the rest does without.

use whirlstand_vehicle::Kind;

use super::judge::{ALIKE, Judgement, LEAST_BIC, Rival, Weight, judge, rivals};
use super::library::Candidate;
use super::model::{Effort, Fit, Model};
use super::modes::mode;
use super::noise::Noise;
use super::survey::{Scene, Trial, fitted, joined};
use super::surveys::Surveys;
use super::twins::{lead, yields};

/// Causes that are named, at most.
pub const MOST: usize = 5;
/// Difference in BIC from which on a candidate is not believed beside a better one that was refused.
pub const OVERSHADOWED: f64 = 30.0;
/// Difference in BIC below which two causes that do not look alike cannot both be excluded: odds of about seven to one.
const UNDECIDED: f64 = 4.0;
/// A term is found again when it gains this share of what it gained in the model.
const FOUND: f64 = 0.5;
/// Exchanges for better rivals in the end, at most.
const EXCHANGES: usize = 6;

/// An accepted term.
#[derive(Debug, Clone, PartialEq)]
pub struct Accepted {
    /// Evidence.
    pub weight: Weight,
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
    pub refused: Vec<(Trial, String)>,
}

/// Searches for causes. Under one noise model for all channels, when one
/// is given, and from the given terms on, the free parameters as the vehicle has them.
///
/// `None` when the vehicle cannot be simulated over the record.
pub fn select<'r, 'd>(
    mut model: Model<'r, 'd>,
    scene: &Scene<'_>,
    noise: Option<&Noise>,
    begin: &[(Candidate, Vec<f64>)],
) -> Option<Selection<'r, 'd>> {
    let (states, data) = (model.states(), model.runner.data);
    let mut start = vec![0.0; states];
    start.extend(model.free.iter().map(|f| model.runner.vehicle.free_value(&f.target)));
    let null = model.fit(start.clone(), noise, None)?;
    let mut fit = null.clone();
    if !begin.is_empty() {
        model.terms.extend(begin.iter().map(|(candidate, _)| candidate.clone()));
        start.extend(begin.iter().flat_map(|(_, values)| values));
        fit = model.fit(start, noise, None)?;
    }
    let mut refused;
    let mut surveys = Surveys::default();
    let mut hypotheses = 0;
    loop {
        let trials = surveys.survey(&model, &fit, scene);
        hypotheses = hypotheses.max(trials.len());
        refused = Vec::new();
        let mut best = None;
        let left = hypotheses.saturating_sub(model.terms.len()).max(1);
        let lasting = trials.iter().find(|t| !is_event(&t.candidate)).map_or(0.0, |t| t.delta_bic);
        for trial in trials {
            // What explains less than one that was refused is no better for that; a gust explains a part of anything.
            if best.is_some() || trial.delta_bic < lasting - OVERSHADOWED {
                refused.push((trial, "others explain more".into()));
                continue;
            }
            match judge(&model, &fit, &trial, left) {
                Judgement::Accepted(_) if room(&model, &trial.candidate, scene.most) => best = Some(trial),
                Judgement::Accepted(_) => {
                    refused.push((trial, format!("{} causes were named already", scene.most)))
                }
                Judgement::Refused(why) => refused.push((trial, why)),
            }
        }
        let added = best.is_some();
        if let Some(Trial { candidate, fit: Some(better), .. }) = best {
            model.terms.push(candidate);
            fit = better;
        }
        if !added {
            break;
        }
        exchange(&mut model, &mut fit, scene, &mut surveys);
    }
    let mut accepted = Vec::new();
    let mut term = 0;
    let mut exchanges = 0;
    while term < model.terms.len() {
        let (reduced, without) = without(&model, &fit, term)?;
        let mut trials = surveys.known(&reduced, &without, scene);
        let own = own_trial(&reduced, &without, &model, &fit, term);
        match own.as_ref().map(|own| judge(&reduced, &without, own, hypotheses)) {
            Some(Judgement::Accepted(weight)) => {
                let own = own?;
                trials.extend(mode(&reduced, &without, &own, scene));
                let rivals = rivals(&reduced, &without, &own, &trials);
                let better = rivals
                    .iter()
                    .find(|r| yields((own.candidate.kind, own.delta_bic), r.candidate.kind, r.gap, data))
                    .filter(|_| exchanges < EXCHANGES);
                let trial = better.and_then(|r| in_its_place(&reduced, &without, &own, r));
                let judged = trial.map(|t| (judge(&reduced, &without, &t, hypotheses), t));
                if let Some((Judgement::Accepted(_), Trial { candidate, fit: Some(better), .. })) = judged {
                    exchanges += 1;
                    model = reduced;
                    model.terms.push(candidate);
                    fit = better;
                    accepted.truncate(0);
                    term = 0;
                    continue;
                }
                if let Some(rival) = rivals.iter().find(|r| r.gap < UNDECIDED && r.kappa <= ALIKE) {
                    let why = format!(
                        "{} explains as much, and the two do not look alike (gains in BIC differ by {:.1}, signatures alike to {:.2})",
                        rival.candidate.name(),
                        rival.gap.abs(),
                        rival.kappa
                    );
                    refused.insert(0, (own, why));
                    (model, fit) = (reduced, without);
                    accepted.truncate(0);
                    term = 0;
                    continue;
                }
                accepted.push(Accepted { weight, rivals });
                term += 1;
            }
            _ => {
                (model, fit) = (reduced, without);
                accepted.truncate(0);
                term = 0;
            }
        }
    }
    Some(Selection { model, fit, null, accepted, refused })
}

impl<'r, 'd> Selection<'r, 'd> {
    /// A selection that has not looked for anything.
    pub fn nothing(model: Model<'r, 'd>, start: Vec<f64>) -> Option<Self> {
        let null = model.fit(start, None, None)?;
        Some(Self { model, fit: null.clone(), null, accepted: Vec::new(), refused: Vec::new() })
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
        kept.fit = kept.model.fit(kept.fit.values.clone(), self.fit.profile.noise.shared(), None)?;
        Some(kept)
    }

    /// Drops the terms that are not wanted, with their values and their evidence; the fit is not made anew.
    pub fn keep(&mut self, wanted: impl Fn(&Candidate) -> bool) {
        for term in (0..self.model.terms.len()).rev() {
            if !wanted(&self.model.terms[term]) {
                let range = self.model.range(term);
                self.fit.values.drain(range);
                self.model.terms.remove(term);
                self.accepted.remove(term);
            }
        }
    }
}

/// The model without a term, fitted.
fn without<'r, 'd>(model: &Model<'r, 'd>, fit: &Fit, term: usize) -> Option<(Model<'r, 'd>, Fit)> {
    let mut reduced = model.clone();
    let range = model.range(term);
    reduced.terms.remove(term);
    let mut values = fit.values.clone();
    values.drain(range);
    let without = reduced.fit(values, fit.profile.noise.shared(), Some(&fit.columns[..model.states()]))?;
    Some((reduced, without))
}

/// A term of a model as a trial beside the others, found anew from where these end up without it. Where the way back from
/// there is lost (an input that never moves), from where the model is.
fn own_trial(
    reduced: &Model<'_, '_>,
    without: &Fit,
    model: &Model<'_, '_>,
    fit: &Fit,
    term: usize,
) -> Option<Trial> {
    let candidate = &model.terms[term];
    let mut values = fit.values.clone();
    let own: Vec<f64> = values.drain(model.range(term)).collect();
    let kept = without.profile.bic(0) - fit.profile.bic(candidate.tunables.len());
    let again = fitted(reduced, without, candidate, own.clone());
    if again.as_ref().is_some_and(|t| t.delta_bic > FOUND * kept) {
        return again;
    }
    values.extend(own);
    joined(reduced, without, candidate, values, Effort::Full)
}

/// A rival in a cause's place: the other values start where the cause has left them.
fn in_its_place(reduced: &Model<'_, '_>, without: &Fit, own: &Trial, rival: &Rival) -> Option<Trial> {
    let fit = own.fit.as_ref()?;
    let others = fit.values.len() - own.candidate.tunables.len();
    let values = fit.values[..others].iter().chain(&rival.values).copied().collect();
    joined(reduced, without, &rival.candidate, values, Effort::Full)
}

/// Exchanges terms for better ones beside the others, and drops those that the others do without.
fn exchange(model: &mut Model<'_, '_>, fit: &mut Fit, scene: &Scene<'_>, surveys: &mut Surveys) {
    if model.terms.len() < 2 {
        return;
    }
    let data = model.runner.data;
    let likely = surveys.likely(scene.library);
    let scene = &Scene { library: &likely, ..*scene };
    // The newest was the best beside the others already.
    let mut term = 0;
    while term + 1 < model.terms.len() {
        let Some((reduced, without)) = without(model, fit, term) else { return };
        let own = own_trial(&reduced, &without, model, fit, term);
        let own_bic = own.as_ref().map_or(f64::NEG_INFINITY, |t| t.delta_bic);
        let best = surveys.survey(&reduced, &without, scene).into_iter().find(|t| t.fit.is_some());
        match best {
            Some(best)
                if best.delta_bic
                    > own_bic + lead((model.terms[term].kind, own_bic), best.candidate.kind, data)
                    && best.delta_bic > LEAST_BIC =>
            {
                let Some(better) = best.fit else { return };
                *model = reduced;
                model.terms.push(best.candidate);
                *fit = better;
            }
            _ if own_bic < LEAST_BIC => {
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

/// Whether one more cause may be named. Harmonics and aliases make several tones of one shaking: they count apart.
fn room(model: &Model<'_, '_>, candidate: &Candidate, most: usize) -> bool {
    let tone = |c: &Candidate| matches!(c.kind, Kind::Vibration | Kind::PeriodicDisturbance);
    model.terms.iter().filter(|t| tone(t) == tone(candidate)).count() < most
}
