//! Codecs and state machines of the bridges to real hardware, without bus and without I/O, so that a fuzzer and a
//! test can drive them with bytes and a clock alone.
//!
//! Everything here takes bytes and a time and gives back events and bytes. Who owns the serial port, the socket or
//! the bus is the caller (`nodes::bridge`). Times are [`Duration`](std::time::Duration)s since an origin of the
//! caller's choice that never go back. Units are SI.

pub mod arming;
pub mod attitude_receiver;
pub mod autopilot;
pub mod channels;
pub mod config;
pub mod crsf;
pub mod limit;
mod line;
pub mod mavlink;
pub mod mixer;
mod msp;
pub mod note;
pub mod peer;
pub mod pilot;
mod quantity;
pub mod sbus;
pub mod sensors;
pub mod sign_watch;
mod stream;
pub mod turning;
pub mod vehicle;
pub mod watch;
