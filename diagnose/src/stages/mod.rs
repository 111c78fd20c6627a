//! The stages of a diagnosis, in their order. Each is a type that holds what was found and is all that the next needs.

pub mod baseline;
pub mod check;
pub mod findings;
pub mod load;
pub mod residual;
pub mod select;
pub(crate) mod weighed;
