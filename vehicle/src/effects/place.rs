//! Place of an effect in a vehicle, resolved from its `where`.

use std::fmt;

/// A matrix of the model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(missing_docs, reason = "named as in the literature")]
pub enum Matrix {
    A,
    B,
    C,
    D,
}

/// A resolved place; indices count from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// An input.
    Input(usize),
    /// A pair of inputs: from one onto another.
    InputPair(usize, usize),
    /// An output.
    Output(usize),
    /// A pair of outputs.
    OutputPair(usize, usize),
    /// A state.
    State(usize),
    /// A pair of states: from one onto the derivative of another.
    StatePair(usize, usize),
    /// A matrix entry: matrix, row, column.
    Entry(Matrix, usize, usize),
    /// The vehicle as a whole.
    Vehicle,
}

impl fmt::Display for Matrix {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self:?}")
    }
}
