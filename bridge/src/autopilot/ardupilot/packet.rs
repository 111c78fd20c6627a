//! ArduPilot's packet of servo pulses: little-endian u16 magic, u16 frame rate, u32 frame number, u16 pulses.

/// First two bytes of a packet with 16 pulses.
const MAGIC_16: u16 = 18458;
/// First two bytes of a packet with 32 pulses.
const MAGIC_32: u16 = 29569;
/// Number of header bytes.
const HEAD: usize = 8;

/// Valid range of servo pulses, us; zero means no pulse.
const PULSES: std::ops::RangeInclusive<u16> = 500..=2500;

/// Pulses of all servos at one step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ServoPacket {
    /// Step rate requested by ArduPilot, Hz.
    pub frame_rate: u16,
    /// Number of the step.
    pub number: u32,
    pulses: [u16; 32],
    count: usize,
}

/// Reason why bytes are not a packet of servo pulses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum PacketError {
    /// The length does not match the magic number.
    #[error("{0} bytes are no servo packet: 40 with 16 channels or 72 with 32 channels are expected")]
    Length(usize),
    /// The magic number is unknown.
    #[error("the magic number is {0}: 18458 or 29569 is expected")]
    Magic(u16),
    /// A pulse is out of range.
    #[error("channel {channel} has a pulse of {pulse} us: 0 or 500 to 2500 us is expected")]
    Pulse {
        /// Channel number, from 1.
        channel: usize,
        /// Pulse width, us.
        pulse: u16,
    },
}

impl ServoPacket {
    /// Decodes a datagram.
    ///
    /// # Errors
    /// [`PacketError`] for bytes that are not such a packet.
    pub fn parse(bytes: &[u8]) -> Result<Self, PacketError> {
        let length = PacketError::Length(bytes.len());
        let u16_at =
            |at: usize| bytes.get(at..at + 2).map(|b| u16::from_le_bytes([b[0], b[1]])).ok_or(length);
        let count = match u16_at(0)? {
            MAGIC_16 => 16,
            MAGIC_32 => 32,
            other => return Err(PacketError::Magic(other)),
        };
        if bytes.len() != HEAD + 2 * count {
            return Err(length);
        }
        let mut pulses = [0; 32];
        for (i, pulse) in pulses.iter_mut().take(count).enumerate() {
            *pulse = u16_at(HEAD + 2 * i)?;
            if *pulse != 0 && !PULSES.contains(pulse) {
                return Err(PacketError::Pulse { channel: i + 1, pulse: *pulse });
            }
        }
        let number = u32::from(u16_at(4)?) | u32::from(u16_at(6)?) << 16;
        Ok(Self { frame_rate: u16_at(2)?, number, pulses, count })
    }

    /// The packet with 16 pulses, as ArduPilot sends it.
    pub fn bytes(frame_rate: u16, number: u32, pulses: &[u16; 16]) -> Vec<u8> {
        let mut bytes = MAGIC_16.to_le_bytes().to_vec();
        bytes.extend(frame_rate.to_le_bytes());
        bytes.extend(number.to_le_bytes());
        bytes.extend(pulses.iter().flat_map(|p| p.to_le_bytes()));
        bytes
    }

    /// Pulses, us; zero for an unused output.
    pub fn pulses(&self) -> &[u16] {
        &self.pulses[..self.count]
    }
}
