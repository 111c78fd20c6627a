//! What travels on a Whirlstand bench: message types, units and wire layout, and what mistyped names were meant to be.
//! No logic, no I/O.
//!
//! Every message is `repr(C)`, of fixed size and without padding (checked at compile time by
//! [`bytemuck::Pod`]), begins with a [`Head`], and is in SI units. Shared memory carries the type itself;
//! networks carry [`encode`]d bytes: the 8-byte [`Message::SCHEMA_HASH`], little-endian, then postcard.
//! Logs carry the same memory image behind a 4-byte CDR header, described by [`Message::SCHEMA`] in ROS 2
//! message syntax; the two coincide because no field needs padding.
//!
//! ```
//! use whirlstand_msgs::{Imu, Message, decode, encode};
//!
//! let imu = Imu { roll: 0.1, ..Imu::zeroed() };
//! let mut wire = Vec::new();
//! encode(&imu, &mut wire);
//! assert_eq!(decode::<Imu>(&wire).unwrap(), imu);
//! ```

mod adjustment;
mod define;
mod finding;
mod head;
mod health;
pub mod names;
mod types;
pub mod units;
mod wire;

pub use adjustment::{Adjustment, AdjustmentKind, AdjustmentVerdict, Stick};
pub use define::{Each, Field, Message};
pub use finding::{Finding, FindingStage, MAX_PARAMETERS, text_field, text_of};
pub use head::Head;
pub use health::{Health, LATENCY_BUCKETS, NodeState, latency_bucket, latency_bucket_upper_ns};
pub use types::{
    Autopilot, Command, Disturbance, Estimate, Imu, Odometry, Outputs, Progress, Sent, Setpoint, Truth,
    armed, charge, flags, valid,
};
pub use wire::{DecodeError, SCHEMA_HASH_BYTES, decode, encode};

/// Largest number of states a vehicle can have on the bus (a vehicle file alone has no limit). Messages have a fixed
/// size, and what no vehicle uses is copied, sent and recorded at every step all the same: twice as many would double
/// a step's bytes and those of its log.
pub const MAX_STATES: usize = 16;
/// Largest number of inputs a vehicle can have on the bus.
pub const MAX_INPUTS: usize = 8;
/// Largest number of outputs a vehicle can have on the bus.
pub const MAX_OUTPUTS: usize = 32;
/// Version of the message set; part of every schema hash, so that two versions never talk past each other.
pub const VERSION: u32 = 2;
