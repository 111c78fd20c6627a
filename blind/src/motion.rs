//! Integrates a flight from one discontinuity to the next, and takes its measurements at the samples.

use super::error::BlindError;
use super::integrator::{Integrator, Line};
use super::signal::Signal;
use super::truth_model::TruthModel;

/// Times closer than this count as equal, s.
const SAME: f64 = 1e-10;
/// Magnitude above which a state has diverged.
const LARGEST: f64 = 1e9;

/// A record of the motion at the sample times.
#[derive(Debug, Clone)]
pub(crate) struct Motion {
    pub samples: usize,
    /// States at the sample times (samples x states).
    pub states: Vec<f64>,
    /// Measured outputs (samples x outputs), after sensor lags and delays.
    pub sensed: Vec<f64>,
}

/// Position in a signal that is read in the order of time.
#[derive(Debug, Clone, Copy, Default)]
struct Cursor {
    next: usize,
}

impl Cursor {
    /// The linear piece of the signal that holds from `t` on.
    fn line(&mut self, signal: &Signal, t: f64) -> Line {
        let pieces = signal.pieces();
        while pieces.get(self.next).is_some_and(|p| p.from <= t + SAME) {
            self.next += 1;
        }
        match self.next.checked_sub(1).map(|i| pieces[i]) {
            Some(p) => Line { value: p.value + p.slope * (t - p.from), slope: p.slope },
            None => Line { value: signal.rest(), slope: 0.0 },
        }
    }
}

/// A flight in progress, integrated from one time at which a signal may jump to the next.
pub(crate) struct Flight<'a> {
    model: &'a TruthModel,
    run: Integrator<'a>,
    cursors: Vec<Cursor>,
    push_cursors: Vec<Cursor>,
    period_s: f64,
    next_sample: usize,
    /// For each delayed output the next sample to record; empty before the start.
    looks: Vec<usize>,
    pub motion: Motion,
}

impl<'a> Flight<'a> {
    /// The flight before its start.
    pub fn new(model: &'a TruthModel, x0: &[f64], period_s: f64, samples: usize) -> Self {
        let outputs = model.sensor_delays.len();
        Self {
            model,
            run: Integrator::new(model, x0),
            cursors: vec![Cursor::default(); model.inputs.len()],
            push_cursors: vec![Cursor::default(); model.pushes.len()],
            period_s,
            next_sample: 0,
            looks: Vec::with_capacity(outputs),
            motion: Motion {
                samples,
                states: vec![0.0; samples * model.n],
                sensed: vec![0.0; samples * outputs],
            },
        }
    }

    /// Applies all jumps at the time `cut` and records the samples due then; `inputs` must be known up to
    /// `cut` at least.
    pub fn pass(&mut self, cut: f64, inputs: &[Signal]) -> Result<(), BlindError> {
        let (model, run) = (self.model, &mut self.run);
        for ((line, cursor), signal) in run.inputs.iter_mut().zip(&mut self.cursors).zip(inputs) {
            *line = cursor.line(signal, cut);
        }
        let pushes = self.push_cursors.iter_mut().zip(&model.pushes);
        for ((_, line), (cursor, (_, signal))) in run.pushes.iter_mut().zip(pushes) {
            *line = cursor.line(signal, cut);
        }
        run.start = cut;
        while model.stages.get(run.stage + 1).is_some_and(|s| s.0 <= cut + SAME) {
            run.stage += 1;
        }
        if self.looks.is_empty() {
            self.settle();
        }
        self.sample(cut)
    }

    /// Integrates to `end`; no signal may jump before it.
    pub fn advance(&mut self, end: f64) {
        self.run.advance(end);
    }

    /// Sets the state before the record. Samples of delayed outputs from before the start show the output's
    /// initial value.
    fn settle(&mut self) {
        self.run.settle();
        let outputs = self.model.sensor_delays.len();
        for (i, delay) in self.model.sensor_delays.iter().enumerate() {
            let before = (delay / self.period_s - 1e-9).ceil().max(0.0) as usize;
            let before = before.min(self.motion.samples);
            let rest = self.run.output(i);
            (0..before).for_each(|k| self.motion.sensed[k * outputs + i] = rest);
            self.looks.push(before);
        }
    }

    /// Records the states if a sample is due at `cut`, and each delayed output whose measurement time it is.
    fn sample(&mut self, cut: f64) -> Result<(), BlindError> {
        let (n, samples, outputs) = (self.model.n, self.motion.samples, self.looks.len());
        if self.next_sample < samples && (cut - self.next_sample as f64 * self.period_s).abs() < SAME {
            self.motion.states[self.next_sample * n..(self.next_sample + 1) * n]
                .copy_from_slice(&self.run.z[..n]);
            if self.run.z.iter().any(|z| z.is_nan() || z.abs() > LARGEST) {
                return Err(BlindError::Diverged { at_s: cut });
            }
            self.next_sample += 1;
        }
        for (i, look) in self.looks.iter_mut().enumerate() {
            let due = *look as f64 * self.period_s - self.model.sensor_delays[i];
            if *look < samples && (cut - due).abs() < 2.0 * SAME {
                self.motion.sensed[*look * outputs + i] = self.run.output(i);
                *look += 1;
            }
        }
        Ok(())
    }
}

/// Integrates the model from `x0` and takes `samples` samples, a period apart.
pub(crate) fn fly(
    model: &TruthModel,
    x0: &[f64],
    period_s: f64,
    samples: usize,
) -> Result<Motion, BlindError> {
    let mut cuts = cuts(model, period_s, samples);
    cuts.extend(model.inputs.iter().flat_map(|s| s.pieces().iter().map(|p| p.from)));
    let end = samples.saturating_sub(1) as f64 * period_s;
    ordered(&mut cuts, end + SAME);
    let mut flight = Flight::new(model, x0, period_s, samples);
    for (index, cut) in cuts.iter().enumerate() {
        flight.pass(*cut, &model.inputs)?;
        if let Some(end) = cuts.get(index + 1) {
            flight.advance(*end);
        }
    }
    Ok(flight.motion)
}

/// Sorts times, and keeps each time from 0 to `last` once.
pub(crate) fn ordered(cuts: &mut Vec<f64>, last: f64) {
    cuts.retain(|t| *t >= 0.0 && *t <= last);
    cuts.sort_unstable_by(f64::total_cmp);
    cuts.dedup_by(|b, a| *b - *a < SAME);
}

/// All times at which anything but the inputs may jump or a sample is due, unsorted.
pub(crate) fn cuts(model: &TruthModel, period_s: f64, samples: usize) -> Vec<f64> {
    let mut cuts: Vec<f64> = (0..samples).map(|k| k as f64 * period_s).collect();
    cuts.extend(model.pushes.iter().flat_map(|(_, s)| s.pieces().iter().map(|p| p.from)));
    for delay in model.sensor_delays.iter().filter(|d| **d > 0.0) {
        cuts.extend((0..samples).map(|k| k as f64 * period_s - delay));
    }
    cuts.extend(model.stages.iter().map(|s| s.0));
    cuts
}
