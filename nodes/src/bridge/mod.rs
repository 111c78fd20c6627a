//! Bridges: real hardware in the place of a node.

pub mod hil;
