//! Why a law cannot be designed.

use thiserror::Error;
use whirlstand_linalg::{C64, DecompositionError};
use whirlstand_vehicle::DiscretiseError;

use crate::place::PlaceError;
use crate::riccati::RiccatiError;
use crate::smc::SurfaceError;

/// Why a law cannot be designed.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum DesignError {
    /// A name that the plant does not have.
    #[error("`{option}` names {name:?}, which is not among {known}")]
    UnknownName {
        /// The option.
        option: &'static str,
        /// What it names.
        name: String,
        /// What there is.
        known: String,
    },
    /// An index out of range.
    #[error("`{option}` has the index {index}, but there are only {count}, counted from 0")]
    Index {
        /// The option.
        option: &'static str,
        /// The index.
        index: usize,
        /// How many there are.
        count: usize,
    },
    /// A list of the wrong length.
    #[error("`{option}` has {got} entries, but {wanted} are needed")]
    Count {
        /// The option.
        option: &'static str,
        /// Found.
        got: usize,
        /// Needed.
        wanted: usize,
    },
    /// A value out of its range.
    #[error("`{option}` is {value}; it has to be {needed}")]
    Value {
        /// The option.
        option: &'static str,
        /// Its value.
        value: f64,
        /// What would do.
        needed: &'static str,
    },
    /// Inputs whose delays differ by too much.
    #[error(
        "the delays of the inputs differ by so much that the equation of this law has {states} states; {most} are solved. Choose a \
         lower rate, or ppc or smc"
    )]
    Spread {
        /// Its states.
        states: usize,
        /// Most that are solved.
        most: usize,
    },
    /// Options that exclude each other.
    #[error("`{first}` and `{second}` exclude each other; give one of them")]
    Conflict {
        /// One option.
        first: &'static str,
        /// The other.
        second: &'static str,
    },
    /// A mode that does not decay and that no input moves.
    #[error(
        "the mode {mode} (1/s), which shows in {states}, is moved by no input and does not decay by itself; give the \
         vehicle an input that acts there, or leave these states out of the model"
    )]
    Uncontrollable {
        /// The mode, 1/s.
        mode: C64,
        /// States that have a part in what no input moves.
        states: String,
    },
    /// An integral that the inputs cannot hold.
    #[error(
        "the integral of {state} cannot be held by the inputs: at rest {state} is fixed because a rate is zero, or the integrals before it use all inputs; leave it out of `integral`"
    )]
    Integral {
        /// The state.
        state: String,
    },
    /// The reaching condition does not hold.
    #[error("the reaching condition fails: {why}")]
    Reaching {
        /// Which part.
        why: String,
    },
    /// The loop would be unstable.
    #[error(
        "the closed loop would have the discrete pole {pole}, outside the unit circle; ask for other weights or poles"
    )]
    Unstable {
        /// The pole.
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
