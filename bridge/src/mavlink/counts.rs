//! Counts of discarded messages and bytes, by reason.

use super::signing::SignatureFault;

/// Reason why bytes were discarded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DropReason {
    /// Bytes (their number) that belong to no frame: line noise, another protocol, or a wrong baud rate.
    Noise(usize),
    /// The checksum is wrong.
    Checksum,
    /// The message is unknown to this dialect, so that the frame cannot be checked; number of the message.
    Unknown(u32),
    /// The frame has unknown incompatibility flags.
    Flags(u8),
    /// The checksum is correct but the content cannot be decoded, because a value of an enumeration is
    /// unknown; number of the message.
    Malformed(u32),
    /// The required signature is missing or wrong.
    Signature(SignatureFault),
}

/// Counts of everything received, including everything discarded.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Number of bytes received.
    pub bytes: u64,
    /// Number of messages delivered.
    pub messages: u64,
    /// Number of bytes outside of frames.
    pub noise_bytes: u64,
    /// Number of frames with a wrong checksum.
    pub checksum: u64,
    /// Number of frames of unknown messages.
    pub unknown: u64,
    /// Number of frames with unknown incompatibility flags.
    pub flags: u64,
    /// Number of frames whose content cannot be decoded.
    pub malformed: u64,
    /// Number of frames without a required signature.
    pub unsigned: u64,
    /// Number of frames signed with another key, or modified in transit.
    pub wrong_signature: u64,
    /// Number of frames with a valid signature of a past time: replayed, or the sender's clock is wrong.
    pub replayed: u64,
    /// Number of frames lost in transit, from gaps in the sequence numbers of each sender.
    pub lost: u64,
    /// Number of frames with an earlier sequence number: repeated, overtaken in transit, or the sender
    /// restarted.
    pub late: u64,
}

impl Counts {
    /// Number of discarded frames.
    pub fn dropped(&self) -> u64 {
        self.checksum + self.unknown + self.flags + self.malformed + self.signature()
    }

    /// Number of frames refused for their signature.
    pub fn signature(&self) -> u64 {
        self.unsigned + self.wrong_signature + self.replayed
    }

    /// Adds other counts.
    pub(super) fn add(&mut self, other: &Self) {
        self.bytes += other.bytes;
        self.messages += other.messages;
        self.noise_bytes += other.noise_bytes;
        self.checksum += other.checksum;
        self.unknown += other.unknown;
        self.flags += other.flags;
        self.malformed += other.malformed;
        self.unsigned += other.unsigned;
        self.wrong_signature += other.wrong_signature;
        self.replayed += other.replayed;
        self.lost += other.lost;
        self.late += other.late;
    }

    pub(super) fn count(&mut self, drop: DropReason) {
        match drop {
            DropReason::Noise(bytes) => self.noise_bytes += bytes as u64,
            DropReason::Checksum => self.checksum += 1,
            DropReason::Unknown(_) => self.unknown += 1,
            DropReason::Flags(_) => self.flags += 1,
            DropReason::Malformed(_) => self.malformed += 1,
            DropReason::Signature(SignatureFault::Missing) => self.unsigned += 1,
            DropReason::Signature(SignatureFault::Wrong) => self.wrong_signature += 1,
            DropReason::Signature(SignatureFault::Replayed | SignatureFault::Old) => self.replayed += 1,
        }
    }
}
