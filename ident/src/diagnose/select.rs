//! The choice of causes: added one by one, exchanged while that is better, taken back when the rest does without.

use super::heldout::gain_in_sigmas;
use super::library::Candidate;
use super::model::{Fit, Model, dot};
use super::screen::{Frame, cosine};
use super::survey::{Scene, Trial, fitted, survey};
use crate::identify::quality::chi_square_tail;

/// Causes that are named, at most.
const MOST: usize = 5;
/// Least gain in BIC.
pub const LEAST_BIC: f64 = 10.0;
/// Largest probability of a chance, corrected.
pub const LARGEST_P: f64 = 0.01;
/// Least gain on left-out data over its standard error.
pub const LEAST_GAIN: f64 = 2.0;
/// Largest standard error of a size, as a share of it.
pub const LARGEST_ERROR: f64 = 0.3;
/// Detectability below which an effect cannot be told.
pub const LEAST_DETECTABILITY: f64 = 12.0;
/// Cosine from which on two signatures are one.
pub const ALIKE: f64 = 0.95;
/// Difference in BIC up to which a rival is as good.
const AS_GOOD: f64 = 6.0;

/// Difference in BIC from which on a candidate is not believed beside a better one that was refused.
const OVERSHADOWED: f64 = 30.0;
/// Difference in BIC below which two causes that do not look alike cannot both be excluded: odds of about seven to one.
const UNDECIDED: f64 = 4.0;
/// Exchanges for better rivals in the end, at most.
const EXCHANGES: usize = 6;

/// Evidence for a term.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weight {
    /// Gain in BIC over the model without it.
    pub delta_bic: f64,
    /// Gain on left-out data over its standard error.
    pub heldout: f64,
    /// Probability by chance, corrected.
    pub p_value: f64,
    /// Squared norm of its whitened signature, nuisances projected out.
    pub detectability: f64,
}

/// Why a candidate was not accepted, or its evidence.
#[derive(Debug, Clone, PartialEq)]
pub enum Judgement {
    /// All conditions hold.
    Accepted(Weight),
    /// The first that does not.
    Refused(String),
}

/// A rival that explains as much.
#[derive(Debug, Clone, PartialEq)]
pub struct Rival {
    /// The effect.
    pub candidate: Candidate,
    /// Its values.
    pub values: Vec<f64>,
    /// By how much the accepted cause is better, in BIC.
    pub gap: f64,
    /// Cosine of the angle between the signatures.
    pub kappa: f64,
}

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

/// Searches for causes. `None` when the vehicle cannot be simulated over the record.
pub fn select<'r, 'd>(mut model: Model<'r, 'd>, scene: &Scene<'_>) -> Option<Selection<'r, 'd>> {
    let states = model.states();
    let mut start = vec![0.0; states];
    start.extend(model.free.iter().map(|f| model.runner.vehicle.free_value(&f.target)));
    let null = model.fit(start, None, None)?;
    let mut fit = null.clone();
    let mut refused;
    // What was found beside nothing: the rivals of a single cause.
    let mut first = None;
    loop {
        let trials = survey(&model, &fit, scene);
        if model.terms.is_empty() {
            first = Some(trials.clone());
        }
        let hypotheses = trials.len();
        refused = Vec::new();
        let mut best = None;
        let left = hypotheses.saturating_sub(model.terms.len()).max(1);
        let most = trials.first().map_or(0.0, |t| t.delta_bic);
        for trial in trials {
            // What explains less than one that was refused is no better for that.
            if best.is_some() || trial.delta_bic < most - OVERSHADOWED {
                refused.push((trial, "others explain more".into()));
                continue;
            }
            let j = judge(&model, &fit, &trial, left, scene.share);
            if std::env::var("DBG").is_ok() && trial.delta_bic > 0.0 { eprintln!("loop {} dbic {:.1} {:?}", trial.candidate.name(), trial.delta_bic, j); }
            match j {
                Judgement::Accepted(_) if model.terms.len() < MOST => best = Some(trial),
                Judgement::Accepted(_) => refused.push((trial, format!("{MOST} causes were named already"))),
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
        exchange(&mut model, &mut fit, scene);
    }
    let mut accepted = Vec::new();
    let mut term = 0;
    let mut exchanges = 0;
    while term < model.terms.len() {
        let (reduced, without) = without(&model, &fit, term)?;
        let known = first.take_if(|_| reduced.terms.is_empty());
        let trials = known.unwrap_or_else(|| survey(&reduced, &without, scene));
        let own = own_trial(&reduced, &without, &model, &fit, term);
        if std::env::var("DBG").is_ok() { eprintln!("prune {} {:?}", model.terms[term].name(), own.as_ref().map(|own| (own.delta_bic, judge(&reduced, &without, own, trials.len(), scene.share)))); for r in own.as_ref().map(|o| rivals(&reduced,&without,o,&trials)).unwrap_or_default() { eprintln!("   rival {} gap {:.1} kappa {:.2}", r.candidate.name(), r.gap, r.kappa); } }
        match own.as_ref().map(|own| judge(&reduced, &without, own, trials.len(), scene.share)) {
            Some(Judgement::Accepted(weight)) => {
                let own = own?;
                let rivals = rivals(&reduced, &without, &own, &trials);
                let better = rivals.iter().find(|r| r.gap < -1.0).filter(|_| exchanges < EXCHANGES);
                let trial = better.and_then(|r| fitted(&reduced, &without, &r.candidate, r.values.clone()));
                let judged = trial.map(|t| (judge(&reduced, &without, &t, trials.len(), scene.share), t));
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
                        rival.candidate.name(), rival.gap.abs(), rival.kappa
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

/// Causes that leave more than this share of what they explain are not believed.
const BELIEVED: f64 = 0.01;

impl Selection<'_, '_> {
    /// Takes back the causes when what they leave, of the given energy beyond chance, is too much for noise. A tone is
    /// believed whatever else there is. `start` are the values without any cause.
    ///
    /// Returns the names that were taken back, with their gains in BIC.
    pub fn withhold(&mut self, left: f64, start: Vec<f64>) -> Vec<(Candidate, f64)> {
        let explained: f64 = self.accepted.iter().map(|a| a.weight.detectability).sum();
        if left < BELIEVED * explained {
            return Vec::new();
        }
        let tone = |c: &Candidate| c.kind == whirlstand_vehicle::Kind::Vibration;
        let mut model = self.model.clone();
        let mut values = start;
        let (mut kept, mut taken) = (Vec::new(), Vec::new());
        model.terms.clear();
        for (term, (candidate, accepted)) in self.model.terms.iter().zip(&self.accepted).enumerate() {
            if tone(candidate) {
                model.terms.push(candidate.clone());
                values.extend(&self.fit.values[self.model.range(term)]);
                kept.push(accepted.clone());
            } else {
                taken.push((candidate.clone(), accepted.weight.delta_bic));
            }
        }
        match model.fit(values, None, None) {
            Some(fit) if !taken.is_empty() => {
                self.model = model;
                self.fit = fit;
                self.accepted = kept;
                taken
            }
            _ => Vec::new(),
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
    let without = reduced.fit(values, None, Some(&fit.columns[..model.states()]))?;
    Some((reduced, without))
}

/// A term of a model as a trial beside the others.
fn own_trial(
    reduced: &Model<'_, '_>,
    without: &Fit,
    model: &Model<'_, '_>,
    fit: &Fit,
    term: usize,
) -> Option<Trial> {
    fitted(reduced, without, &model.terms[term], fit.values[model.range(term)].to_vec())
}

/// Exchanges terms for better ones beside the others, and drops those that the others do without.
fn exchange(model: &mut Model<'_, '_>, fit: &mut Fit, scene: &Scene<'_>) {
    if model.terms.len() < 2 {
        return;
    }
    // The newest was the best beside the others already.
    let mut term = 0;
    while term + 1 < model.terms.len() {
        let Some((reduced, without)) = without(model, fit, term) else { return };
        let own = own_trial(&reduced, &without, model, fit, term);
        let own_bic = own.as_ref().map_or(f64::NEG_INFINITY, |t| t.delta_bic);
        let best = survey(&reduced, &without, scene).into_iter().find(|t| t.fit.is_some());
        match best {
            Some(best) if best.delta_bic > own_bic + 1.0 && best.delta_bic > LEAST_BIC => {
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

/// Whether a fitted candidate passes all conditions.
pub fn judge(
    model: &Model<'_, '_>,
    fit: &Fit,
    trial: &Trial,
    hypotheses: usize,
    share: f64,
) -> Judgement {
    let refuse = |why: String| Judgement::Refused(why);
    let k = trial.candidate.tunables.len();
    let delta_bic = trial.delta_bic - (1.0 - share) * trial.ratio.max(0.0);
    if delta_bic < LEAST_BIC {
        return refuse(match delta_bic {
            d if d <= 0.0 => "what it explains is not worth its parameters".into(),
            d => format!("it gains {d:.1} in BIC; {LEAST_BIC:.0} are asked"),
        });
    }
    let Some(extended) = &trial.fit else {
        return refuse("others explain more".into());
    };
    let chance = chi_square_tail(share * trial.ratio.max(0.0), k as f64);
    let p_value = (chance * trial.candidate.looks * hypotheses as f64).min(1.0);
    if p_value >= LARGEST_P {
        return refuse(format!("chance alone does as well with probability {p_value:.2}, all looks counted"));
    }
    let mut whole = model.clone();
    whole.terms.push(trial.candidate.clone());
    let Some(covariance) = whole.covariance(extended) else {
        return refuse("its parameters are not determined".into());
    };
    let from = extended.values.len() - k;
    for (i, tunable) in trial.candidate.tunables.iter().enumerate() {
        if !tunable.size {
            continue;
        }
        let null = if i + 1 == k { trial.candidate.null } else { 0.0 };
        let size = (extended.values[from + i] - null).abs();
        let mut variance = covariance[(from + i, from + i)];
        // Of a short pulse a record shows the area; how high and how long it was go together.
        if let Some(d) = trial.candidate.tunables.iter().position(|t| t.name == "duration_s") {
            let share = size / extended.values[from + d].abs().max(f64::MIN_POSITIVE);
            let sign = (extended.values[from + i] - null).signum();
            let both = covariance[(from + i, from + d)];
            variance += share * share * covariance[(from + d, from + d)] + 2.0 * sign * share * both;
        }
        let error = variance.max(0.0).sqrt();
        if error > LARGEST_ERROR * size {
            return refuse(format!(
                "its {} is known to {:.0} % only",
                tunable.name,
                (100.0 * error / size.max(f64::MIN_POSITIVE)).min(999.0)
            ));
        }
    }
    let heldout = gain_in_sigmas((model, fit), (&whole, extended));
    if heldout <= LEAST_GAIN {
        return refuse(format!("on data left out of the fit it gains {heldout:.1} standard errors; 2 are asked"));
    }
    let detectability = detectability(model, fit, trial).unwrap_or(0.0);
    Judgement::Accepted(Weight { delta_bic, heldout, p_value, detectability })
}

/// The signature of a fitted candidate: what it changes at its values, the others as they are.
fn signature(model: &Model<'_, '_>, trial: &Trial) -> Option<Vec<f64>> {
    let extended = trial.fit.as_ref()?;
    let others = &extended.values[..extended.values.len() - trial.candidate.tunables.len()];
    let without = model.predict(others)?;
    Some(extended.predicted.iter().zip(&without).map(|(a, b)| a - b).collect())
}

fn detectability(model: &Model<'_, '_>, fit: &Fit, trial: &Trial) -> Option<f64> {
    let extended = trial.fit.as_ref()?;
    let zero = vec![0.0; fit.residual.len()];
    let frame = Frame::new(model.runner.data, &extended.profile.noise, &zero, &fit.columns);
    let s = frame.signature(&signature(model, trial)?);
    Some(dot(&s, &s))
}

/// Other fitted candidates, and how alike they look.
fn rivals(model: &Model<'_, '_>, fit: &Fit, own: &Trial, trials: &[Trial]) -> Vec<Rival> {
    let (Some(extended), Some(mine)) = (&own.fit, signature(model, own)) else { return Vec::new() };
    let zero = vec![0.0; fit.residual.len()];
    let frame = Frame::new(model.runner.data, &extended.profile.noise, &zero, &fit.columns);
    let mine = frame.signature(&mine);
    let name = own.candidate.name();
    let others = trials.iter().filter(|t| t.candidate.name() != name);
    let mut rivals: Vec<Rival> = others
        .filter_map(|t| {
            let theirs = frame.signature(&signature(model, t)?);
            let values = t.fit.as_ref()?.values.clone();
            Some(Rival {
                values: values[values.len() - t.candidate.tunables.len()..].to_vec(),
                candidate: t.candidate.clone(),
                gap: own.delta_bic - t.delta_bic,
                kappa: cosine(&mine, &theirs).abs(),
            })
        })
        .collect();
    rivals.sort_by(|a, b| a.gap.total_cmp(&b.gap));
    rivals
}

impl Rival {
    /// True when the record cannot tell it from the accepted cause.
    pub fn indistinguishable(&self) -> bool {
        self.kappa > ALIKE && self.gap < AS_GOOD
    }
}
