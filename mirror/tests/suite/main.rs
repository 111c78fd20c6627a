//! The mirror beside simulated flights.

mod mirror;
mod real;
mod support;
