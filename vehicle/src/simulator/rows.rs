//! Buffers for many steps at once.

/// Steps per block: its rows fit into the first-level cache.
pub const BLOCK: usize = 64;

/// States, inputs and outputs of a simulator over a block of steps.
#[derive(Debug, Clone)]
pub struct Rows {
    /// Number of steps in the block.
    pub(super) length: usize,
    /// All entries of z, of the inputs, and of the outputs, each with its values over all steps.
    pub(super) states: Vec<f64>,
    pub(super) inputs: Vec<f64>,
    pub(super) outputs: Vec<f64>,
    /// Inputs that act over each step's period, step after step, and their number per step.
    pub(super) periods: Vec<f64>,
    pub(super) width: usize,
}

impl Rows {
    /// Largest number of steps per block.
    pub const MOST: usize = BLOCK;

    /// Buffers for these numbers of entries of z, inputs and outputs.
    pub(super) fn new(states: usize, inputs: usize, outputs: usize) -> Self {
        let rows = |entries: usize| vec![0.0; entries * BLOCK];
        Self {
            length: 0,
            states: rows(states),
            inputs: rows(inputs),
            outputs: rows(outputs),
            periods: rows(2 * inputs),
            width: inputs,
        }
    }

    /// Sets an input that changes only from step to step.
    #[inline(always)]
    pub(super) fn put_inputs(&mut self, input: usize, mut next: impl FnMut(usize) -> f64) {
        let begins = &mut self.inputs[input * BLOCK..][..self.length];
        for (row, begin) in begins.iter_mut().enumerate() {
            *begin = next(row);
            self.periods[row * self.width + input] = *begin;
        }
    }

    /// Inputs that act over a step's period.
    #[inline(always)]
    pub(super) fn period(&self, row: usize) -> &[f64] {
        &self.periods[row * self.width..][..self.width]
    }

    /// Inputs at the beginning of a step.
    #[inline(always)]
    pub(super) fn begin(&self, row: usize, inputs: &mut [f64]) {
        for (value, entry) in inputs.iter_mut().zip(self.inputs.chunks_exact(BLOCK)) {
            *value = entry[row];
        }
    }

    /// Keeps the state at the beginning of a step.
    #[inline(always)]
    pub(super) fn put_state(&mut self, row: usize, z: &[f64]) {
        for (entry, z) in self.states.chunks_exact_mut(BLOCK).zip(z) {
            entry[row] = *z;
        }
    }

    /// An output, measured at every step of the block.
    pub fn output(&self, index: usize) -> &[f64] {
        &self.outputs[index * BLOCK..][..self.length]
    }

    /// A state at the beginning of every step of the block.
    pub fn state(&self, index: usize) -> &[f64] {
        &self.states[index * BLOCK..][..self.length]
    }
}
