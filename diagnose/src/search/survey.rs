//! The survey: scores every candidate against the residual of a model, and fits the best of them.

use crate::thresholds::{
    DISTANT_TRANSITION_SCORE, FITTED, FITTED_BEHIND_BIC, FITTED_BEHIND_SHARE, FITTED_NEAR_BIC, GLANCED,
    HOPELESS_BIC, MIN_BIC_GAIN, PROFILED,
};
use rayon::prelude::*;
use whirlstand_vehicle::Kind;

use crate::candidates::events;
use crate::candidates::library::Candidate;
use crate::candidates::tones;
use crate::model::fit::{Effort, Fit, Model};
use crate::model::noise::Noise;
use crate::model::score_test::{ScoreTest, ScoredStart};
use crate::model::step_response::Responses;
use crate::search::alternative::{Alternative, SearchSpace, fitted, fitted_with};
use crate::search::survey_order::{once, simpler_first};
use whirlstand_ident::watch::{Counter, Watch};

/// Scores every candidate of the search space, and the events and tones that the residual suggests. Best
/// first.
pub fn survey(model: &Model<'_, '_>, fit: &Fit, space: &SearchSpace<'_>) -> Vec<Alternative> {
    let noises = noises(fit, space);
    let candidates = candidates(model, fit, space, &noises);
    let beside = match model.terms.len() {
        0 => "for a cause".into(),
        n => format!("for another cause in addition to {n}"),
    };
    let looks = format!("searching {beside}: {} candidates", candidates.len());
    let counter = space.watch.count(looks, candidates.len());
    let score_tests: Vec<ScoreTest<'_>> = noises.iter().map(|noise| score_test(model, fit, noise)).collect();
    let mut alternatives = profiles(model, fit, &score_tests, candidates, &counter);
    // Each is as large as all sensitivities; the fits need that room.
    drop(score_tests);
    alternatives.sort_by(|a, b| b.0.delta_bic.total_cmp(&a.0.delta_bic));
    once(&mut alternatives);
    fit_best(model, fit, &mut alternatives, space.watch);
    alternatives.sort_by(|a, b| {
        let fitted = |t: &Alternative| t.optimum.is_some();
        fitted(&b.0).cmp(&fitted(&a.0)).then(b.0.delta_bic.total_cmp(&a.0.delta_bic))
    });
    simpler_first(model, fit, space, &mut alternatives);
    let mut names = std::collections::HashSet::new();
    let alternatives = alternatives.into_iter().map(|(alternative, _)| alternative);
    alternatives.filter(|t| names.insert(t.candidate.name())).collect()
}

/// Noise models of the score tests. Where an effect is strong, a noise model fitted to its traces hides it;
/// white noise of the declared size does not. The likelihood with a refitted noise model decides.
fn noises(fit: &Fit, space: &SearchSpace<'_>) -> Vec<Noise> {
    let noise = &fit.profile.noise;
    let mut noises = vec![noise.clone()];
    if noise.common.is_none() && noise.channels.iter().any(|of| !of.is_white()) {
        let stds = space.declared.iter().zip(&noise.channels);
        let stds: Vec<f64> = stds.map(|(declared, of)| declared.max(of.variance().sqrt())).collect();
        noises.push(Noise::white(&stds));
    }
    noises
}

fn score_test<'d>(model: &Model<'_, 'd>, fit: &Fit, noise: &Noise) -> ScoreTest<'d> {
    ScoreTest::new(model.free_run.data, noise, &fit.residual, &fit.columns)
}

/// The library without the terms of the model, plus the events and tones that the residual suggests.
fn candidates(model: &Model<'_, '_>, fit: &Fit, space: &SearchSpace<'_>, noises: &[Noise]) -> Vec<Candidate> {
    let known = |c: &&Candidate| model.terms.iter().any(|t| t.kind == c.kind && t.place == c.place);
    let mut candidates: Vec<Candidate> = space.library.iter().filter(|c| !known(c)).cloned().collect();
    let responses = Responses::new(model, fit, space.sizes);
    for noise in noises {
        let score_test = &score_test(model, fit, noise);
        // An event of one of several records cannot be an event of the others.
        if model.free_run.data.starts.len() == 1 {
            candidates.extend(events::events(model, score_test, space.sizes, &responses));
        }
        candidates.extend(tones::tones(model, fit, score_test, space.sizes, &responses));
    }
    candidates
}

/// The best start of every candidate and its gain in BIC: with refitted noise for promising candidates, by
/// the score for the others.
fn profiles(
    model: &Model<'_, '_>,
    fit: &Fit,
    score_tests: &[ScoreTest<'_>],
    candidates: Vec<Candidate>,
    counter: &Counter<'_>,
) -> Vec<(Alternative, Vec<f64>)> {
    let watch = counter.watch;
    let scored = candidates.into_par_iter().map(|candidate| {
        let scored = || scored_starts(model, fit, score_tests, &candidate);
        let starts = if watch.is_stopped() {
            Vec::new()
        } else {
            model.once(fit, &candidate, (|part| &part.scores, 0), scored)
        };
        counter.step();
        (candidate, starts)
    });
    let scored: Vec<(Candidate, Vec<ScoredStart>)> = scored.collect();
    let promising = promising(&scored, score_tests.len(), 1.0 / model.free_run.data.period_s);
    let rows = (fit.profile.rows as f64).ln();
    let gain = |candidate: &Candidate, starts: &[ScoredStart], promising: bool| {
        let cost = candidate.tunables.len() as f64 * rows;
        let mut best = (-cost, candidate.starts.first().cloned().unwrap_or_default());
        for scored in starts {
            let score_test = &score_tests[scored.score_test];
            let (gain, values) = if !promising || watch.is_stopped() {
                // The first test uses the noise model of the fit itself.
                let gain = if scored.score_test == 0 { scored.score - cost } else { -cost };
                (gain, start(candidate, scored))
            } else if candidate.kind == Kind::ModeTransition {
                located(model, fit, score_test, candidate, scored)
            } else {
                let values = &candidate.starts[scored.start];
                let gain = profiled(model, fit, score_test, candidate, values, scored.amplitude);
                (gain.unwrap_or(-cost), start(candidate, scored))
            };
            if gain > best.0 {
                best = (gain, values);
            }
        }
        best
    };
    let profile = |((candidate, starts), promising): ((Candidate, Vec<ScoredStart>), bool)| {
        let cost = candidate.tunables.len() as f64 * rows;
        let variant = u8::from(promising);
        let (delta_bic, values) = model
            .once(fit, &candidate, (|part| &part.gains, variant), || gain(&candidate, &starts, promising));
        let ratio = delta_bic + cost;
        (Alternative { candidate, optimum: None, beside: Vec::new(), delta_bic, ratio }, values)
    };
    scored.into_par_iter().zip(promising).map(profile).collect()
}

/// Result of a few steps of a fit.
struct Glance {
    /// Index of the alternative.
    i: usize,
    /// Values of the candidate's parameters.
    own: Vec<f64>,
    /// Possible gain in BIC: a few steps from a start may end far from the gain that the score predicts,
    /// which counts until the candidate is fitted.
    promise: f64,
    /// Gain in BIC that is certain: for a linear effect the possible gain, else the gain reached so far.
    sure: f64,
}

/// Fits the most likely candidates: the first ones by a few steps, then to the optimum those whose possible
/// gain is close to the best gain.
fn fit_best(model: &Model<'_, '_>, fit: &Fit, alternatives: &mut [(Alternative, Vec<f64>)], watch: &Watch) {
    let glance = |(i, (t, start)): (usize, &(Alternative, Vec<f64>))| {
        if watch.is_stopped() {
            return None;
        }
        let glance = fitted_with(model, fit, &t.candidate, start.clone(), Effort::Glance)?;
        let values = glance.optimum?.values;
        let own = values[values.len() - t.candidate.tunables.len()..].to_vec();
        let promise = glance.delta_bic.max(t.delta_bic);
        let sure = if t.candidate.linear { promise } else { glance.delta_bic };
        Some(Glance { i, own, promise, sure })
    };
    watch.tell("fitting the most likely causes");
    let hopeful =
        alternatives.iter().enumerate().take(GLANCED).filter(|(_, (t, _))| t.delta_bic > HOPELESS_BIC);
    let alone = model.free_run.data.is_long();
    let mut glances = fits(hopeful.collect(), alone, glance);
    glances.sort_by(|a, b| b.promise.total_cmp(&a.promise));
    let best = glances.iter().map(|g| g.sure).fold(0.0, f64::max);
    let mut rank = 0..;
    glances.retain(|g| {
        let among = rank.next().is_some_and(|rank| rank < FITTED);
        best - g.promise < FITTED_NEAR_BIC
            || among && best - g.promise < FITTED_BEHIND_BIC.max(FITTED_BEHIND_SHARE * best)
    });
    let full = |g: Glance| {
        if watch.is_stopped() {
            return None;
        }
        Some((fitted(model, fit, &alternatives[g.i].0.candidate, g.own)?, g.i))
    };
    for (fitted, i) in fits(glances, alone, full) {
        alternatives[i].0 = fitted;
    }
}

/// Makes fits side by side, or one after another.
fn fits<T: Send, F: Send>(of: Vec<T>, alone: bool, fit: impl Fn(T) -> Option<F> + Sync + Send) -> Vec<F> {
    if alone {
        of.into_iter().filter_map(fit).collect()
    } else {
        of.into_par_iter().filter_map(fit).collect()
    }
}

/// Indices of the candidates among the best of any score test.
fn promising(weighed: &[(Candidate, Vec<ScoredStart>)], score_tests: usize, rate_hz: f64) -> Vec<bool> {
    let mut promising = vec![false; weighed.len()];
    for score_test in 0..score_tests {
        let score =
            |i: usize| weighed[i].1.iter().find(|s| s.score_test == score_test).map_or(0.0, |s| s.score);
        let mut order: Vec<usize> = (0..weighed.len()).collect();
        order.sort_by(|a, b| score(*b).total_cmp(&score(*a)));
        order.iter().take(PROFILED).for_each(|i| promising[*i] = true);
    }
    // A noise model can absorb a tone so well that only a model fitted without it shows the tone. In the
    // lower half of the band commands imitate tones.
    let tone = |i: &usize| {
        let candidate = &weighed[*i].0;
        let high = candidate.starts[0].first().is_some_and(|f| *f > 0.25 * rate_hz);
        candidate.kind == Kind::Vibration && high
    };
    (0..weighed.len()).filter(tone).for_each(|i| promising[i] = true);
    promising
}

/// The best start in each score test.
fn scored_starts(
    model: &Model<'_, '_>,
    fit: &Fit,
    score_tests: &[ScoreTest<'_>],
    candidate: &Candidate,
) -> Vec<ScoredStart> {
    let mut best: Vec<Option<ScoredStart>> = vec![None; score_tests.len()];
    for (start, values) in candidate.starts.iter().enumerate() {
        let Ok(signature) = model.change(fit, candidate, values) else { continue };
        for (f, score_test) in score_tests.iter().enumerate() {
            let mut look = score_test.score(&signature);
            if candidate.kind == Kind::ModeTransition {
                // The effect has a fixed size. Far from the true time that may be too much: then only its
                // shape is used.
                let whole = score_test.whole(&signature);
                look.amplitude = if whole > 0.0 { 1.0 } else { look.amplitude };
                look.score = if whole > 0.0 { whole } else { look.score.min(DISTANT_TRANSITION_SCORE) };
            }
            // A delay cannot be negative: a response of the opposite sign is no evidence for it.
            if look.amplitude <= 0.0 && !two_sided(candidate) {
                continue;
            }
            if best[f].as_ref().is_none_or(|b| look.score > b.score) {
                best[f] =
                    Some(ScoredStart { start, amplitude: look.amplitude, score: look.score, score_test: f });
            }
        }
    }
    best.into_iter().flatten().collect()
}

/// True when the response may have either sign.
fn two_sided(candidate: &Candidate) -> bool {
    candidate.linear && candidate.tunables.last().is_some_and(|t| t.lower < candidate.null)
}

/// Start values of a fit: at the amplitude of the score where the response is proportional to it.
fn start(candidate: &Candidate, scored: &ScoredStart) -> Vec<f64> {
    let mut values = candidate.starts[scored.start].clone();
    if candidate.linear
        && let (Some(value), Some(tunable)) = (values.last_mut(), candidate.tunables.last())
    {
        let moved = candidate.null + scored.amplitude * (*value - candidate.null);
        *value = moved.clamp(tunable.lower, tunable.upper);
    }
    values
}

/// Gain in BIC when the signature is subtracted at its amplitude and the noise refitted.
fn profiled(
    model: &Model<'_, '_>,
    fit: &Fit,
    score_test: &ScoreTest<'_>,
    candidate: &Candidate,
    values: &[f64],
    amplitude: f64,
) -> Option<f64> {
    let data = model.free_run.data;
    let mut signature = model.change(fit, candidate, values).ok()?;
    data.fill(&mut signature);
    let rest: Vec<f64> = fit.residual.iter().zip(&signature).map(|(r, s)| r - amplitude * s).collect();
    let profile = fit.profile.noise.again(data, &score_test.without_nuisances(&rest));
    Some(fit.profile.bic(0) - profile.bic(candidate.tunables.len()))
}

/// Time at which a transition has the largest gain in BIC, and that gain: all starts, then a search with
/// halved steps, as a gradient-based fit would stay at the nearest local maximum. These gains are those of the present
/// values: of the times that gain nearly as much, whole fits choose.
fn located(
    model: &Model<'_, '_>,
    fit: &Fit,
    score_test: &ScoreTest<'_>,
    candidate: &Candidate,
    scored: &ScoredStart,
) -> (f64, Vec<f64>) {
    let gain = |t: f64| profiled(model, fit, score_test, candidate, &[t], 1.0).unwrap_or(f64::NEG_INFINITY);
    let gains: Vec<(f64, f64)> = candidate.starts.iter().map(|s| (gain(s[0]), s[0])).collect();
    let first = gains[scored.start];
    let (mut best, mut at) =
        gains.iter().fold(first, |best, next| if next.0 > best.0 { *next } else { best });
    let mut step = candidate.starts.get(1).map_or(0.0, |second| 0.5 * (second[0] - candidate.starts[0][0]));
    while step > 2.0 * model.free_run.data.period_s {
        for t in [at - step, at + step] {
            let here = gain(t.clamp(candidate.tunables[0].lower, candidate.tunables[0].upper));
            if here > best {
                (best, at) = (here, t);
            }
        }
        step *= 0.5;
    }
    if best < MIN_BIC_GAIN {
        return (best, vec![at]);
    }
    let near = gains.iter().filter(|(gain, _)| *gain > best - FITTED_BEHIND_BIC).map(|(_, t)| *t);
    let fits = near.chain([at]).filter_map(|t| {
        let fit = fitted(model, fit, candidate, vec![t])?;
        Some((fit.delta_bic, fit.optimum?.values.last().copied()?))
    });
    let (gain, at) = fits.fold((best, at), |best, next| if next.0 > best.0 { next } else { best });
    (gain, vec![at])
}
