//! Whether the causes that were chosen are believed: what they leave must be noise, and nothing simpler may do as well.

use super::adequacy::Lack;
use super::forced::{self, Follower};
use super::judge::LEAST_BIC;
use super::library::Candidate;
use super::model::dot;
use super::noise::Noise;
use super::select::Selection;
use super::survey::Scene;
use crate::stats::rms;

/// A channel is louder than its sensor from this many times the declared noise on.
const LOUD: f64 = 1.6;
/// Causes that leave so much of what they explain, beyond the declared noise, are not all.
const LEFT: f64 = 0.5;
/// A single cause is compared with forces that follow a signal when chance leaves as much as it does so rarely.
const RARE: f64 = 0.15;

/// Takes back the causes that are not believed, with their gains in BIC. `start` are the values without any cause.
/// Beside turbulence, which explains part of what they leave, only the lack of fit speaks against them. A force that does
/// as well is left in `like`.
pub fn withhold(
    selection: &mut Selection<'_, '_>,
    (lack, like): (&mut Lack, &mut Option<Follower>),
    turbulent: bool,
    start: Vec<f64>,
    scene: &Scene<'_>,
) -> Vec<(Candidate, f64)> {
    let Some(without) = selection.without_causes(start) else { return Vec::new() };
    let explained = explained(selection, &without);
    let mut doubted = lack.is_told() && lack.outweighs(explained);
    if !doubted && !turbulent {
        let several = selection.model.terms.len() > without.model.terms.len() + 1;
        let asked = several || lack.one.chance < RARE || lack.all.chance < RARE;
        let imitated = if asked { imitated(selection, &without, scene, several) } else { None };
        if let Some(by) = &imitated {
            *lack = lack.or_one(by.gain);
        }
        doubted = imitated.is_some() || drowned(selection, &without, scene.declared);
        *like = imitated.or(like.take());
    }
    if !doubted {
        return Vec::new();
    }
    let gains = selection.accepted.iter().map(|a| a.weight.delta_bic);
    let all = selection.model.terms.iter().cloned().zip(gains);
    let taken = all.filter(|(c, _)| !without.model.terms.contains(c)).collect();
    *selection = without;
    taken
}

/// Energy that the causes explain, in the scale of detectability. Together they may explain less than each for itself:
/// pushes that go against each other, say. Of three or more a share counts, as many together explain much that is none of
/// them.
fn explained(selection: &Selection<'_, '_>, without: &Selection<'_, '_>) -> f64 {
    let each: f64 = selection.accepted.iter().map(|a| a.weight.detectability).sum();
    let (with, less) = (&selection.fit, &without.fit);
    let moved: Vec<f64> = with.predicted.iter().zip(&less.predicted).map(|(a, b)| a - b).collect();
    let white = with.profile.noise.whiten(selection.model.runner.data, &moved);
    each.min(dot(&white, &white)) / selection.accepted.len().saturating_sub(1).max(1) as f64
}

/// One force that follows a signal, where it gains as much as all causes together do. Several causes must do plainly better
/// than one force, and one force than one cause.
fn imitated(
    selection: &Selection<'_, '_>,
    without: &Selection<'_, '_>,
    scene: &Scene<'_>,
    several: bool,
) -> Option<Follower> {
    let data = selection.model.runner.data;
    let bic = |s: &Selection<'_, '_>| Noise::fit(data, &s.fit.residual).bic(s.model.parameters());
    let own = bic(without) - bic(selection);
    let lead = if several { -LEAST_BIC } else { LEAST_BIC };
    let rival = forced::rival((&without.model, &without.fit), (&selection.model, &selection.fit), scene)?;
    (rival.gain > own + lead).then_some(rival)
}

/// True when the causes leave much beyond the declared noise: then they are a part of something else.
fn drowned(selection: &Selection<'_, '_>, without: &Selection<'_, '_>, declared: &[f64]) -> bool {
    let (mut left, mut explained) = (0.0, 0.0);
    let data = selection.model.runner.data;
    for ((channel, range), declared) in data.channels.iter().zip(data.ranges()).zip(declared) {
        let power = |residual: &[f64]| {
            let good = residual[range.clone()].iter().zip(&channel.good).filter(|(_, good)| **good);
            (rms(&good.map(|(r, _)| *r).collect::<Vec<_>>()) / declared).powi(2)
        };
        let (before, after) = (power(&without.fit.residual), power(&selection.fit.residual));
        explained += before - after;
        left += if after > LOUD * LOUD { after - 1.0 } else { 0.0 };
    }
    left > LEFT * explained.max(0.0)
}
