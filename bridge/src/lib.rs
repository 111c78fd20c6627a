//! Codecs and state machines of the bridges to real hardware, without bus and without I/O, so that a fuzzer
//! or a test can drive them with bytes and a clock alone.
//!
//! Everything here takes bytes and a time and returns events and bytes. The caller (`nodes::bridge`) owns the
//! serial port, the socket and the bus. Times are [`Duration`](std::time::Duration)s since an origin of the
//! caller's choice, and never go back. Units are SI.

pub mod arming;
pub mod attitude_receiver;
pub mod autopilot;
pub mod channels;
pub mod config;
pub mod crsf;
mod forward;
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
