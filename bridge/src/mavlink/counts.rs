//! Counts of messages and bytes that did not arrive, by reason.

use super::signing::SignatureFault;

/// Why bytes were discarded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DropReason {
    /// Bytes (their number) that belong to no frame: line noise, another protocol, or a wrong baud rate.
    Noise(usize),
    /// The checksum is wrong.
    Checksum,
    /// The frame is of a message that this dialect does not know, so that it cannot be checked.
    Unknown(u32),
    /// The frame has incompatibility flags that this program does not know.
    Flags(u8),
    /// The checksum is right but the content cannot be read, because a value of an enumeration is unknown; number of
    /// the message.
    Malformed(u32),
    /// The frame is not signed as it must be.
    Signature(SignatureFault),
}

/// Counts of everything received. Everything that is discarded is counted here.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Bytes that came in.
    pub bytes: u64,
    /// Messages handed on.
    pub messages: u64,
    /// Bytes outside of frames.
    pub noise_bytes: u64,
    /// Frames with a wrong checksum.
    pub checksum: u64,
    /// Frames of unknown messages.
    pub unknown: u64,
    /// Frames with unknown incompatibility flags.
    pub flags: u64,
    /// Frames whose content cannot be read.
    pub malformed: u64,
    /// Frames without a signature, where one is asked for.
    pub unsigned: u64,
    /// Frames that were signed with another key, or changed on the way.
    pub wrong_signature: u64,
    /// Frames that were rightly signed at a time that is past: played again, or the sender's clock is wrong.
    pub replayed: u64,
    /// Frames that were lost on the way, from gaps in the sequence numbers of each sender.
    pub lost: u64,
    /// Frames whose sequence number was behind: repeated, overtaken on the way, or the sender began anew.
    pub late: u64,
}

impl Counts {
    /// Number of discarded frames.
    pub fn dropped(&self) -> u64 {
        self.checksum + self.unknown + self.flags + self.malformed + self.signature()
    }

    /// Number of frames that were refused for their signature.
    pub fn signature(&self) -> u64 {
        self.unsigned + self.wrong_signature + self.replayed
    }

    /// Adds what was counted elsewhere.
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
