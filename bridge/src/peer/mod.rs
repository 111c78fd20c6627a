//! Who the other end of a link is.
//!
//! An address is not believed because something came from it: the first that says something valid in the protocol is
//! the peer, and stays it for as long as it goes on. Meanwhile whoever else speaks is refused before a byte of it is decoded,
//! so that a flood costs little and can steal nothing. A [`Pin`] in the configuration refuses all others from the start.
//!
//! ```
//! use std::time::Duration;
//! use whirlstand_bridge::peer::{PeerKeeper, SILENCE, Verdict};
//!
//! let [vehicle, stranger] = ["192.0.2.7:14550", "192.0.2.66:9"].map(|a| a.parse().unwrap());
//! let at = Duration::from_millis;
//! let mut keeper = PeerKeeper::new(None, SILENCE);
//! assert_eq!(keeper.judge(vehicle, at(0)), Verdict::Candidate);
//! keeper.adopt(vehicle, at(0));
//! assert_eq!(keeper.judge(stranger, at(900)), Verdict::Refused);
//! assert_eq!(keeper.judge(stranger, at(1100)), Verdict::Candidate);
//! ```

use std::collections::VecDeque;
use std::net::{IpAddr, SocketAddr};
use std::str::FromStr;
use std::time::Duration;

use serde::{Deserialize, Serialize};

/// A peer that has sent nothing valid for so long may be replaced.
pub const SILENCE: Duration = Duration::from_secs(1);

/// The only sender that is believed: a host, or a host and a port.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Pin {
    /// Any port of this host.
    Host(IpAddr),
    /// This port of this host.
    Place(SocketAddr),
}

impl Pin {
    /// Whether this sender is meant. An IPv4 address in IPv6's notation is the same address.
    pub fn admits(self, from: SocketAddr) -> bool {
        let ip = from.ip().to_canonical();
        match self {
            Self::Host(host) => host.to_canonical() == ip,
            Self::Place(place) => place.ip().to_canonical() == ip && place.port() == from.port(),
        }
    }
}

/// A text that names no sender.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("'{0}' is no numeric address: 192.0.2.7 or 192.0.2.7:14550 is expected")]
pub struct PinError(String);

impl FromStr for Pin {
    type Err = PinError;

    fn from_str(text: &str) -> Result<Self, PinError> {
        let place = || text.parse().map(Self::Place);
        text.parse().map(Self::Host).or_else(|_| place()).map_err(|_| PinError(text.into()))
    }
}

impl TryFrom<String> for Pin {
    type Error = PinError;

    fn try_from(text: String) -> Result<Self, PinError> {
        text.parse()
    }
}

impl From<Pin> for String {
    fn from(pin: Pin) -> Self {
        pin.to_string()
    }
}

impl std::fmt::Display for Pin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Host(host) => write!(f, "{host}"),
            Self::Place(place) => write!(f, "{place}"),
        }
    }
}

/// What is to be done with something that came.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// It is the peer's: decode it.
    Peer,
    /// There is no peer that speaks: adopt the sender if it is valid by itself.
    Candidate,
    /// Give it up unread.
    Refused,
}

/// Datagrams and clients that were given up because of who sent them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PeerCounts {
    /// Of a second sender, while the peer speaks.
    pub second: u64,
    /// Of a sender that is not the pinned one.
    pub not_pinned: u64,
    /// Of a sender who was not the peer, and nothing valid in the protocol.
    pub invalid: u64,
}

impl PeerCounts {
    /// All of them.
    pub fn sum(&self) -> u64 {
        self.second + self.not_pinned + self.invalid
    }
}

impl std::ops::Add for PeerCounts {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            second: self.second + other.second,
            not_pinned: self.not_pinned + other.not_pinned,
            invalid: self.invalid + other.invalid,
        }
    }
}

/// What the user is to know. Each is told once for a peer, however often it happens.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum PeerNote {
    /// The first peer.
    #[error("the other end is {0}")]
    Adopted(SocketAddr),
    /// Another peer after the first.
    #[error("the other end is {address} now: {before} had sent nothing valid for {}", seconds(silence))]
    Replaced {
        /// The new peer.
        address: SocketAddr,
        /// The old one.
        before: SocketAddr,
        /// How long it was silent at least.
        silence: Duration,
    },
    /// Somebody speaks beside the peer.
    #[error("{address} sends as well and is refused: {peer} is the other end and is active")]
    Second {
        /// Who is refused.
        address: SocketAddr,
        /// The peer.
        peer: SocketAddr,
    },
    /// Somebody who is not pinned.
    #[error("{address} is refused: only {pin} is accepted here")]
    NotPinned {
        /// Who is refused.
        address: SocketAddr,
        /// Who is not.
        pin: Pin,
    },
    /// What came makes no peer.
    #[error("{bytes} bytes from {address} are refused: they are not valid messages of the protocol")]
    Invalid {
        /// Who sent them.
        address: SocketAddr,
        /// How many.
        bytes: usize,
    },
}

impl PeerNote {
    /// Whether the user should look at it.
    pub fn is_warning(&self) -> bool {
        !matches!(self, Self::Adopted(_))
    }
}

/// A time of the configuration in words.
fn seconds(time: &Duration) -> String {
    format!("{} s", time.as_secs_f64())
}

#[derive(Debug, Clone, Copy)]
struct Held {
    address: SocketAddr,
    /// When it said something valid last, or came.
    at: Duration,
    has_spoken: bool,
}

/// Keeps the peer of one link.
#[derive(Debug, Clone)]
pub struct PeerKeeper {
    pin: Option<Pin>,
    silence: Duration,
    held: Option<Held>,
    counts: PeerCounts,
    /// What was told since the peer came.
    told: PeerCounts,
    notes: VecDeque<PeerNote>,
}

impl PeerKeeper {
    /// A link without a peer, which may be replaced after `silence`.
    pub fn new(pin: Option<Pin>, silence: Duration) -> Self {
        Self {
            pin,
            silence,
            held: None,
            counts: PeerCounts::default(),
            told: PeerCounts::default(),
            notes: VecDeque::new(),
        }
    }

    /// The peer.
    pub fn peer(&self) -> Option<SocketAddr> {
        self.held.map(|held| held.address)
    }

    /// How long a peer may be silent.
    pub fn silence(&self) -> Duration {
        self.silence
    }

    /// Whether nobody has to be waited for any more: no peer, or one that is silent for too long.
    pub fn is_free(&self, now: Duration) -> bool {
        self.held.is_none_or(|held| now.saturating_sub(held.at) > self.silence)
    }

    /// Whether the peer has ever said something valid.
    pub fn has_spoken(&self) -> bool {
        self.held.is_some_and(|held| held.has_spoken)
    }

    /// Whether a sender is not kept off by the pin; one that is, is counted.
    pub fn admits(&mut self, from: SocketAddr) -> bool {
        let Some(pin) = self.pin.filter(|pin| !pin.admits(from)) else { return true };
        self.counts.not_pinned += 1;
        if std::mem::replace(&mut self.told.not_pinned, 1) == 0 {
            self.notes.push_back(PeerNote::NotPinned { address: from, pin });
        }
        false
    }

    /// What is to be done with something from this sender; what is refused is counted.
    pub fn judge(&mut self, from: SocketAddr, now: Duration) -> Verdict {
        if !self.admits(from) {
            return Verdict::Refused;
        }
        match self.held {
            Some(held) if held.address == from => Verdict::Peer,
            Some(held) if !self.is_free(now) => {
                self.counts.second += 1;
                if std::mem::replace(&mut self.told.second, 1) == 0 {
                    self.notes.push_back(PeerNote::Second { address: from, peer: held.address });
                }
                Verdict::Refused
            }
            _ => Verdict::Candidate,
        }
    }

    /// Makes a candidate the peer, because it said something valid; whom it replaces.
    pub fn adopt(&mut self, address: SocketAddr, now: Duration) -> Option<SocketAddr> {
        let before = self.peer().filter(|before| *before != address);
        self.hold(address, now);
        self.keep(now);
        self.notes.push_back(match before {
            Some(before) => PeerNote::Replaced { address, before, silence: self.silence },
            None => PeerNote::Adopted(address),
        });
        before
    }

    /// A client has connected: it holds the link, and has said nothing yet.
    pub fn hold(&mut self, address: SocketAddr, now: Duration) {
        self.held = Some(Held { address, at: now, has_spoken: false });
        // What concerns the pin does not change with the peer.
        self.told = PeerCounts { not_pinned: self.told.not_pinned, ..PeerCounts::default() };
    }

    /// The peer said something valid.
    pub fn keep(&mut self, now: Duration) {
        if let Some(held) = &mut self.held {
            (held.at, held.has_spoken) = (now, true);
        }
    }

    /// The peer's connection is closed.
    pub fn release(&mut self) {
        self.held = None;
    }

    /// A candidate said so many bytes, and nothing valid.
    pub fn refuse(&mut self, address: SocketAddr, bytes: usize) {
        self.counts.invalid += 1;
        if std::mem::replace(&mut self.told.invalid, 1) == 0 {
            self.notes.push_back(PeerNote::Invalid { address, bytes });
        }
    }

    /// What was given up.
    pub fn counts(&self) -> PeerCounts {
        self.counts
    }

    /// The oldest note for the user.
    pub fn note(&mut self) -> Option<PeerNote> {
        self.notes.pop_front()
    }
}

#[cfg(test)]
mod tests;
