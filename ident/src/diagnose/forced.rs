//! Whether what looks like turbulence follows a signal: a force that is a function of inputs and states is as smooth.
//!
//! Turbulence explains any slow force, as it has one value a step. A force that follows a signal needs a few numbers
//! only: where these few explain more than turbulence does, in BIC, it is none.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};

use super::adequacy::{THRESHOLDS, relayed, scale, states};
use super::forces::Forces;
use super::model::{Fit, Model, dot};
use super::noise::Noise;
use super::screen::Frame;
use super::survey::Scene;
use crate::identify::normal::pseudo_inverse;

/// Share of a signal's largest magnitude from which on a switch is through.
const SMALL: f64 = 0.05;
/// How often an effect may swing over the record.
const SWINGS: usize = 6;
/// Half waves of a force over the reach of a state.
const WAVES: usize = 4;
/// Families of each frame whose noise model is fitted anew.
const WEIGHED: usize = 6;

/// Functions of the same signal, one value a step each.
type Family = Vec<Vec<f64>>;

/// Gain in BIC of the likeliest family of forces on a state, over a fit under noise models of single channels.
///
/// `None` when nothing could be tried.
pub(super) fn gain(model: &Model<'_, '_>, fit: &Fit, state: usize, scene: &Scene<'_>) -> Option<f64> {
    let data = model.runner.data;
    let vehicle = model.vehicle(&fit.values)?;
    let families = families(model, &states(&vehicle, model, fit)?);
    let functions: Vec<&[f64]> = families.iter().flatten().map(Vec::as_slice).collect();
    let forces = Forces::new(model, fit, &vehicle, &[(state, scene.sizes.slopes[state])], functions.first()?);
    let mut responses = forces.each(&functions, |_, index, mut response| {
        data.fill(&mut response);
        (index, response)
    });
    // Some could not be simulated.
    responses.sort_by_key(|(index, _)| *index);
    let family = |index: usize| {
        let ends = families.iter().scan(0, |end, f| {
            *end += f.len();
            Some(*end)
        });
        ends.take_while(|end| *end <= index).count()
    };
    let mut columns: Vec<Vec<&[f64]>> = vec![Vec::new(); families.len()];
    responses.iter().for_each(|(index, response)| columns[family(*index)].push(response));
    let plain = Noise::fit(data, &fit.residual);
    let mut frames = vec![Frame::new(data, &plain.noise, &fit.residual, &fit.columns)];
    if scene.declared.iter().all(|d| *d > 0.0) {
        frames.push(Frame::new(data, &Noise::white(scene.declared), &fit.residual, &fit.columns));
    }
    let looks = 2.0 * (families.len() as f64).ln();
    let best = frames.iter().filter_map(|frame| {
        let mut weighed: Vec<(usize, f64, DVector<f64>)> = columns
            .par_iter()
            .enumerate()
            .filter_map(|(i, columns)| explained(frame, columns).map(|(energy, by)| (i, energy, by)))
            .collect();
        weighed.sort_by(|a, b| b.1.total_cmp(&a.1));
        weighed.truncate(WEIGHED);
        let bics = weighed.into_par_iter().map(|(i, _, by)| {
            let mut rest = fit.residual.clone();
            for (column, by) in columns[i].iter().zip(by.iter()) {
                rest.iter_mut().zip(*column).for_each(|(r, c)| *r -= by * c);
            }
            Noise::fit(data, &frame.without_nuisances(&rest)).bic(by.len())
        });
        bics.min_by(f64::total_cmp)
    });
    best.min_by(f64::total_cmp).map(|bic| plain.bic(0) - bic - looks)
}

/// What columns explain of a frame's residual together, and by how much of each.
fn explained(frame: &Frame<'_>, columns: &[&[f64]]) -> Option<(f64, DVector<f64>)> {
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

/// Functions that a force could be: of an input or a state, smooth, swinging, switched or in waves, and products.
fn families(model: &Model<'_, '_>, states: &[Vec<f64>]) -> Vec<Family> {
    let data = model.runner.data;
    let mut inputs: Vec<Vec<f64>> = (0..data.m).map(|j| data.input(j).collect()).collect();
    inputs.iter_mut().for_each(|u| scale(u));
    let map = |v: &[f64], f: &dyn Fn(f64) -> f64| v.iter().map(|v| f(*v)).collect::<Vec<f64>>();
    let smooth = |v: &[f64]| -> Family {
        let shapes: [&dyn Fn(f64) -> f64; 6] =
            [&|v| v, &f64::abs, &|v| v * v, &|v| v * v.abs(), &|v| v * v * v, &|v| (v / SMALL).tanh()];
        shapes.iter().map(|f| map(v, f)).collect()
    };
    let swinging = |v: &[f64]| -> Family {
        let at = |turns: usize, phase: f64| {
            let angle = move |k: usize| TAU * (turns * k) as f64 / data.steps as f64 + phase;
            v.iter().enumerate().map(|(k, v)| v * angle(k).sin()).collect()
        };
        (1..=SWINGS).flat_map(|turns| [at(turns, 0.0), at(turns, 0.5 * PI)]).collect()
    };
    let waves = |v: &[f64]| -> Family {
        let wave = |n: usize, phase: f64| map(v, &|v| (0.5 * PI * n as f64 * v + phase).sin());
        (1..=WAVES).flat_map(|n| [wave(2 * n, 0.0), wave(2 * n, 0.5 * PI)]).collect()
    };
    let mut all: Vec<Family> = Vec::new();
    for signal in inputs.iter().chain(states) {
        let switched = THRESHOLDS.iter().map(|t| relayed(signal, *t)).collect();
        all.extend([smooth(signal), swinging(signal), switched]);
    }
    all.extend(states.iter().map(|x| waves(x)));
    for (i, x) in states.iter().enumerate() {
        let others = states[i + 1..].iter().chain(&inputs);
        all.extend(others.map(|y| vec![x.iter().zip(y).map(|(x, y)| x * y).collect()]));
    }
    all
}
