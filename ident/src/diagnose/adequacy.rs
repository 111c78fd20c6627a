//! Whether what is left is noise: a test against everything smooth that the table does not name.
//!
//! Products and powers of inputs, states and outputs, as forces on the states and as errors of the sensors, are fitted
//! to the whitened residual all at once. Nobody needs to know which it is: if together they explain more than chance
//! would, the named causes are not the whole truth, and perhaps not the truth at all.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use whirlstand_vehicle::{Simulator, Vehicle};

use super::library::Sizes;
use super::model::{Fit, Model, dot};
use super::screen::Frame;

/// Forces are tried on so many states at most.
const FORCED: usize = 3;
/// Products of states are tried up to so many states.
const FEW_STATES: usize = 4;

/// What is left, against chance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Left {
    /// Energy of what is left beyond chance, in the scale of detectability.
    pub energy: f64,
    /// By how many standard deviations that is more than chance.
    pub sigmas: f64,
}

/// Tests the residual of a fit, but for the channels that are `known` to have errors of their own. `None` when nothing
/// could be tried.
pub fn left(model: &Model<'_, '_>, fit: &Fit, sizes: &Sizes, known: &[usize]) -> Option<Left> {
    let data = model.runner.data;
    let frame = Frame::new(data, &fit.profile.noise, &fit.residual, &fit.columns);
    let ranges = data.ranges();
    let unknown = |mut samples: Vec<f64>| {
        known.iter().for_each(|c| samples[ranges[*c].clone()].fill(0.0));
        samples
    };
    let vehicle = model.vehicle(&fit.values)?;
    let states = states(&vehicle, model, fit)?;
    let functions = functions(model, &states);
    let forced: Vec<usize> = {
        let dynamic = |i: &usize| {
            let row = vehicle.a.row(*i);
            row.iter().filter(|v| **v != 0.0).count() > 1 || vehicle.b.row(*i).iter().any(|v| *v != 0.0)
        };
        let mut all: Vec<usize> = (0..vehicle.states.len()).filter(dynamic).collect();
        let driven = |i: usize| vehicle.b.row(i).iter().any(|v| *v != 0.0);
        all.sort_by_key(|i| !driven(*i));
        all.truncate(FORCED);
        all
    };
    let pairs: Vec<(usize, &Vec<f64>)> =
        forced.iter().flat_map(|s| functions.iter().map(move |f| (*s, f))).collect();
    let mut columns: Vec<Vec<f64>> = pairs
        .par_iter()
        .filter_map(|(state, force)| {
            let response = response(model, fit, &vehicle, *state, force, sizes.slopes[*state])?;
            Some(unknown(frame.signature(&response)))
        })
        .collect();
    columns.extend(sensors(model, fit).iter().map(|s| unknown(frame.signature(s))));
    columns.retain_mut(|c| {
        let norm = dot(c, c).sqrt();
        // What nuisances explain tells nothing.
        let told = norm > 1e-6 && norm.is_finite();
        if told {
            c.iter_mut().for_each(|v| *v /= norm);
        }
        told
    });
    let n = columns.len();
    if n == 0 {
        return None;
    }
    let rows: Vec<Vec<f64>> =
        (0..n).into_par_iter().map(|i| (0..=i).map(|j| dot(&columns[i], &columns[j])).collect()).collect();
    let gram = DMatrix::from_fn(n, n, |i, j| rows[i.max(j)][i.min(j)]);
    let right = DVector::from_iterator(n, columns.iter().map(|c| dot(c, frame.residual())));
    // Directions that repeat others carry rounding only.
    let eigen = gram.symmetric_eigen();
    let strongest = eigen.eigenvalues.max();
    let (mut energy, mut degrees) = (0.0, 0.0);
    for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        if *value > 1e-6 * strongest {
            energy += vector.dot(&right).powi(2) / value;
            degrees += 1.0;
        }
    }
    Some(Left { energy: energy - degrees, sigmas: (energy - degrees) / (2.0f64 * degrees).sqrt() })
}

/// States of the fitted run, over the steps of the record, each over its largest magnitude.
fn states(vehicle: &Vehicle, model: &Model<'_, '_>, fit: &Fit) -> Option<Vec<Vec<f64>>> {
    let data = model.runner.data;
    let n = vehicle.states.len();
    let fresh = Simulator::expected(vehicle, data.period_s).ok()?;
    let mut simulator = fresh.clone();
    let mut states = vec![Vec::with_capacity(data.steps); n];
    for (k, u) in data.inputs.chunks_exact(data.m).enumerate() {
        if let Some(record) = data.starts.iter().position(|s| *s == k) {
            simulator = fresh.clone();
            simulator.set_state(&fit.values[record * n..(record + 1) * n]);
        }
        states.iter_mut().zip(simulator.state()).for_each(|(column, x)| column.push(*x));
        simulator.step(u);
    }
    states.iter_mut().for_each(|s| scale(s));
    Some(states)
}

fn scale(values: &mut [f64]) {
    let peak = values.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    if peak > 0.0 {
        values.iter_mut().for_each(|v| *v /= peak);
    }
}

/// Functions of time that a force could follow.
fn functions(model: &Model<'_, '_>, states: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let data = model.runner.data;
    let mut inputs: Vec<Vec<f64>> = (0..data.m).map(|j| data.input(j).collect()).collect();
    inputs.iter_mut().for_each(|u| scale(u));
    let mut all = Vec::new();
    let map = |v: &[f64], f: fn(f64) -> f64| v.iter().map(|v| f(*v)).collect::<Vec<f64>>();
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).collect::<Vec<f64>>();
    for u in &inputs {
        all.extend([map(u, |u| u), map(u, f64::abs), map(u, |u| u * u), map(u, |u| u * u * u)]);
    }
    for (i, x) in states.iter().enumerate() {
        all.extend([map(x, |x| x), map(x, |x| x * x), map(x, |x| x * x.abs()), map(x, |x| x * x * x)]);
        if states.len() <= FEW_STATES {
            all.extend(states[i + 1..].iter().map(|y| product(x, y)));
            all.extend(inputs.iter().map(|u| product(x, u)));
        }
    }
    all
}

/// What a force on a state does to the samples, linearly.
fn response(
    model: &Model<'_, '_>,
    fit: &Fit,
    vehicle: &Vehicle,
    state: usize,
    force: &[f64],
    slope: f64,
) -> Option<Vec<f64>> {
    let data = model.runner.data;
    let n = vehicle.states.len();
    let size = 1e-3 * slope.max(1e-9);
    let fresh = Simulator::expected(vehicle, data.period_s).ok()?;
    let mut simulator = fresh.clone();
    let mut samples = vec![0.0; data.samples()];
    let ranges = data.ranges();
    let mut derivative = vec![0.0; n];
    for (k, u) in data.inputs.chunks_exact(data.m).enumerate() {
        if let Some(record) = data.starts.iter().position(|s| *s == k) {
            simulator = fresh.clone();
            simulator.set_state(&fit.values[record * n..(record + 1) * n]);
        }
        derivative[state] = size * force[k];
        simulator.disturb(&derivative);
        simulator.apply(u);
        let y = simulator.measure();
        for (channel, range) in data.channels.iter().zip(&ranges) {
            if k >= channel.first && (k - channel.first) % channel.stride == 0 {
                let sample = (k - channel.first) / channel.stride;
                if sample < range.len() {
                    samples[range.start + sample] = y[channel.output];
                }
            }
        }
        simulator.advance();
    }
    samples.iter_mut().zip(&fit.predicted).for_each(|(y, p)| *y = (*y - p) / size);
    (!simulator.diverged()).then_some(samples)
}

/// Errors of a sensor that follow what it measures, or what another measures.
fn sensors(model: &Model<'_, '_>, fit: &Fit) -> Vec<Vec<f64>> {
    let data = model.runner.data;
    let ranges = data.ranges();
    let mut all = Vec::new();
    for range in &ranges {
        let mut own = fit.predicted[range.clone()].to_vec();
        scale(&mut own);
        for f in [|v: f64| v, |v: f64| v * v, |v: f64| v * v.abs(), |v: f64| v * v * v] {
            let mut column = vec![0.0; fit.predicted.len()];
            column[range.clone()].iter_mut().zip(&own).for_each(|(c, v)| *c = f(*v));
            all.push(column);
        }
    }
    all
}
