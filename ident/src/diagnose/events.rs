//! When something may have happened: disturbances by their response at every time, transitions on a grid.

use rayon::prelude::*;
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;
use whirlstand_vehicle::{Effect, Kind};

use super::data::Data;
use super::library::{Candidate, Sizes, pulse, step};
use super::model::{Fit, Model};
use super::screen::Frame;

/// Times at which an event is tried.
const TIMES: usize = 600;
/// Spectra of all channels.
type Spectra = Vec<Vec<Complex<f64>>>;

/// Durations of a pulse, in shares of the record and in steps of the grid of times: each about 1.6 times the last.
const GROWTH: f64 = 1.6;

/// The best times for a step and for a pulse on every state, in a frame.
///
/// The model is taken as linear and constant here: the response to a disturbance at one time is that at another,
/// shifted. What is found is fitted with the simulator afterwards.
pub fn events(model: &Model<'_, '_>, fit: &Fit, frame: &Frame<'_>, sizes: &Sizes) -> Vec<Candidate> {
    let states = &model.runner.vehicle.states;
    let data = model.runner.data;
    let residual = transforms(data, frame.residual());
    let basis: Vec<_> = frame.basis().iter().map(|b| transforms(data, b)).collect();
    let found = (0..states.len())
        .into_par_iter()
        .filter_map(|i| on_state(model, fit, frame, sizes, i, (&residual, &basis)));
    found.flatten_iter().collect()
}

fn on_state(
    model: &Model<'_, '_>,
    fit: &Fit,
    frame: &Frame<'_>,
    sizes: &Sizes,
    state: usize,
    (residual, basis): (&Spectra, &[Spectra]),
) -> Option<Vec<Candidate>> {
    let place = &model.runner.vehicle.states[state].name;
    let data = model.runner.data;
    let size = sizes.slopes[state].max(1e-9);
    // Smaller than a nonlinear effect would notice, larger than rounding.
    let effect =
        Effect::new(Kind::StepDisturbance, place, &[("at_s", 0.0), ("magnitude", 1e-3 * size)]).ok()?;
    let mut vehicle = model.vehicle(&fit.values)?;
    vehicle.add_effect(effect).ok()?;
    let mut response = model.runner.run_vehicle(&vehicle, &fit.values[..model.states()])?;
    response.iter_mut().zip(&fit.predicted).for_each(|(r, y)| *r = (*r - y) / (1e-3 * size));
    let white = frame.noise().filter_all(data, &response);
    let every = data.steps.div_ceil(TIMES).max(1);
    let times = data.steps / every;
    let transforms = transforms(data, &white);
    let products = shifted(data, residual, &transforms, every, times);
    let overlaps: Vec<Vec<f64>> = basis.iter().map(|b| shifted(data, b, &transforms, every, times)).collect();
    // Energy of the response to a pulse of d grid steps within its first k steps.
    let energy = |d: usize| -> Vec<f64> {
        let mut total = vec![0.0; times + 1];
        for (channel, range) in data.channels.iter().zip(data.ranges()) {
            let h = &white[range];
            let lag = d * every / channel.stride;
            let mut sum = 0.0;
            let mut next = 0;
            for (t, slot) in total.iter_mut().enumerate() {
                let end = (t * every / channel.stride).min(h.len());
                while next < end {
                    let v = if lag > 0 && next >= lag { h[next] - h[next - lag] } else { h[next] };
                    sum += v * v;
                    next += 1;
                }
                *slot += sum;
            }
        }
        total
    };
    // (score, time, duration, amplitude)
    let best = |d: usize| {
        let energies = energy(d);
        let mut best = (0.0, 0, d, 0.0);
        // A pulse that does not end within the record is a step.
        let latest = if d > 0 { times - d } else { times };
        for t in 0..latest {
            let end = if d > 0 { t + d } else { times };
            let product = products[t] - if d > 0 { products[end] } else { 0.0 };
            let mut left = energies[times - t];
            let whole = left;
            for overlap in &overlaps {
                let o = overlap[t] - if d > 0 { overlap[end] } else { 0.0 };
                left -= o * o;
            }
            // What nuisances imitate almost wholly is no evidence.
            if left > 1e-3 * whole && product * product > best.0 * left {
                best = (product * product / left, t, d, product / left);
            }
        }
        best
    };
    let at = |t: usize| (t * every) as f64 * data.period_s;
    let mut durations = Vec::new();
    let mut d = 1.0f64;
    while (d as usize) < times / 2 {
        if durations.last() != Some(&(d as usize)) {
            durations.push(d as usize);
        }
        d = (d * GROWTH).max(d + 1.0);
    }
    let mut found = Vec::new();
    let (score, t, _, amplitude) = best(0);
    if score > 0.0 {
        found.push(step(place, at(t), amplitude, sizes, times as f64));
    }
    let looks = (times * durations.len()) as f64;
    let pulses = durations.iter().map(|d| best(*d));
    if let Some((score, t, d, amplitude)) = pulses.max_by(|a, b| a.0.total_cmp(&b.0))
        && score > 0.0
    {
        found.push(pulse(place, at(t), at(d), amplitude, sizes, looks));
    }
    Some(found)
}

/// Spectra of all channels, each padded so that no shift comes round.
fn transforms(data: &Data, samples: &[f64]) -> Vec<Vec<Complex<f64>>> {
    let mut planner = FftPlanner::new();
    data.ranges()
        .into_iter()
        .map(|range| {
            let length = (2 * range.len()).next_power_of_two();
            let mut buffer: Vec<Complex<f64>> =
                samples[range].iter().map(|v| Complex::new(*v, 0.0)).collect();
            buffer.resize(length, Complex::new(0.0, 0.0));
            planner.plan_fft_forward(length).process(&mut buffer);
            buffer
        })
        .collect()
}

/// Products of samples, given by their spectra, with a response that begins at each time of the grid; 0 at its end.
fn shifted(
    data: &Data,
    of: &[Vec<Complex<f64>>],
    response: &[Vec<Complex<f64>>],
    every: usize,
    times: usize,
) -> Vec<f64> {
    let mut planner = FftPlanner::new();
    let mut products = vec![0.0; times + 1];
    for (channel, (of, response)) in data.channels.iter().zip(of.iter().zip(response)) {
        let mut buffer: Vec<Complex<f64>> = of.iter().zip(response).map(|(a, b)| a * b.conj()).collect();
        let scale = 1.0 / buffer.len() as f64;
        planner.plan_fft_inverse(buffer.len()).process(&mut buffer);
        for (t, product) in products.iter_mut().take(times).enumerate() {
            *product += buffer[t * every / channel.stride].re * scale;
        }
    }
    products
}
