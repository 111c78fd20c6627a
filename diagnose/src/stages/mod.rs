//! The stages of a diagnosis, in their order. Each is a type that holds the results so far and is the input
//! of the next.

pub mod baseline;
pub mod check;
pub mod findings;
pub mod load;
pub mod residual;
pub mod select;
pub(crate) mod weighed;
