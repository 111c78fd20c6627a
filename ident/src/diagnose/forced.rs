//! Whether what looks like turbulence, or like several causes together, follows a signal: a force that is a function of
//! inputs and states, of a shape that the table does not name.
//!
//! Turbulence explains any slow force, as it has one value a step, and several causes together explain much that is none
//! of them. A force that follows a signal needs a few numbers only: where these few explain as much, in BIC, the causes
//! are not believed.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::sync::Arc;
use whirlstand_vehicle::Vehicle;

use super::adequacy::motion;
use super::families::{Family, Signal, Signals};
use super::forces::Forces;
use super::missing::Entry;
use super::model::{Fit, Model, dot};
use super::noise::{Noise, Profile};
use super::relays;
use super::screen::Frame;
use super::survey::Scene;
use crate::identify::normal::pseudo_inverse;
use crate::identify::quality::chi_square_tail;

/// Families of each frame whose noise model is fitted anew.
const WEIGHED: usize = 6;
/// Families that are looked at in all frames.
const SORTED_OUT: usize = 16;
/// Families that are simulated together.
const TOGETHER: usize = 24;

/// A force that follows a signal.
#[derive(Debug, Clone, PartialEq)]
pub struct Follower {
    /// What it explains, as a gain in BIC.
    pub gain: f64,
    /// "a force on roll_rate that follows roll times roll_rate".
    pub words: String,
}

/// The likeliest force on a state, over a fit under noise models of single channels.
///
/// `None` when nothing could be tried.
pub fn on_state(model: &Model<'_, '_>, fit: &Fit, state: usize, scene: &Scene<'_>) -> Option<Follower> {
    let vehicle = model.vehicle(&fit.values)?;
    let signals = Signals::new(model, motion(&vehicle, model, fit)?);
    Weighing::new(model, fit, &vehicle, scene).best(Entry::State(state), &signals.all())
}

/// A force that follows a signal tells below this probability of chance, of all looks together.
const CHANCE: f64 = 1e-5;

/// A force on the state that turbulence moves, where it follows a state so closely that no turbulence does: it switches
/// with one, or goes in waves with one. Its gain is the score, as far as it exceeds that of turbulence alone.
///
/// The states are what the turbulence's filter foretells from the samples before, so that whatever a force makes of them
/// cannot know the innovations that come after: under turbulence alone the score is chi-square.
pub fn followed(
    (model, fit): (&Model<'_, '_>, &Fit),
    state: usize,
    noise: &Noise,
    scene: &Scene<'_>,
) -> Option<Follower> {
    let data = model.runner.data;
    let common = noise.common.as_ref()?;
    let vehicle = model.vehicle(&fit.values)?;
    let mut states = motion(&vehicle, model, fit)?;
    for (i, x) in states.iter_mut().enumerate() {
        let foretold = common.states(data, &fit.residual, i);
        x.iter_mut().skip(1).zip(foretold).for_each(|(x, moved)| *x += moved);
    }
    let signals = Signals::new(model, states);
    let frame = Frame::new(data, noise, &fit.residual, &fit.columns);
    let pushed = [(state, scene.sizes.slopes[state])];
    let forces = Forces::new(model, fit, &vehicle, &pushed, &signals.states.first()?.values);
    let relay = relays::likeliest(&frame, &forces, &signals.states, false)?;
    let ripples = signals.ripples();
    let functions: Vec<&[f64]> = ripples.iter().flat_map(|f| &f.functions).map(Vec::as_slice).collect();
    let mut responses = forces.each(&functions, |_, index, mut response| {
        data.fill(&mut response);
        (index, response)
    });
    responses.sort_by_key(|(index, _)| *index);
    // Two functions are one wave.
    let pairs = responses.chunk_by(|(a, _), (b, _)| a / 2 == b / 2).filter(|pair| pair.len() == 2);
    let waves = pairs.filter_map(|pair| {
        let columns: Vec<Vec<f64>> = pair.iter().map(|(_, response)| response.clone()).collect();
        Some((explained(&frame, &columns)?.0, &ripples[pair[0].0 / 2].words))
    });
    let wave = waves.max_by(|a, b| a.0.total_cmp(&b.0))?;
    let looks = (signals.states.len() * relays::looks() + ripples.len()) as f64;
    let (switched, waved) = (chi_square_tail(relay.score, 1.0), chi_square_tail(wave.0, 2.0));
    let (score, words) =
        if switched < waved { (relay.score, relay.words(&signals.states)) } else { (wave.0, wave.1.clone()) };
    (looks * switched.min(waved) < CHANCE)
        .then(|| Follower { gain: score, words: on(&vehicle, Entry::State(state), &words) })
}

/// "a force on roll_rate that follows pitch".
fn on(vehicle: &Vehicle, entry: Entry, words: &str) -> String {
    match entry {
        Entry::State(i) => format!("a force on {} that {words}", vehicle.states[i].name),
        Entry::Input(j) => format!("something beside {} that {words}", vehicle.inputs[j].name),
    }
}

/// The likeliest force on any state or into any input, over the fit of a model with no cause. The signals are those of a
/// model `with` causes, which is nearer to the truth.
pub fn rival(
    (model, fit): (&Model<'_, '_>, &Fit),
    (with, its): (&Model<'_, '_>, &Fit),
    scene: &Scene<'_>,
) -> Option<Follower> {
    let signals = Signals::new(with, motion(&with.vehicle(&its.values)?, with, its)?);
    let vehicle = model.vehicle(&fit.values)?;
    let weighing = Weighing::new(model, fit, &vehicle, scene);
    let families = signals.of_states();
    let moved = |i: &usize| {
        vehicle.a.row(*i).iter().filter(|a| **a != 0.0).count() > 1
            || vehicle.b.row(*i).iter().any(|b| *b != 0.0)
    };
    let forces = (0..vehicle.states.len()).filter(moved);
    let forces = forces.flat_map(|i| {
        [weighing.best(Entry::State(i), &families), weighing.relay(i, &signals.states)].into_iter().flatten()
    });
    let inputs = 0..model.runner.data.m;
    let inputs = inputs.filter_map(|j| weighing.best(Entry::Input(j), &signals.of_input(j)));
    forces.chain(inputs).max_by(|a, b| a.gain.total_cmp(&b.gain))
}

/// What the functions of a family do to the samples.
#[derive(Clone)]
struct Columns {
    words: Arc<str>,
    samples: Arc<Vec<Vec<f64>>>,
}

/// A fit that families of forces are weighed against.
struct Weighing<'a, 'd> {
    model: &'a Model<'a, 'd>,
    fit: &'a Fit,
    vehicle: &'a Vehicle,
    plain: Profile,
    /// The quickest comes last.
    frames: Vec<Frame<'d>>,
    slopes: &'a [f64],
}

/// A family in a frame: what it explains there, by how much of each, and its columns.
struct Weight {
    energy: f64,
    by: DVector<f64>,
    columns: Columns,
}

impl<'a, 'd> Weighing<'a, 'd> {
    fn new(model: &'a Model<'a, 'd>, fit: &'a Fit, vehicle: &'a Vehicle, scene: &Scene<'a>) -> Self {
        let data = model.runner.data;
        let plain = Noise::fit(data, &fit.residual);
        let mut frames = vec![Frame::new(data, &plain.noise, &fit.residual, &fit.columns)];
        if scene.declared.iter().all(|d| *d > 0.0) {
            frames.push(Frame::new(data, &Noise::white(scene.declared), &fit.residual, &fit.columns));
        }
        Self { model, fit, vehicle, plain, frames, slopes: &scene.sizes.slopes }
    }

    /// The likeliest family.
    fn best(&self, entry: Entry, families: &[Family]) -> Option<Follower> {
        let data = self.model.runner.data;
        // A force into an input pushes all states that the input does.
        let pushed: Vec<(usize, f64)> = match entry {
            Entry::State(i) => vec![(i, 1.0)],
            Entry::Input(j) => {
                let column = self.vehicle.b.column(j);
                column.iter().copied().enumerate().filter(|(_, b)| *b != 0.0).collect()
            }
        };
        let probe = families.first()?.functions.first()?;
        let states: Vec<(usize, f64)> = pushed.iter().map(|(i, _)| (*i, self.slopes[*i])).collect();
        let forces = Forces::new(self.model, self.fit, self.vehicle, &states, probe);
        // The quickest frame sorts out, the others look at what is left.
        let [rest @ .., quick] = self.frames.as_slice() else { return None };
        let mut sorted: Vec<Weight> = Vec::new();
        for some in families.chunks(TOGETHER) {
            sorted.extend(self.weights(quick, &self.columns(&forces, &pushed, some)));
            self.keep(&mut sorted, SORTED_OUT);
        }
        let columns: Vec<Columns> = sorted.iter().map(|w| w.columns.clone()).collect();
        let mut weighed: Vec<(&Frame<'_>, Weight)> = Vec::new();
        for frame in rest {
            let mut own = self.weights(frame, &columns);
            self.keep(&mut own, WEIGHED);
            weighed.extend(own.into_iter().map(|w| (frame, w)));
        }
        self.keep(&mut sorted, WEIGHED);
        weighed.extend(sorted.into_iter().map(|w| (quick, w)));
        let looks = 2.0 * (families.len() as f64).ln();
        let bics = weighed.into_par_iter().map(|(frame, weight)| {
            let mut rest = self.fit.residual.clone();
            for (column, by) in weight.columns.samples.iter().zip(weight.by.iter()) {
                rest.iter_mut().zip(column).for_each(|(r, c)| *r -= by * c);
            }
            let bic = Noise::fit(data, &frame.without_nuisances(&rest)).bic(weight.by.len());
            (bic, weight.columns.words)
        });
        let (bic, words) = bics.min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some(Follower { gain: self.plain.bic(0) - bic - looks, words: on(self.vehicle, entry, &words) })
    }

    /// The likeliest force that switches with a state.
    fn relay(&self, state: usize, states: &[Signal]) -> Option<Follower> {
        let data = self.model.runner.data;
        let pushed = [(state, self.slopes[state])];
        let forces = Forces::new(self.model, self.fit, self.vehicle, &pushed, &states.first()?.values);
        let looks = 2.0 * ((states.len() * relays::looks()) as f64).ln();
        let bics = self.frames.iter().filter_map(|frame| {
            let relay = relays::likeliest(frame, &forces, states, true)?;
            let response = relay.response(frame, &forces, states)?;
            let rest: Vec<f64> = self.fit.residual.iter().zip(&response).map(|(r, c)| r - c).collect();
            let bic = Noise::fit(data, &frame.without_nuisances(&rest)).bic(1 + relays::NUMBERS);
            Some((bic, relay.words(states)))
        });
        let (bic, words) = bics.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let words = on(self.vehicle, Entry::State(state), &words);
        Some(Follower { gain: self.plain.bic(0) - bic - looks, words })
    }

    /// What families explain in a frame.
    fn weights(&self, frame: &Frame<'_>, families: &[Columns]) -> Vec<Weight> {
        let weights = families.par_iter().filter_map(|columns| {
            let (energy, by) = explained(frame, &columns.samples)?;
            Some(Weight { energy, by, columns: columns.clone() })
        });
        weights.collect()
    }

    /// Keeps those that explain most; each number costs.
    fn keep(&self, weights: &mut Vec<Weight>, most: usize) {
        let worth = |w: &Weight| w.energy - w.by.len() as f64 * (self.plain.rows as f64).ln();
        weights.sort_by(|a, b| worth(b).total_cmp(&worth(a)));
        weights.truncate(most);
    }

    /// What the functions of each family do to the samples; a family of which one could not be simulated is left out.
    fn columns(&self, forces: &Forces<'_>, pushed: &[(usize, f64)], families: &[Family]) -> Vec<Columns> {
        let data = self.model.runner.data;
        let functions: Vec<&[f64]> = families.iter().flat_map(|f| &f.functions).map(Vec::as_slice).collect();
        let mut sums: Vec<Option<Vec<f64>>> = vec![Some(vec![0.0; data.samples()]); functions.len()];
        let mut told = vec![0; functions.len()];
        for (state, index, response) in
            forces.each(&functions, |state, index, response| (state, index, response))
        {
            let by = pushed.iter().find(|(i, _)| *i == state).map_or(0.0, |(_, by)| *by);
            if let Some(sum) = &mut sums[index] {
                sum.iter_mut().zip(&response).for_each(|(s, r)| *s += by * r);
            }
            told[index] += 1;
        }
        let whole = sums.into_iter().zip(told).map(|(sum, told)| sum.filter(|_| told == pushed.len()));
        let mut whole = whole.map(|sum| {
            sum.map(|mut sum| {
                data.fill(&mut sum);
                sum
            })
        });
        let families = families.iter().filter_map(|f| {
            let own: Vec<Option<Vec<f64>>> = whole.by_ref().take(f.functions.len()).collect();
            let samples = own.into_iter().collect::<Option<Vec<_>>>().map(Arc::new)?;
            Some(Columns { words: f.words.as_str().into(), samples })
        });
        families.collect()
    }
}

/// What columns explain of a frame's residual together, and by how much of each.
fn explained(frame: &Frame<'_>, columns: &[Vec<f64>]) -> Option<(f64, DVector<f64>)> {
    let white: Vec<Vec<f64>> = columns.iter().map(|c| frame.project(c)).collect();
    let norms: Vec<f64> = white.iter().map(|w| dot(w, w).sqrt()).collect();
    if white.is_empty() || norms.iter().any(|n| !n.is_finite()) {
        return None;
    }
    let n = white.len();
    let gram = DMatrix::from_fn(n, n, |i, j| {
        if norms[i] * norms[j] > 0.0 { dot(&white[i], &white[j]) / (norms[i] * norms[j]) } else { 0.0 }
    });
    let product = |i: usize| if norms[i] > 0.0 { dot(&white[i], frame.residual()) / norms[i] } else { 0.0 };
    let right = DVector::from_fn(n, |i, _| product(i));
    let by = pseudo_inverse(&gram)? * &right;
    let energy = by.dot(&right);
    Some((energy, DVector::from_fn(n, |i, _| if norms[i] > 0.0 { by[i] / norms[i] } else { 0.0 })))
}
