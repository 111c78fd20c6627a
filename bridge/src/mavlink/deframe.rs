//! Decodes MAVLink messages from bytes.

use std::collections::BTreeMap;
use std::time::Duration;

use mavlink::{MavlinkVersion, Message, calculate_crc};

use super::counts::{Counts, DropReason};
use super::signing::{SignatureFault, Signing};
use super::{CHECKSUM, HEADER_V1, HEADER_V2, LONGEST_FRAME, MavMessage, SIGNATURE, SIGNED, STX_V1, STX_V2};
use crate::stream::Stream;

/// Senders whose sequence numbers are followed at most.
const SENDERS: usize = 64;

/// Sender of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Header {
    /// System: the vehicle or the ground station.
    pub system: u8,
    /// Component of the system.
    pub component: u8,
    /// Number of the frame, one more for each of this sender.
    pub sequence: u8,
    /// Whether it came in a MAVLink 2 frame.
    pub v2: bool,
}

/// What the bytes were.
#[derive(Debug, Clone, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "the message is the common case and lives on the stack for a moment"
)]
pub enum Event {
    /// A message whose checksum and signature hold.
    Message(Header, MavMessage),
    /// Bytes that were given up.
    Dropped(DropReason),
}

/// Finds messages in a stream of bytes, or in datagrams. A damaged frame costs itself alone: the search goes on
/// behind its first byte.
#[derive(Debug, Default)]
pub struct Deframer {
    stream: Stream,
    /// Length of the frame that was read last.
    last: usize,
    signing: Option<Signing>,
    senders: BTreeMap<(u8, u8), u8>,
    counts: Counts,
    /// What came in datagrams that were not recognised.
    strangers: Counts,
}

/// What stands at the front of the buffer.
#[expect(
    clippy::large_enum_variant,
    reason = "lives on the stack for one call; a box would allocate per message"
)]
enum Head {
    /// Not a whole frame yet.
    Incomplete,
    /// So many bytes are given up.
    Drop(usize, DropReason),
    /// A frame of so many bytes.
    Frame(usize, Header, MavMessage),
}

impl Deframer {
    /// A deframer that takes all frames, signed or not.
    pub fn new() -> Self {
        Self::default()
    }

    /// A deframer that takes frames signed with this key alone.
    pub fn with_signing(signing: Signing) -> Self {
        Self { signing: Some(signing), ..Self::default() }
    }

    /// Counts of everything received so far.
    pub fn counts(&self) -> &Counts {
        &self.counts
    }

    /// Counts of everything received so far, and of what came in datagrams that were not recognised.
    pub fn counts_with_strangers(&self) -> Counts {
        let mut counts = self.counts;
        counts.add(&self.strangers);
        counts
    }

    /// Whether a datagram of somebody who is not believed yet holds, by itself, a message that `is_wanted`, rightly signed
    /// where that is asked for. Nothing that is half received changes, and no signature is used up; the datagram is
    /// still to be taken in.
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

    /// Takes bytes in. Call [`Deframer::next`] until it returns `None` before the next bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        self.counts.bytes += bytes.len() as u64;
        self.stream.push(bytes);
    }

    /// Says that no more bytes belong to what came in: the end of a datagram, or of a connection. The rest of a
    /// frame that was cut off is given up.
    pub fn end(&mut self) -> Option<Event> {
        let left = self.stream.clear();
        (left > 0).then(|| self.dropped(DropReason::Noise(left)))
    }

    /// The next message or drop; `None` until more bytes come.
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

    /// The bytes of the message or drop that [`Deframer::next`] gave last, until the next call of anything else.
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
            // It cannot be checked. When another frame or nothing follows it was one of another dialect; else the
            // bytes only look like a frame, and a real one may begin within.
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

    /// Counts gaps in a sender's numbers. More than half the circle ahead counts as behind.
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
