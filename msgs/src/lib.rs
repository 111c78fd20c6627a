//! Messages of a Whirlstand bench: message types, units and wire layout, and suggestions for mistyped names.
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
    Autopilot, Command, Disturbance, Estimate, Imu, Odometry, Outputs, Progress, Reported, Sent, Setpoint,
    Truth, armed, charge, flags, valid,
};
pub use wire::{DecodeError, SCHEMA_HASH_BYTES, decode, encode};

/// Largest number of states of a vehicle on the bus (a vehicle file alone has no limit). Messages have a
/// fixed size, and unused elements are copied, sent and recorded at every step too: twice as many would
/// double a step's bytes and those of its log.
pub const MAX_STATES: usize = 16;
/// Largest number of inputs of a vehicle on the bus.
pub const MAX_INPUTS: usize = 8;
/// Largest number of outputs of a vehicle on the bus.
pub const MAX_OUTPUTS: usize = 32;
/// Version of the message set; part of every schema hash, so that different versions are detected.
pub const VERSION: u32 = 2;
