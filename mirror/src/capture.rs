//! A buffer of the last steps, from which they can be simulated again with another model.

use crate::lateness::Lateness;
use crate::predictor::{Predictor, Sample};

/// A ring buffer of consecutive steps.
#[derive(Debug, Clone)]
pub struct Capture {
    rows: Vec<f64>,
    fresh: Vec<u64>,
    capacity: usize,
    widths: [usize; 7],
    /// The first stored step, and the step after the last one.
    first: u64,
    next: u64,
    /// First step that must not be overwritten.
    held: Option<u64>,
}

impl Capture {
    /// A buffer for `capacity` steps of `outputs` and `inputs`, with the predictions of `predictor`.
    pub fn new(capacity: usize, outputs: usize, inputs: usize, predictor: &Predictor) -> Self {
        let (states, errors) = (predictor.state().len(), predictor.errors().len());
        let widths = [outputs, inputs, states, errors, 2, predictor.gains_len(), outputs];
        Self {
            rows: vec![0.0; capacity * widths.iter().sum::<usize>()],
            fresh: vec![0; capacity],
            capacity,
            widths,
            first: 0,
            next: 0,
            held: None,
        }
    }

    /// Discards all steps; the next step is `step`.
    pub fn restart(&mut self, step: u64) {
        (self.first, self.next, self.held) = (step, step, None);
    }

    /// Protects the steps from `step` on against overwriting, until the buffer is full.
    pub fn hold(&mut self, step: u64) {
        self.held = Some(step.max(self.first));
    }

    /// Whether the protected steps fill the buffer.
    pub fn is_full(&self) -> bool {
        self.held.is_some_and(|from| self.next - from >= self.capacity as u64)
    }

    /// Stores a step and the prediction before it; false when there is no room or the step is not the next
    /// one.
    pub fn push(&mut self, sample: &Sample<'_>, before: &Predictor) -> bool {
        if self.is_full() || sample.step != self.next {
            return false;
        }
        let slot = (self.next % self.capacity as u64) as usize;
        let age = before.lateness().map_or([0.0; 2], Lateness::age);
        let parts = [sample.y, sample.u, before.state(), before.errors(), &age];
        let width: usize = self.widths.iter().sum();
        let mut row = &mut self.rows[slot * width..(slot + 1) * width];
        for part in parts {
            let (to, rest) = row.split_at_mut(part.len());
            to.copy_from_slice(part);
            row = rest;
        }
        self.fresh[slot] = sample.fresh;
        self.next += 1;
        self.first = self.first.max(self.next.saturating_sub(self.capacity as u64));
        true
    }

    /// Adds the whitened innovations and gains of the last step.
    pub fn complete(&mut self, after: &Predictor) {
        let (whitened, gains) = (after.whitened(), after.gains_len());
        let slot = ((self.next - 1) % self.capacity as u64) as usize;
        let width: usize = self.widths.iter().sum();
        let end = (slot + 1) * width;
        let from = end - whitened.len();
        self.rows[from..end].copy_from_slice(whitened);
        after.write_gains(&mut self.rows[from - gains..from]);
    }

    fn part(&self, step: u64, part: usize) -> &[f64] {
        let slot = (step % self.capacity as u64) as usize;
        let width: usize = self.widths.iter().sum();
        let from = slot * width + self.widths[..part].iter().sum::<usize>();
        &self.rows[from..from + self.widths[part]]
    }

    /// The measurement and the inputs of a stored step.
    pub fn sample(&self, step: u64) -> Sample<'_> {
        let fresh = self.fresh[(step % self.capacity as u64) as usize];
        Sample { step, y: self.part(step, 0), u: self.part(step, 1), fresh }
    }

    /// The predicted states at a step.
    pub fn state(&self, step: u64) -> &[f64] {
        self.part(step, 2)
    }

    /// The predicted errors other than those of the states at a step.
    pub fn errors(&self, step: u64) -> &[f64] {
        self.part(step, 3)
    }

    /// Age of the measurements as estimated at a step, and its standard deviation, s; zero for a simulation.
    pub fn age(&self, step: u64) -> [f64; 2] {
        let age = self.part(step, 4);
        [age[0], age[1]]
    }

    /// The whitened innovations of a step.
    pub fn whitened(&self, step: u64) -> &[f64] {
        self.part(step, 6)
    }

    /// The filter gains of a step.
    pub fn gains(&self, step: u64) -> &[f64] {
        self.part(step, 5)
    }

    /// The first stored step.
    pub fn first(&self) -> u64 {
        self.first
    }

    /// The step after the last stored one.
    pub fn next(&self) -> u64 {
        self.next
    }
}
