//! Bridges: real hardware that replaces a node. The codecs and state machines are those of
//! `whirlstand-bridge`; this module connects them to links and to the bus.

pub mod check;
pub mod hil;
pub mod link;
pub mod vehicle;
