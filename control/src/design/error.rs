//! Errors of a law's design.

use thiserror::Error;
use whirlstand_linalg::{C64, DecompositionError};
use whirlstand_vehicle::DiscretiseError;

use crate::place::PlaceError;
use crate::riccati::RiccatiError;
use crate::smc::SurfaceError;

/// Reason why a law cannot be designed.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum DesignError {
    /// An option names a state or input that the plant does not have.
    #[error("`{option}` names {name:?}, which is not among {known}")]
    UnknownName {
        /// Name of the option.
        option: &'static str,
        /// Unknown name.
        name: String,
        /// Known names.
        known: String,
    },
    /// An index is out of range.
    #[error("`{option}` has the index {index}, but there are only {count}, counted from 0")]
    Index {
        /// Name of the option.
        option: &'static str,
        /// Given index.
        index: usize,
        /// Number of states or inputs.
        count: usize,
    },
    /// A list has the wrong length.
    #[error("`{option}` has {got} entries, but {wanted} are needed")]
    Count {
        /// Name of the option.
        option: &'static str,
        /// Length found.
        got: usize,
        /// Length needed.
        wanted: usize,
    },
    /// A value is out of its range.
    #[error("`{option}` is {value}; it has to be {needed}")]
    Value {
        /// Name of the option.
        option: &'static str,
        /// Given value.
        value: f64,
        /// Description of the valid values.
        needed: &'static str,
    },
    /// The delays of the inputs differ too much.
    #[error(
        "the delays of the inputs differ by so much that the equation of this law has {states} states; {most} are solved. Choose a \
         lower rate, or ppc or smc"
    )]
    Spread {
        /// Number of states of the Riccati equation.
        states: usize,
        /// Largest number of states that is solved.
        most: usize,
    },
    /// Two options exclude each other.
    #[error("`{first}` and `{second}` exclude each other; give one of them")]
    Conflict {
        /// One option.
        first: &'static str,
        /// The other.
        second: &'static str,
    },
    /// A mode that does not decay is uncontrollable.
    #[error(
        "the mode {mode} (1/s), which shows in {states}, is moved by no input and does not decay by itself; give the \
         vehicle an input that acts there, or leave these states out of the model"
    )]
    Uncontrollable {
        /// The mode, 1/s.
        mode: C64,
        /// States with a share in the uncontrollable mode.
        states: String,
    },
    /// The inputs cannot hold an integral.
    #[error(
        "the integral of {state} cannot be held by the inputs: at rest {state} is fixed because a rate is zero, or the integrals before it use all inputs; leave it out of `integral`"
    )]
    Integral {
        /// Name of the state.
        state: String,
    },
    /// The reaching condition does not hold.
    #[error("the reaching condition fails: {why}")]
    Reaching {
        /// Description of the violated part.
        why: String,
    },
    /// The loop would be unstable.
    #[error(
        "the closed loop would have the discrete pole {pole}, outside the unit circle; ask for other weights or poles"
    )]
    Unstable {
        /// The unstable pole.
        pole: C64,
    },
    /// The Riccati equation was not solved.
    #[error("the Riccati equation of this design: {0}")]
    Riccati(#[from] RiccatiError),
    /// An unstable mode of the plant is too fast for the period.
    #[error("the cost cannot be sampled: {0}; an unstable mode of the plant is too fast for this period")]
    Discretise(#[from] DiscretiseError),
    /// Poles were not placed.
    #[error("the pole placement of this design: {0}")]
    Place(#[from] PlaceError),
    /// No surface was found.
    #[error(transparent)]
    Surface(#[from] SurfaceError),
    /// An eigenvalue iteration failed.
    #[error(transparent)]
    Eigenvalues(#[from] DecompositionError),
}
