//! Candidate times of events: disturbances by their response at every time, transitions on a time grid.

use std::sync::Arc;

use crate::thresholds::{DURATION_GROWTH, MIN_EVENT_TIMES};
use rayon::prelude::*;
use whirlstand_linalg::C64;
use whirlstand_linalg::fft::{self, Fft};

use crate::candidates::library::{Candidate, Sizes, pulse, step};
use crate::data::record::Data;
use crate::model::fit::Model;
use crate::model::score_test::ScoreTest;
use crate::model::step_response::Responses;

/// The grid of candidate event times, with what is needed to evaluate all of them by FFT.
struct Grid {
    /// Steps between two candidate times: a multiple of every channel's stride.
    every: usize,
    times: usize,
    channels: Vec<Transform>,
}

/// Fourier transforms of a channel.
struct Transform {
    /// Padded so that no shift wraps around.
    forward: Arc<dyn Fft<f64>>,
    /// Of the products at the grid's times.
    inverse: Arc<dyn Fft<f64>>,
}

impl Grid {
    fn new(data: &Data) -> Self {
        let stride = data.channels.iter().map(|c| c.stride).fold(1, lcm);
        let mut every = stride;
        while 2 * every * MIN_EVENT_TIMES <= data.steps {
            every *= 2;
        }
        let channels = data.channels.iter().zip(data.ranges()).map(|(channel, range)| {
            let short = (2 * range.len()).div_ceil(every / channel.stride).next_power_of_two();
            Transform {
                forward: fft::forward(short * (every / channel.stride)),
                inverse: fft::inverse(short),
            }
        });
        Self { every, times: data.steps / every, channels: channels.collect() }
    }
}

fn lcm(a: usize, b: usize) -> usize {
    let (mut x, mut y) = (a, b);
    while y > 0 {
        (x, y) = (y, x % y);
    }
    a / x * b
}

/// The best times for a step and for a pulse on every state, by a score test.
///
/// The model is assumed linear and time-invariant: the responses to a disturbance at different times are
/// shifted copies. The events found are refitted with the simulator afterwards.
pub fn events(
    model: &Model<'_, '_>,
    score_test: &ScoreTest<'_>,
    sizes: &Sizes,
    responses: &Responses,
) -> Vec<Candidate> {
    let states = &model.free_run.vehicle.states;
    let (data, noise) = (model.free_run.data, score_test.noise());
    let grid = Grid::new(data);
    let white = |i: &usize| Some((*i, noise.filter_all(data, responses.step(*i)?)));
    let few = if data.is_long() { FEW_STATES } else { states.len().max(1) };
    let all: Vec<usize> = (0..states.len()).collect();
    let of = |some: &[usize]| -> Vec<Candidate> {
        let responses: Vec<(usize, Vec<f64>)> = some.par_iter().filter_map(white).collect();
        let shifted = shifted(score_test, &responses, &grid);
        let found = responses.into_par_iter().zip(shifted).map(|((i, white), (products, overlaps))| {
            let search = EventSearch { data, grid: &grid, white, products, overlaps };
            let place = &states[i].name;
            [search.step(place, sizes), search.pulse(place, sizes)].into_iter().flatten()
        });
        found.flatten_iter().collect()
    };
    all.chunks(few).flat_map(of).collect()
}

/// Number of states whose responses are whitened at once in a long record. Cost: half the memory, and the spectra
/// of the nuisances once more for every so many states.
const FEW_STATES: usize = 4;

/// An event at the grid time with the highest score.
#[derive(Clone, Copy)]
struct Event {
    score: f64,
    /// Start of the event, in steps of the grid.
    at: usize,
    /// Duration of the event, in steps of the grid; 0 for one that does not end.
    lasts: usize,
    amplitude: f64,
}

/// Search over all events on one state.
struct EventSearch<'a> {
    data: &'a Data,
    grid: &'a Grid,
    /// Whitened response to a step at the beginning of the record.
    white: Vec<f64>,
    /// Inner product of the residual with the response shifted to every grid time.
    products: Vec<f64>,
    /// Inner products of every nuisance with the response shifted to every grid time.
    overlaps: Vec<Vec<f64>>,
}

impl EventSearch<'_> {
    /// Energy of the response to a pulse of `d` grid steps within its first k steps.
    fn energies(&self, d: usize) -> Vec<f64> {
        let (data, Grid { every, times, .. }) = (self.data, self.grid);
        let mut total = vec![0.0; times + 1];
        for (channel, range) in data.channels.iter().zip(data.ranges()) {
            let h = &self.white[range];
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
    }

    /// The event of the given length with the highest score.
    fn best(&self, d: usize) -> Event {
        let times = self.grid.times;
        let energies = self.energies(d);
        let mut best = Event { score: 0.0, at: 0, lasts: d, amplitude: 0.0 };
        // A pulse that does not end within the record is a step.
        let latest = if d > 0 { times - d } else { times };
        for t in 0..latest {
            let end = if d > 0 { t + d } else { times };
            let product = self.products[t] - if d > 0 { self.products[end] } else { 0.0 };
            let mut left = energies[times - t];
            let whole = left;
            for overlap in &self.overlaps {
                let o = overlap[t] - if d > 0 { overlap[end] } else { 0.0 };
                left -= o * o;
            }
            // An event that nuisances reproduce almost entirely is no evidence.
            if left > 1e-3 * whole && product * product > best.score * left {
                best = Event { score: product * product / left, at: t, lasts: d, amplitude: product / left };
            }
        }
        best
    }

    fn seconds(&self, steps: usize) -> f64 {
        (steps * self.grid.every) as f64 * self.data.period_s
    }

    /// Time of a grid step, s, on the clock of the effects.
    fn time(&self, steps: usize) -> f64 {
        self.data.time_s(0) + self.seconds(steps)
    }

    fn step(&self, place: &str, sizes: &Sizes) -> Option<Candidate> {
        let Event { score, at, amplitude, .. } = self.best(0);
        (score > 0.0).then(|| step(place, self.time(at), amplitude, sizes, self.grid.times as f64))
    }

    fn pulse(&self, place: &str, sizes: &Sizes) -> Option<Candidate> {
        let times = self.grid.times;
        let mut durations = Vec::new();
        let mut d = 1.0f64;
        while (d as usize) < times / 2 {
            if durations.last() != Some(&(d as usize)) {
                durations.push(d as usize);
            }
            d = (d * DURATION_GROWTH).max(d + 1.0);
        }
        let pulses = durations.iter().map(|d| self.best(*d));
        let mut top = pulses.max_by(|a, b| a.score.total_cmp(&b.score)).filter(|top| top.score > 0.0)?;
        // A gradient-based fit would stay at the sample nearest to the end of the pulse.
        let mut step = top.lasts / 4;
        while step > 0 {
            for d in [top.lasts - step, top.lasts + step] {
                let next = self.best(d.clamp(1, times - 1));
                if next.score > top.score {
                    top = next;
                }
            }
            step /= 2;
        }
        let looks = (times * durations.len()) as f64;
        Some(pulse(place, self.time(top.at), self.seconds(top.lasts), top.amplitude, sizes, looks))
    }
}

/// Inner products of the residual, and of every nuisance, with each response when it begins at each time of the
/// grid. Channel by channel: the spectra of all channels of all nuisances would be several times as large as the
/// record.
fn shifted(
    score_test: &ScoreTest<'_>,
    responses: &[(usize, Vec<f64>)],
    grid: &Grid,
) -> Vec<(Vec<f64>, Vec<Vec<f64>>)> {
    let basis = score_test.basis();
    let sums = || (0..=basis.len()).map(|_| Products::new(grid)).collect();
    let mut all: Vec<Vec<Products>> = responses.iter().map(|_| sums()).collect();
    for (range, transform) in score_test.data().ranges().into_iter().zip(&grid.channels) {
        let of = |b: usize| if b == 0 { score_test.residual() } else { &basis[b - 1] };
        let of = (0..=basis.len()).into_par_iter().map(|b| transform.spectrum(&of(b)[range.clone()]));
        let of: Vec<Vec<C64>> = of.collect();
        all.par_iter_mut().zip(responses).for_each(|(sums, (_, response))| {
            let response = transform.spectrum(&response[range.clone()]);
            sums.iter_mut().zip(&of).for_each(|(sum, of)| sum.add(of, &response, transform));
        });
    }
    let split = |sums: Vec<Products>| {
        let mut sums = sums.into_iter().map(Products::finish);
        (sums.next().unwrap_or_default(), sums.collect())
    };
    all.into_par_iter().map(split).collect()
}

impl Transform {
    /// Spectrum from 0 to half the sampling rate.
    fn spectrum(&self, samples: &[f64]) -> Vec<C64> {
        let length = self.forward.len();
        let mut buffer: Vec<C64> = Vec::with_capacity(length);
        buffer.extend(samples.iter().map(|v| C64::new(*v, 0.0)));
        buffer.resize(length, C64::new(0.0, 0.0));
        self.forward.process(&mut buffer);
        buffer.truncate(length / 2 + 1);
        buffer.shrink_to_fit();
        buffer
    }
}

/// A spectrum with its inverse transform. Only values at the grid times are needed: times in between may alias.
type Folded = (Vec<C64>, Arc<dyn Fft<f64>>);

/// Products of samples with a response that begins at each time of the grid, summed over the channels; 0 at the
/// grid's end.
struct Products<'g> {
    grid: &'g Grid,
    values: Vec<f64>,
    /// What is still to be added to the values.
    folded: Option<Folded>,
}

impl<'g> Products<'g> {
    fn new(grid: &'g Grid) -> Self {
        Self { grid, values: vec![0.0; grid.times + 1], folded: None }
    }

    /// Adds a channel, given by its spectra.
    fn add(&mut self, of: &[C64], response: &[C64], transform: &Transform) {
        let (length, short) = (transform.forward.len(), transform.inverse.len());
        if self.folded.as_ref().is_some_and(|(folded, _)| folded.len() != short) {
            self.transform_back();
        }
        let new = || (vec![C64::new(0.0, 0.0); short], Arc::clone(&transform.inverse));
        let (folded, _) = self.folded.get_or_insert_with(new);
        let scale = 2.0 / length as f64;
        let edge = |k: usize| k == 0 || 2 * k == length;
        for (block, (a, b)) in of.chunks(short).zip(response.chunks(short)).enumerate() {
            for (k, (f, (a, b))) in folded.iter_mut().zip(a.iter().zip(b)).enumerate() {
                let share = if edge(block * short + k) { 0.5 * scale } else { scale };
                *f += a * b.conj() * share;
            }
        }
    }

    fn transform_back(&mut self) {
        if let Some((mut folded, inverse)) = self.folded.take() {
            inverse.process(&mut folded);
            self.values.iter_mut().take(self.grid.times).zip(folded).for_each(|(p, f)| *p += f.re);
        }
    }

    fn finish(mut self) -> Vec<f64> {
        self.transform_back();
        self.values
    }
}
