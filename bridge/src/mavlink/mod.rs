//! MAVLink framing, as both directions need it: bytes to messages with every drop counted, messages to bytes, and
//! signatures. The messages themselves are those of the `mavlink` crate's dialect `common`.
//!
//! Source: <https://mavlink.io/en/guide/serialization.html>,
//! <https://mavlink.io/en/guide/message_signing.html>.
//!
//! ```
//! use std::time::Duration;
//! use whirlstand_bridge::mavlink::{Deframer, Encoder, Event, MavMessage, dialect};
//!
//! let now = Duration::from_secs(1);
//! let beat = MavMessage::HEARTBEAT(dialect::HEARTBEAT_DATA::default());
//! let mut wire = Vec::new();
//! Encoder::new(255, 190).encode(&beat, now, &mut wire);
//! let mut deframer = Deframer::new();
//! deframer.push(&wire);
//! let Some(Event::Message(header, message)) = deframer.next(now) else { panic!() };
//! assert_eq!((header.system, header.component, message), (255, 190, beat));
//! ```

mod arming_checks;
mod counts;
mod deframe;
mod encode;
mod flight_mode;
mod health;
mod prearm;
mod readiness;
mod signing;
mod status_text;

pub use counts::{Counts, DropReason};
pub use deframe::{Deframer, Event, Header};
pub use encode::Encoder;
pub(crate) use flight_mode::flight_mode;
pub use mavlink::dialects::common as dialect;
pub use mavlink::dialects::common::MavMessage;
pub use readiness::Readiness;
pub use signing::{Key, SignatureFault, Signing};

/// First byte of a MAVLink 1 frame.
const STX_V1: u8 = 0xFE;
/// First byte of a MAVLink 2 frame.
const STX_V2: u8 = 0xFD;
/// Length of a MAVLink 1 header, including the first byte.
const HEADER_V1: usize = 6;
/// Length of a MAVLink 2 header, including the first byte.
const HEADER_V2: usize = 10;
/// Length of the checksum in bytes.
const CHECKSUM: usize = 2;
/// Length of a signature in bytes: link, time stamp, hash.
const SIGNATURE: usize = 13;
/// The only defined incompatibility flag: the frame is signed.
const SIGNED: u8 = 1;
/// Longest frame.
pub const LONGEST_FRAME: usize = HEADER_V2 + 255 + CHECKSUM + SIGNATURE;
