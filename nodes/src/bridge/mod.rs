//! Bridges: real hardware in a node's place. The codecs and state machines are those of `whirlstand-bridge`; here
//! they meet links and the bus.

pub mod check;
pub mod hil;
pub mod link;
pub mod vehicle;
