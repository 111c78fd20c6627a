//! Decodes MAVLink messages from bytes.

use std::collections::BTreeMap;
use std::time::Duration;

use mavlink::{MavlinkVersion, Message, calculate_crc};

use super::counts::{Counts, DropReason};
use super::signing::{SignatureFault, Signing};
use super::{CHECKSUM, HEADER_V1, HEADER_V2, LONGEST_FRAME, MavMessage, SIGNATURE, SIGNED, STX_V1, STX_V2};
use crate::stream::Stream;

/// Largest number of senders whose sequence numbers are tracked.
const SENDERS: usize = 64;

/// Sender of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Header {
    /// System id: the vehicle or the ground station.
    pub system: u8,
    /// Component id within the system.
    pub component: u8,
    /// Sequence number of the sender's frames.
    pub sequence: u8,
    /// True for a MAVLink 2 frame.
    pub v2: bool,
}

/// Event decoded from the received bytes.
#[derive(Debug, Clone, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "the message is the common case and lives on the stack for a moment"
)]
pub enum Event {
    /// A message with a correct checksum and signature.
    Message(Header, MavMessage),
    /// Discarded bytes.
    Dropped(DropReason),
}

/// Finds messages in a stream of bytes, or in datagrams. A damaged frame does not affect others: the search
/// continues after its first byte.
#[derive(Debug, Default)]
pub struct Deframer {
    stream: Stream,
    /// Length of the last decoded frame.
    last: usize,
    signing: Option<Signing>,
    senders: BTreeMap<(u8, u8), u8>,
    counts: Counts,
    /// Counts of datagrams that were not recognised.
    strangers: Counts,
}

/// Content at the front of the buffer.
#[expect(
    clippy::large_enum_variant,
    reason = "lives on the stack for one call; a box would allocate per message"
)]
enum Head {
    /// An incomplete frame.
    Incomplete,
    /// Number of bytes to discard, with the reason.
    Drop(usize, DropReason),
    /// A frame with its length.
    Frame(usize, Header, MavMessage),
}

impl Deframer {
    /// A deframer that accepts all frames, signed or not.
    pub fn new() -> Self {
        Self::default()
    }

    /// A deframer that accepts only frames signed with this key.
    pub fn with_signing(signing: Signing) -> Self {
        Self { signing: Some(signing), ..Self::default() }
    }

    /// Counts of everything received so far.
    pub fn counts(&self) -> &Counts {
        &self.counts
    }

    /// Counts of everything received so far, including datagrams that were not recognised.
    pub fn counts_with_strangers(&self) -> Counts {
        let mut counts = self.counts;
        counts.add(&self.strangers);
        counts
    }

    /// True when a datagram of an unknown sender contains, by itself, a message that `is_wanted`, correctly
    /// signed where required. Partly received data stay unchanged, and no signature is used up; the datagram
    /// must still be pushed.
    pub fn recognises(
        &mut self,
        datagram: &[u8],
        now: Duration,
        is_wanted: impl Fn(&Header, &MavMessage) -> bool,
    ) -> bool {
        let mut scout = Self { signing: self.signing.clone(), ..Self::default() };
        scout.push(datagram);
        let mut found = false;
        while let Some(event) = scout.next(now) {
            found |= matches!(event, Event::Message(header, message) if is_wanted(&header, &message));
        }
        scout.end();
        if !found {
            self.strangers.add(&scout.counts);
        }
        found
    }

    /// Adds received bytes. Call [`Deframer::next`] until it returns `None` before adding more.
    pub fn push(&mut self, bytes: &[u8]) {
        self.counts.bytes += bytes.len() as u64;
        self.stream.push(bytes);
    }

    /// Marks the end of a datagram or of a connection: no more bytes follow. The rest of a truncated frame is
    /// discarded.
    pub fn end(&mut self) -> Option<Event> {
        let left = self.stream.clear();
        (left > 0).then(|| self.dropped(DropReason::Noise(left)))
    }

    /// The next message or drop; `None` until more bytes arrive.
    pub fn next(&mut self, now: Duration) -> Option<Event> {
        match self.head(now) {
            Head::Incomplete => None,
            Head::Drop(bytes, drop) => {
                self.stream.skip(bytes);
                self.last = bytes;
                Some(self.dropped(drop))
            }
            Head::Frame(bytes, header, message) => {
                self.stream.skip(bytes);
                self.last = bytes;
                self.follow(header);
                self.counts.messages += 1;
                Some(Event::Message(header, message))
            }
        }
    }

    /// Bytes of the message or drop returned last by [`Deframer::next`], valid until the next call.
    pub fn frame(&self) -> &[u8] {
        self.stream.behind(self.last)
    }

    fn dropped(&mut self, drop: DropReason) -> Event {
        self.counts.count(drop);
        Event::Dropped(drop)
    }

    fn head(&mut self, now: Duration) -> Head {
        let bytes = self.stream.waiting();
        let Some(&first) = bytes.first() else { return Head::Incomplete };
        let v2 = match first {
            STX_V2 => true,
            STX_V1 => false,
            _ => {
                let noise = bytes.iter().position(|b| matches!(*b, STX_V1 | STX_V2)).unwrap_or(bytes.len());
                return Head::Drop(noise, DropReason::Noise(noise));
            }
        };
        let head = if v2 { HEADER_V2 } else { HEADER_V1 };
        if bytes.len() < head {
            return Head::Incomplete;
        }
        let flags = if v2 { bytes[2] } else { 0 };
        if flags & !SIGNED != 0 {
            return Head::Drop(1, DropReason::Flags(flags));
        }
        let signature = if flags & SIGNED != 0 { SIGNATURE } else { 0 };
        let payload_end = head + usize::from(bytes[1]);
        let checked = payload_end + CHECKSUM;
        let whole = checked + signature;
        debug_assert!(whole <= LONGEST_FRAME);
        if bytes.len() < whole {
            return Head::Incomplete;
        }
        let (id, header) = parse_header(bytes, v2);
        let extra = MavMessage::extra_crc(id);
        if extra == 0 && MavMessage::default_message_from_id(id).is_none() {
            // The frame cannot be checked. When another frame or nothing follows it was one of another
            // dialect; else the bytes only look like a frame, and a real one may begin within.
            let skip = match bytes.get(whole) {
                None | Some(&(STX_V1 | STX_V2)) => whole,
                Some(_) => 1,
            };
            return Head::Drop(skip, DropReason::Unknown(id));
        }
        let crc = calculate_crc(&bytes[1..payload_end], extra);
        if crc.to_le_bytes() != bytes[payload_end..checked] {
            return Head::Drop(1, DropReason::Checksum);
        }
        if let Some(signing) = &mut self.signing {
            let verdict = match bytes[checked..whole].try_into() {
                Ok(signature) => {
                    let sender = (header.system, header.component);
                    signing.check(&bytes[..checked], signature, sender, now)
                }
                Err(_) => Err(SignatureFault::Missing),
            };
            if let Err(fault) = verdict {
                return Head::Drop(whole, DropReason::Signature(fault));
            }
        }
        let version = if v2 { MavlinkVersion::V2 } else { MavlinkVersion::V1 };
        match MavMessage::parse(version, id, &bytes[head..payload_end]) {
            Ok(message) => Head::Frame(whole, header, message),
            Err(_) => Head::Drop(whole, DropReason::Malformed(id)),
        }
    }

    /// Counts gaps in a sender's sequence numbers. More than half the range ahead counts as behind.
    fn follow(&mut self, header: Header) {
        let sender = (header.system, header.component);
        if !self.senders.contains_key(&sender) && self.senders.len() >= SENDERS {
            return;
        }
        if let Some(last) = self.senders.insert(sender, header.sequence) {
            match header.sequence.wrapping_sub(last).wrapping_sub(1) {
                gap @ 0..=127 => self.counts.lost += u64::from(gap),
                _ => self.counts.late += 1,
            }
        }
    }
}

fn parse_header(bytes: &[u8], v2: bool) -> (u32, Header) {
    if v2 {
        let id = u32::from_le_bytes([bytes[7], bytes[8], bytes[9], 0]);
        (id, Header { sequence: bytes[4], system: bytes[5], component: bytes[6], v2 })
    } else {
        let id = u32::from(bytes[5]);
        (id, Header { sequence: bytes[2], system: bytes[3], component: bytes[4], v2 })
    }
}
