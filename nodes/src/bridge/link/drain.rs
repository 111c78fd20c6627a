//! Receives waiting data of a link, up to a limit per call, from its peer only.

use std::time::Instant;

use whirlstand_bridge::peer::Verdict;

use super::{Link, LinkEvent, Received};

/// Longest datagram, and largest read of a stream: more than twice the longest packet of any protocol.
pub const BUFFER: usize = 4096;

/// Largest number of pieces, and of bytes, received per call, before the other links and the steps have their
/// turn. A refused piece counts as any other: it costs a system call.
const MOST_PIECES: usize = 64;
const MOST_BYTES: usize = 16_384;

/// Number of consecutive calls with remaining data from which they are a flood, not a pause of this node.
const FLOOD_LOOKS: u32 = 16;

/// Decoder of a link's data.
pub trait Decoder {
    /// True when a datagram of another sender, by itself, makes this sender the peer.
    fn recognises(&mut self, datagram: &[u8]) -> bool;

    /// Called when another peer replaces the previous one.
    fn peer_changed(&mut self);

    /// Decodes a complete datagram, or the next bytes of a stream. Returns whether something in it was valid.
    fn decode(&mut self, bytes: &[u8], is_datagram: bool) -> bool;
}

impl Link {
    /// Receives waiting data, up to a limit; the rest stays for the next call.
    ///
    /// # Errors
    /// The link went down; it is opened again by [`Link::maintain`].
    pub fn drain(
        &mut self,
        buffer: &mut [u8],
        now: Instant,
        decoder: &mut impl Decoder,
    ) -> Result<(), LinkEvent> {
        let refused_before = self.peers.counts().sum();
        let at = now.saturating_duration_since(self.origin);
        let mut bytes = 0;
        // The peer's own socket first, so that its data are not delayed by others.
        let mut own = self.own.is_some();
        for _ in 0..MOST_PIECES {
            let received = if own { self.receive_own(buffer) } else { self.receive(buffer)? };
            bytes += match received {
                Received::Nothing if own => {
                    own = false;
                    0
                }
                Received::Nothing => {
                    self.full_looks = 0;
                    return Ok(());
                }
                Received::Stream(length) => {
                    if decoder.decode(&buffer[..length], false) {
                        self.peers.keep(at);
                    }
                    length
                }
                Received::Datagram { length, from } => {
                    let datagram = &buffer[..length];
                    let is_peer = match self.peers.judge(from, at) {
                        Verdict::Peer => true,
                        Verdict::Refused => false,
                        Verdict::Candidate => {
                            let adopted = decoder.recognises(datagram);
                            if !adopted {
                                self.peers.refuse(from, length);
                            } else if self.adopt(from, at) {
                                decoder.peer_changed();
                            }
                            adopted
                        }
                    };
                    if is_peer && decoder.decode(datagram, true) {
                        self.peers.keep(at);
                    }
                    length
                }
            };
            if bytes >= MOST_BYTES {
                break;
            }
        }
        self.full_looks += 1;
        let refused = self.peers.counts().sum() - refused_before;
        if !self.flooded && (refused > 0 || self.full_looks == FLOOD_LOOKS) {
            self.flooded = true;
            self.notes.push_back(format!(
                "data arrives faster than it can be read, the rest waits: {bytes} bytes at once, {refused} of the datagrams refused"
            ));
        }
        Ok(())
    }
}
