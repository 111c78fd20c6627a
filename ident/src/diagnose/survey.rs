//! The survey: every candidate weighed against the residual of a model, the best of them fitted.

use rayon::prelude::*;
use whirlstand_vehicle::Kind;

use super::library::Candidate;
use super::library::Sizes;
use super::model::{Effort, Fit, Model};
use super::noise::Noise;
use super::responses::Responses;
use super::screen::Frame;
use super::twins::{simpler, single};
use super::{events, tones};

/// Candidates that are fitted a few steps, at most.
const GLANCED: usize = 16;
/// Candidates that are fitted to their optimum, at most, and how far in BIC behind the best of them: a few steps under the
/// noise model of the start may still miss a share of what a strong effect gains.
const FITTED: usize = 5;
const BEHIND: f64 = 40.0;
const SHARE_BEHIND: f64 = 0.25;
/// One that is so near in BIC may be what cannot be told from the best: then it is fitted, however many there are.
const NEAR: f64 = 15.0;
/// Score of a transition whose time is still far off, at most.
const UNSURE: f64 = 100.0;
/// Gain in BIC below which the first look leaves no hope that a fit would be accepted.
const HOPELESS: f64 = -20.0;
/// Candidates of each frame whose noise model is fitted anew before that choice.
const WEIGHED: usize = 40;

/// A candidate beside the terms of a model, fitted together with them.
#[derive(Debug, Clone)]
pub struct Trial {
    /// The candidate.
    pub candidate: Candidate,
    /// The fit of model and candidate; the candidate's values come last. `None` when it was not worth a fit.
    pub fit: Option<Fit>,
    /// The model's terms in that fit: those of a search's end may be others.
    pub beside: Vec<Candidate>,
    /// Gain in BIC over the model without it: by the fit, or estimated from the score.
    pub delta_bic: f64,
    /// Twice the gain in log-likelihood.
    pub ratio: f64,
}

/// A signature at one start, and how well it does in a frame.
#[derive(Debug, Clone)]
struct Shot {
    start: usize,
    amplitude: f64,
    score: f64,
    frame: usize,
}

/// What the search knows beside model and fit.
#[derive(Debug, Clone, Copy)]
pub struct Scene<'s> {
    /// Candidates whose response follows from the inputs.
    pub library: &'s [Candidate],
    /// Sizes of the record.
    pub sizes: &'s Sizes,
    /// Causes that are named, at most.
    pub most: usize,
    /// Standard deviations of the channels' noise as the vehicle declares it; 0 where it says nothing.
    pub declared: &'s [f64],
}

/// Weighs every candidate of the scene, and events and tones that the residual suggests. Best first.
pub fn survey(model: &Model<'_, '_>, fit: &Fit, scene: &Scene<'_>) -> Vec<Trial> {
    let data = model.runner.data;
    // Where an effect is strong, the noise model fitted to its own traces hides it; white noise of the declared size
    // does not. Both are asked, the likelihood with a noise model fitted anew decides.
    let stds: Vec<f64> = scene
        .declared
        .iter()
        .zip(&fit.profile.noise.channels)
        .map(|(declared, ar)| declared.max(ar.variance.sqrt()))
        .collect();
    let mut frames = vec![Frame::new(data, &fit.profile.noise, &fit.residual, &fit.columns)];
    if fit.profile.noise.common.is_none() && fit.profile.noise.channels.iter().any(|ar| ar.order() > 0) {
        frames.push(Frame::new(data, &Noise::white(&stds), &fit.residual, &fit.columns));
    }
    let mut candidates: Vec<Candidate> = scene
        .library
        .iter()
        .filter(|c| !model.terms.iter().any(|t| t.kind == c.kind && t.place == c.place))
        .cloned()
        .collect();
    let responses = Responses::new(model, fit, scene.sizes);
    for frame in &frames {
        // An event of one of several records is none of the others.
        if data.starts.len() == 1 {
            candidates.extend(events::events(model, frame, scene.sizes, &responses));
        }
        candidates.extend(tones::tones(model, fit, frame, scene.sizes, &responses));
    }
    let mut weighed: Vec<(Candidate, Vec<Shot>)> = candidates
        .into_par_iter()
        .map(|candidate| {
            let shots = shots(model, fit, &frames, &candidate);
            (candidate, shots)
        })
        .collect();
    let promising = promising(&weighed, frames.len(), 1.0 / data.period_s);
    let rows = (fit.profile.rows as f64).ln();
    let mut trials: Vec<(Trial, Vec<f64>)> = weighed
        .par_drain(..)
        .enumerate()
        .map(|(index, (candidate, shots))| {
            let cost = candidate.tunables.len() as f64 * rows;
            let mut best = (-cost, candidate.starts.first().cloned().unwrap_or_default());
            for shot in &shots {
                let gain = if promising[index] && candidate.kind == Kind::ModeTransition {
                    let (gain, at) = located(model, fit, &frames[shot.frame], &candidate, shot);
                    if gain > best.0 {
                        best = (gain, at);
                    }
                    continue;
                } else if promising[index] {
                    let values = &candidate.starts[shot.start];
                    profiled(model, fit, &frames[shot.frame], &candidate, values, shot.amplitude)
                        .unwrap_or(-cost)
                } else if shot.frame == 0 {
                    shot.score - cost
                } else {
                    -cost
                };
                if gain > best.0 {
                    best = (gain, start(&candidate, shot));
                }
            }
            let trial =
                Trial { candidate, fit: None, beside: Vec::new(), delta_bic: best.0, ratio: best.0 + cost };
            (trial, best.1)
        })
        .collect();
    trials.sort_by(|a, b| b.0.delta_bic.total_cmp(&a.0.delta_bic));
    once(&mut trials);
    // A few steps from a start may end far from what the signature has promised: the promise counts until it is fitted.
    let mut glances: Vec<(Trial, f64, usize)> = trials
        .par_iter()
        .enumerate()
        .take(GLANCED)
        .filter(|(_, (trial, _))| trial.delta_bic > HOPELESS)
        .filter_map(|(i, (t, start))| {
            let glance = followed(model, fit, &t.candidate, start.clone(), Effort::Glance)?;
            let promise = glance.delta_bic.max(t.delta_bic);
            Some((glance, promise, i))
        })
        .collect();
    glances.sort_by(|a, b| b.1.total_cmp(&a.1));
    let sure = |(glance, promise, _): &(Trial, f64, usize)| {
        if glance.candidate.linear { *promise } else { glance.delta_bic }
    };
    let best = glances.iter().map(sure).fold(0.0, f64::max);
    let mut rank = 0..;
    glances.retain(|(_, promise, _)| {
        let among = rank.next().is_some_and(|rank| rank < FITTED);
        best - promise < NEAR || among && best - promise < BEHIND.max(SHARE_BEHIND * best)
    });
    let fitted: Vec<(Option<Trial>, usize)> = glances
        .into_par_iter()
        .map(|(glance, _, i)| {
            let own = |fit: Fit| fit.values[fit.values.len() - glance.candidate.tunables.len()..].to_vec();
            (glance.fit.and_then(|f| fitted(model, fit, &glance.candidate, own(f))), i)
        })
        .collect();
    for (fitted, i) in fitted {
        if let Some(fitted) = fitted {
            trials[i].0 = fitted;
        }
    }
    trials.sort_by(|a, b| {
        let fitted = |t: &Trial| t.fit.is_some();
        fitted(&b.0).cmp(&fitted(&a.0)).then(b.0.delta_bic.total_cmp(&a.0.delta_bic))
    });
    twin_first(model, fit, scene, &mut trials);
    let mut names = std::collections::HashSet::new();
    trials.into_iter().map(|(trial, _)| trial).filter(|t| names.insert(t.candidate.name())).collect()
}

/// Where the best is the same thing as something simpler, that comes first. With one input and one output, a delay of the
/// one is a delay of the other: then it is the input's. A tone that no other output follows is the sensor's.
fn twin_first(model: &Model<'_, '_>, fit: &Fit, scene: &Scene<'_>, trials: &mut Vec<(Trial, Vec<f64>)>) {
    let data = model.runner.data;
    let Some((first, _)) = trials.first() else { return };
    let Some((kind, same)) = simpler(first.candidate.kind, first.delta_bic, data) else { return };
    // On coarse samples the likelihood of a delay has humps: the twin starts where the best has ended.
    let again = first.fit.as_ref().filter(|_| single(data) && kind != Kind::Vibration).and_then(|best| {
        let candidate = scene.library.iter().find(|c| c.kind == kind)?;
        joined(model, fit, candidate, best.values.clone(), Effort::Full)
    });
    let bic = first.delta_bic;
    if let Some(again) = again.filter(|t| bic - t.delta_bic < same) {
        let start = again.candidate.starts[0].clone();
        trials.retain(|(t, _)| t.candidate.kind != kind);
        trials.insert(0, (again, start));
    } else if let Some(i) = trials.iter().position(|(t, _)| t.candidate.kind == kind)
        && trials[i].0.fit.is_some()
        && bic - trials[i].0.delta_bic < same
    {
        trials[..=i].rotate_right(1);
    }
}

/// Both frames often suggest the same event or tone: once is enough. Sorted, the better one stays.
fn once(trials: &mut Vec<(Trial, Vec<f64>)>) {
    let mut kept: Vec<(String, Vec<f64>, f64)> = Vec::new();
    trials.retain(|(trial, start)| {
        let name = trial.candidate.name();
        let near = |other: &[f64]| {
            let mut pairs = start.iter().zip(other).zip(&trial.candidate.tunables);
            other.len() == start.len()
                && pairs.all(|((a, b), t)| t.size || t.name == "phase_rad" || (a - b).abs() <= 3.0 * t.scale)
        };
        // The score of one whose noise was fitted anew is the same when it is the same.
        let known = kept
            .iter()
            .any(|(n, other, bic)| *n == name && near(other) && (bic - trial.delta_bic).abs() < 1.0);
        if !known {
            kept.push((name, start.clone(), trial.delta_bic));
        }
        !known
    });
}

/// Which candidates are among the best of any frame.
fn promising(weighed: &[(Candidate, Vec<Shot>)], frames: usize, rate_hz: f64) -> Vec<bool> {
    let mut promising = vec![false; weighed.len()];
    for frame in 0..frames {
        let score = |i: usize| weighed[i].1.iter().find(|s| s.frame == frame).map_or(0.0, |s| s.score);
        let mut order: Vec<usize> = (0..weighed.len()).collect();
        order.sort_by(|a, b| score(*b).total_cmp(&score(*a)));
        order.iter().take(WEIGHED).for_each(|i| promising[*i] = true);
    }
    // A noise model can hold a tone so well that only one fitted without it shows the tone. In the lower half of the band
    // commands make what looks like tones.
    let tone = |i: &usize| {
        let candidate = &weighed[*i].0;
        let high = candidate.starts[0].first().is_some_and(|f| *f > 0.25 * rate_hz);
        candidate.kind == Kind::Vibration && high
    };
    (0..weighed.len()).filter(tone).for_each(|i| promising[i] = true);
    promising
}

/// The best start in each frame.
fn shots(model: &Model<'_, '_>, fit: &Fit, frames: &[Frame<'_>], candidate: &Candidate) -> Vec<Shot> {
    let mut best: Vec<Option<Shot>> = vec![None; frames.len()];
    for (start, values) in candidate.starts.iter().enumerate() {
        let Some(signature) = signature(model, fit, candidate, values) else { continue };
        for (f, frame) in frames.iter().enumerate() {
            let mut look = frame.look(&signature);
            if candidate.kind == Kind::ModeTransition {
                // It has one size only. Far from the true time it may be too much even so: then its shape must do.
                let whole = frame.whole(&signature);
                look.amplitude = if whole > 0.0 { 1.0 } else { look.amplitude };
                look.score = if whole > 0.0 { whole } else { look.score.min(UNSURE) };
            }
            // A delay cannot be negative: what points the other way is no sign of it.
            if look.amplitude <= 0.0 && !two_sided(candidate) {
                continue;
            }
            if best[f].as_ref().is_none_or(|b| look.score > b.score) {
                best[f] = Some(Shot { start, amplitude: look.amplitude, score: look.score, frame: f });
            }
        }
    }
    best.into_iter().flatten().collect()
}

/// True when the response may be turned round.
fn two_sided(candidate: &Candidate) -> bool {
    candidate.linear && candidate.tunables.last().is_some_and(|t| t.lower < candidate.null)
}

/// Change of the predicted samples when the candidate is added.
fn signature(model: &Model<'_, '_>, fit: &Fit, candidate: &Candidate, values: &[f64]) -> Option<Vec<f64>> {
    let mut vehicle = model.vehicle(&fit.values)?;
    vehicle.add_effect(candidate.effect(values)?).ok()?;
    let mut samples = model.runner.run_vehicle(&vehicle, &fit.values[..model.states()])?;
    samples.iter_mut().zip(&fit.predicted).for_each(|(y, p)| *y -= p);
    Some(samples)
}

/// Where a fit starts: at the amplitude that the score suggests where the response is proportional to it.
fn start(candidate: &Candidate, shot: &Shot) -> Vec<f64> {
    let mut values = candidate.starts[shot.start].clone();
    if candidate.linear
        && let (Some(value), Some(tunable)) = (values.last_mut(), candidate.tunables.last())
    {
        let moved = candidate.null + shot.amplitude * (*value - candidate.null);
        *value = moved.clamp(tunable.lower, tunable.upper);
    }
    values
}

/// Gain in BIC when the signature is taken off at its amplitude and the noise fitted anew.
fn profiled(
    model: &Model<'_, '_>,
    fit: &Fit,
    frame: &Frame<'_>,
    candidate: &Candidate,
    values: &[f64],
    amplitude: f64,
) -> Option<f64> {
    let data = model.runner.data;
    let mut signature = signature(model, fit, candidate, values)?;
    data.fill(&mut signature);
    let rest: Vec<f64> = fit.residual.iter().zip(&signature).map(|(r, s)| r - amplitude * s).collect();
    let profile = fit.profile.noise.again(data, &frame.without_nuisances(&rest));
    Some(fit.profile.bic(0) - profile.bic(candidate.tunables.len()))
}

/// Where in time a transition does best, and its gain in BIC: all starts, then a search by halves, as a fit by derivatives
/// would stay at the nearest hump.
fn located(
    model: &Model<'_, '_>,
    fit: &Fit,
    frame: &Frame<'_>,
    candidate: &Candidate,
    shot: &Shot,
) -> (f64, Vec<f64>) {
    let gain = |t: f64| profiled(model, fit, frame, candidate, &[t], 1.0).unwrap_or(f64::NEG_INFINITY);
    let start = |s: &Vec<f64>| (gain(s[0]), s[0]);
    let first = start(&candidate.starts[shot.start]);
    let (mut best, mut at) = candidate
        .starts
        .iter()
        .map(start)
        .fold(first, |best, next| if next.0 > best.0 { next } else { best });
    let mut step = candidate.starts.get(1).map_or(0.0, |second| 0.5 * (second[0] - candidate.starts[0][0]));
    while step > 2.0 * model.runner.data.period_s {
        for t in [at - step, at + step] {
            let here = gain(t.clamp(candidate.tunables[0].lower, candidate.tunables[0].upper));
            if here > best {
                (best, at) = (here, t);
            }
        }
        step *= 0.5;
    }
    (best, vec![at])
}

/// The model with the candidate, all values fitted.
pub fn fitted(model: &Model<'_, '_>, fit: &Fit, candidate: &Candidate, start: Vec<f64>) -> Option<Trial> {
    followed(model, fit, candidate, start, Effort::Full)
}

/// As [`fitted`], as far as asked.
pub fn followed(
    model: &Model<'_, '_>,
    fit: &Fit,
    candidate: &Candidate,
    start: Vec<f64>,
    effort: Effort,
) -> Option<Trial> {
    let mut values = fit.values.clone();
    values.extend(start);
    joined(model, fit, candidate, values, effort)
}

/// The model with the candidate, from all values together.
pub fn joined(
    model: &Model<'_, '_>,
    fit: &Fit,
    candidate: &Candidate,
    values: Vec<f64>,
    effort: Effort,
) -> Option<Trial> {
    let mut extended = model.clone();
    extended.terms.push(candidate.clone());
    let initial = &fit.columns[..model.states()];
    let result = extended.follow(values, fit.profile.noise.shared(), Some(initial), effort)?;
    let delta_bic = fit.profile.bic(0) - result.profile.bic(candidate.tunables.len());
    let ratio = 2.0 * (result.profile.log_likelihood - fit.profile.log_likelihood);
    let beside = model.terms.clone();
    Some(Trial { candidate: candidate.clone(), fit: Some(result), beside, delta_bic, ratio })
}
