//! Encodes MAVLink messages as bytes.

use std::time::Duration;

use mavlink::{MavlinkVersion, Message, calculate_crc};

use super::signing::Signing;
use super::{HEADER_V2, MavMessage, SIGNED, STX_V2};

/// Longest payload of a MAVLink 2 frame, with a margin: the dialect's serialisers need space for a whole
/// message.
const PAYLOAD_ROOM: usize = 256;

/// Encodes MAVLink 2 frames, numbered and, with a key, signed.
#[derive(Debug, Clone)]
pub struct Encoder {
    system: u8,
    component: u8,
    sequence: u8,
    signing: Option<Signing>,
}

impl Encoder {
    /// An encoder with this system and component id.
    pub fn new(system: u8, component: u8) -> Self {
        Self { system, component, sequence: 0, signing: None }
    }

    /// An encoder that signs every frame.
    #[must_use]
    pub fn with_signing(mut self, signing: Signing) -> Self {
        self.signing = Some(signing);
        self
    }

    /// Appends the frame of a message to `out`; trailing zeros of the payload are left out, as the protocol
    /// requires.
    pub fn encode(&mut self, message: &MavMessage, now: Duration, out: &mut Vec<u8>) {
        let start = out.len();
        let mut payload = [0; PAYLOAD_ROOM];
        let length = message.ser(MavlinkVersion::V2, &mut payload);
        let id = message.message_id();
        let flags = if self.signing.is_some() { SIGNED } else { 0 };
        let id_bytes = id.to_le_bytes();
        // A payload has at most 255 bytes: its length is one byte of the frame.
        let head: [u8; HEADER_V2] = [
            STX_V2,
            length as u8,
            flags,
            0,
            self.sequence,
            self.system,
            self.component,
            id_bytes[0],
            id_bytes[1],
            id_bytes[2],
        ];
        out.extend_from_slice(&head);
        out.extend_from_slice(&payload[..length]);
        let crc = calculate_crc(&out[start + 1..], MavMessage::extra_crc(id));
        out.extend_from_slice(&crc.to_le_bytes());
        if let Some(signing) = &mut self.signing {
            let signature = signing.sign(&out[start..], now);
            out.extend_from_slice(&signature);
        }
        self.sequence = self.sequence.wrapping_add(1);
    }
}
