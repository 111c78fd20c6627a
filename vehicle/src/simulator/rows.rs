//! Room for many steps at once.

/// Steps of a block: its rows stay in the processor's first cache.
pub const BLOCK: usize = 64;

/// What a simulator went through in a block of steps.
#[derive(Debug, Clone)]
pub struct Rows {
    /// Steps in the block.
    pub(super) length: usize,
    /// Entry after entry of z, of the inputs, and of the outputs, each with the values of all steps.
    pub(super) states: Vec<f64>,
    pub(super) inputs: Vec<f64>,
    pub(super) outputs: Vec<f64>,
}

impl Rows {
    /// Steps in a block, at most.
    pub const MOST: usize = BLOCK;

    /// For so many entries of z, inputs and outputs.
    pub(super) fn new(states: usize, inputs: usize, outputs: usize) -> Self {
        let rows = |entries: usize| vec![0.0; entries * BLOCK];
        Self { length: 0, states: rows(states), inputs: rows(inputs), outputs: rows(outputs) }
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
