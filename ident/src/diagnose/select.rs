//! The choice of causes: added one by one, exchanged while that is better, taken back when the rest does without.

use whirlstand_vehicle::Kind;

use super::heldout::gain_in_sigmas;
use super::library::Candidate;
use super::model::{Fit, Model, dot};
use super::noise::Noise;
use super::screen::{Frame, cosine};
use super::survey::{Scene, Trial, fitted, survey};
use crate::identify::quality::chi_square_tail;

/// Causes that are named, at most.
pub const MOST: usize = 5;
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
/// Candidates of each survey that may take another's place later.
const LIKELY: usize = 30;
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

/// A surveyed candidate, without the weight of its fit.
#[derive(Debug, Clone)]
struct Seen {
    candidate: Candidate,
    /// Values of the fitted model, the candidate's last; `None` when it was not worth a fit.
    values: Option<Vec<f64>>,
    delta_bic: f64,
}

/// What was surveyed beside which terms: the search comes back to the same terms in the end.
#[derive(Debug, Default)]
struct Surveys(Vec<(Vec<String>, Vec<Seen>)>);

impl Surveys {
    fn names(model: &Model<'_, '_>) -> Vec<String> {
        let mut names: Vec<String> = model.terms.iter().map(Candidate::name).collect();
        names.sort_unstable();
        names
    }

    fn survey(&mut self, model: &Model<'_, '_>, fit: &Fit, scene: &Scene<'_>) -> Vec<Trial> {
        let trials = survey(model, fit, scene);
        let seen = trials.iter().map(|t| Seen {
            candidate: t.candidate.clone(),
            values: t.fit.as_ref().map(|f| f.values.clone()),
            delta_bic: t.delta_bic,
        });
        let names = Self::names(model);
        self.0.retain(|(known, _)| *known != names);
        self.0.push((names, seen.collect()));
        trials
    }

    /// Candidates that were near the front beside any terms.
    fn likely(&self, library: &[Candidate]) -> Vec<Candidate> {
        let front: std::collections::HashSet<String> = self
            .0
            .iter()
            .flat_map(|(_, seen)| seen.iter().take(LIKELY).map(|s| s.candidate.name()))
            .collect();
        library.iter().filter(|c| front.contains(&c.name())).cloned().collect()
    }

    fn known(&mut self, model: &Model<'_, '_>, fit: &Fit, scene: &Scene<'_>) -> Vec<Seen> {
        let names = Self::names(model);
        if !self.0.iter().any(|(known, _)| *known == names) {
            self.survey(model, fit, scene);
        }
        self.0.iter().find(|(known, _)| *known == names).map_or_else(Vec::new, |(_, seen)| seen.clone())
    }
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
    let states = model.states();
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
        let trials = surveys.known(&reduced, &without, scene);
        let own = own_trial(&reduced, &without, &model, &fit, term);
        match own.as_ref().map(|own| judge(&reduced, &without, own, hypotheses)) {
            Some(Judgement::Accepted(weight)) => {
                let own = own?;
                let rivals = rivals(&reduced, &without, &own, &trials);
                let better = rivals.iter().find(|r| r.gap < -1.0).filter(|_| exchanges < EXCHANGES);
                let trial = better.and_then(|r| fitted(&reduced, &without, &r.candidate, r.values.clone()));
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

/// Causes that leave more than this share of what they explain are not believed.
pub const BELIEVED: f64 = 0.004;

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
        let tone = |c: &Candidate| c.kind == Kind::Vibration;
        let terms = self.model.terms.iter().zip(&self.accepted);
        let taken: Vec<_> =
            terms.filter(|(c, _)| !tone(c)).map(|(c, a)| (c.clone(), a.weight.delta_bic)).collect();
        let mut kept = self.clone();
        kept.keep(tone);
        kept.fit.values.splice(..start.len(), start);
        match kept.model.fit(kept.fit.values.clone(), self.fit.profile.noise.shared(), None) {
            Some(fit) if !taken.is_empty() => {
                *self = Self { fit, ..kept };
                taken
            }
            _ => Vec::new(),
        }
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
fn exchange(model: &mut Model<'_, '_>, fit: &mut Fit, scene: &Scene<'_>, surveys: &mut Surveys) {
    if model.terms.len() < 2 {
        return;
    }
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

/// True for what happens once.
fn is_event(candidate: &Candidate) -> bool {
    matches!(candidate.kind, Kind::StepDisturbance | Kind::PulseDisturbance)
}

/// Whether one more cause may be named. Harmonics and aliases make several tones of one shaking: they count apart.
fn room(model: &Model<'_, '_>, candidate: &Candidate, most: usize) -> bool {
    let tone = |c: &Candidate| matches!(c.kind, Kind::Vibration | Kind::PeriodicDisturbance);
    model.terms.iter().filter(|t| tone(t) == tone(candidate)).count() < most
}

/// Whether a fitted candidate passes all conditions.
pub fn judge(model: &Model<'_, '_>, fit: &Fit, trial: &Trial, hypotheses: usize) -> Judgement {
    let refuse = |why: String| Judgement::Refused(why);
    let k = trial.candidate.tunables.len();
    let delta_bic = trial.delta_bic;
    if delta_bic < LEAST_BIC {
        return refuse(match delta_bic {
            d if d <= 0.0 => "what it explains is not worth its parameters".into(),
            d => format!("it gains {d:.1} in BIC; {LEAST_BIC:.0} are asked"),
        });
    }
    let Some(extended) = &trial.fit else {
        return refuse("others explain more".into());
    };
    let chance = chi_square_tail(trial.ratio.max(0.0), k as f64);
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
        return refuse(format!(
            "on data left out of the fit it gains {heldout:.1} standard errors; 2 are asked"
        ));
    }
    let detectability = detectability(model, fit, trial).unwrap_or(0.0);
    Judgement::Accepted(Weight { delta_bic, heldout, p_value, detectability })
}

/// The signature of a fitted candidate: what it changes at its values, the others as they are.
fn signature(model: &Model<'_, '_>, candidate: &Candidate, values: &[f64]) -> Option<Vec<f64>> {
    let mut whole = model.clone();
    whole.terms.push(candidate.clone());
    let others = &values[..values.len() - candidate.tunables.len()];
    let without = model.predict(others)?;
    Some(whole.predict(values)?.iter().zip(&without).map(|(a, b)| a - b).collect())
}

fn detectability(model: &Model<'_, '_>, fit: &Fit, trial: &Trial) -> Option<f64> {
    let extended = trial.fit.as_ref()?;
    let zero = vec![0.0; fit.residual.len()];
    let frame = Frame::new(model.runner.data, &extended.profile.noise, &zero, &fit.columns);
    let s = frame.signature(&signature(model, &trial.candidate, &extended.values)?);
    Some(dot(&s, &s))
}

/// Other fitted candidates, and how alike they look.
fn rivals(model: &Model<'_, '_>, fit: &Fit, own: &Trial, trials: &[Seen]) -> Vec<Rival> {
    let Some(extended) = &own.fit else { return Vec::new() };
    let Some(mine) = signature(model, &own.candidate, &extended.values) else { return Vec::new() };
    let zero = vec![0.0; fit.residual.len()];
    let frame = Frame::new(model.runner.data, &extended.profile.noise, &zero, &fit.columns);
    let mine = frame.signature(&mine);
    let name = own.candidate.name();
    let others = trials.iter().filter(|t| t.candidate.name() != name);
    let mut rivals: Vec<Rival> = others
        .filter_map(|t| {
            let values = t.values.as_ref()?;
            let theirs = frame.signature(&signature(model, &t.candidate, values)?);
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
