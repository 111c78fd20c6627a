//! Candidate times of events: disturbances by their response at every time, transitions on a time grid.

use crate::thresholds::{DURATION_GROWTH, MIN_EVENT_TIMES};
use rayon::prelude::*;
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;

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
    /// FFT length of each channel, padded so that no shift wraps around, and of the products at the grid's
    /// times.
    lengths: Vec<(usize, usize)>,
}

impl Grid {
    fn new(data: &Data) -> Self {
        let stride = data.channels.iter().map(|c| c.stride).fold(1, lcm);
        let mut every = stride;
        while 2 * every * MIN_EVENT_TIMES <= data.steps {
            every *= 2;
        }
        let lengths = data.channels.iter().zip(data.ranges()).map(|(channel, range)| {
            let short = (2 * range.len()).div_ceil(every / channel.stride).next_power_of_two();
            (short * (every / channel.stride), short)
        });
        Self { every, times: data.steps / every, lengths: lengths.collect() }
    }
}

fn lcm(a: usize, b: usize) -> usize {
    let (mut x, mut y) = (a, b);
    while y > 0 {
        (x, y) = (y, x % y);
    }
    a / x * b
}

/// Spectra of all channels, from 0 to half the sampling rate.
type Spectra = Vec<Vec<Complex<f64>>>;

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
    let data = model.free_run.data;
    let grid = Grid::new(data);
    let residual = transforms(data, &grid, score_test.residual());
    let basis: Vec<Spectra> = score_test.basis().par_iter().map(|b| transforms(data, &grid, b)).collect();
    let found = (0..states.len()).into_par_iter().filter_map(|i| {
        let search =
            EventSearch::new((data, &grid), score_test, responses.step(i)?, (&residual, basis.as_slice()));
        let place = &states[i].name;
        Some([search.step(place, sizes), search.pulse(place, sizes)].into_iter().flatten())
    });
    found.flatten_iter().collect()
}

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

impl<'a> EventSearch<'a> {
    fn new(
        (data, grid): (&'a Data, &'a Grid),
        score_test: &ScoreTest<'_>,
        response: &[f64],
        (residual, basis): (&Spectra, &[Spectra]),
    ) -> Self {
        let white = score_test.noise().filter_all(data, response);
        let transforms = transforms(data, grid, &white);
        let products = shifted(residual, &transforms, grid);
        let overlaps = basis.iter().map(|b| shifted(b, &transforms, grid)).collect();
        Self { data, grid, white, products, overlaps }
    }

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

/// Spectra of all channels, each padded so that no shift wraps around.
fn transforms(data: &Data, grid: &Grid, samples: &[f64]) -> Spectra {
    let mut planner = FftPlanner::new();
    data.ranges()
        .into_iter()
        .zip(&grid.lengths)
        .map(|(range, (length, _))| {
            let mut buffer: Vec<Complex<f64>> =
                samples[range].iter().map(|v| Complex::new(*v, 0.0)).collect();
            buffer.resize(*length, Complex::new(0.0, 0.0));
            planner.plan_fft_forward(*length).process(&mut buffer);
            buffer.truncate(length / 2 + 1);
            buffer
        })
        .collect()
}

/// Products of samples, given by their spectra, with a response that begins at each time of the grid; 0 at its end.
///
/// Only values at the grid times are needed: times in between may alias in the inverse transform.
fn shifted(of: &Spectra, response: &Spectra, grid: &Grid) -> Vec<f64> {
    let mut planner = FftPlanner::new();
    let mut products = vec![0.0; grid.times + 1];
    let mut short = 0;
    let mut folded: Vec<Complex<f64>> = Vec::new();
    let mut back = |folded: &mut Vec<Complex<f64>>| {
        if !folded.is_empty() {
            planner.plan_fft_inverse(folded.len()).process(folded);
            products.iter_mut().take(grid.times).zip(&*folded).for_each(|(p, f)| *p += f.re);
            folded.clear();
        }
    };
    for ((of, response), (length, own)) in of.iter().zip(response).zip(&grid.lengths) {
        if *own != short {
            back(&mut folded);
            (short, folded) = (*own, vec![Complex::new(0.0, 0.0); *own]);
        }
        let scale = 2.0 / *length as f64;
        let edge = |k: usize| k == 0 || 2 * k == *length;
        for (block, (a, b)) in of.chunks(short).zip(response.chunks(short)).enumerate() {
            for (k, (f, (a, b))) in folded.iter_mut().zip(a.iter().zip(b)).enumerate() {
                let share = if edge(block * short + k) { 0.5 * scale } else { scale };
                *f += a * b.conj() * share;
            }
        }
    }
    back(&mut folded);
    products
}
