//! Determines the peer of a link, the other end that is accepted.
//!
//! A sender does not become the peer by sending anything: the first one with a valid message in the protocol
//! is the peer, and stays it as long as it continues. Meanwhile data of other senders are refused without
//! decoding, so that a flood costs little and cannot take over the link. A [`Pin`] in the configuration
//! refuses all others from the start.
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

/// Silence after which a peer may be replaced.
pub const SILENCE: Duration = Duration::from_secs(1);

/// The only accepted sender: a host, or a host and a port.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Pin {
    /// Any port of this host.
    Host(IpAddr),
    /// This port of this host.
    Place(SocketAddr),
}

impl Pin {
    /// True when this sender matches. An IPv4 address in IPv6 notation is the same address.
    pub fn admits(self, from: SocketAddr) -> bool {
        let ip = from.ip().to_canonical();
        match self {
            Self::Host(host) => host.to_canonical() == ip,
            Self::Place(place) => place.ip().to_canonical() == ip && place.port() == from.port(),
        }
    }
}

/// The text is not a valid sender.
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

/// Verdict on received data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// The data are from the peer and are to be decoded.
    Peer,
    /// There is no active peer: adopt the sender if the data are valid by themselves.
    Candidate,
    /// Discard the data unread.
    Refused,
}

/// Counts of datagrams and clients discarded because of their sender.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PeerCounts {
    /// Number from a second sender, while the peer is active.
    pub second: u64,
    /// Number from another sender than the pinned one.
    pub not_pinned: u64,
    /// Number from a sender that was not the peer, without valid data.
    pub invalid: u64,
}

impl PeerCounts {
    /// Sum of all counts.
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

/// Notes to the user. Each is reported once per peer.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum PeerNote {
    /// The first peer was adopted.
    #[error("the other end is {0}")]
    Adopted(SocketAddr),
    /// Another peer has replaced the previous one.
    #[error("the other end is {address} now: {before} had sent nothing valid for {}", seconds(silence))]
    Replaced {
        /// The new peer.
        address: SocketAddr,
        /// Address of the previous peer.
        before: SocketAddr,
        /// Silence of the previous peer, at least.
        silence: Duration,
    },
    /// A second sender besides the peer.
    #[error("{address} sends as well and is refused: {peer} is the other end and is active")]
    Second {
        /// Address of the refused sender.
        address: SocketAddr,
        /// Address of the peer.
        peer: SocketAddr,
    },
    /// A sender that is not the pinned one.
    #[error("{address} is refused: only {pin} is accepted here")]
    NotPinned {
        /// Address of the refused sender.
        address: SocketAddr,
        /// The pinned sender.
        pin: Pin,
    },
    /// Data that are not valid by themselves.
    #[error("{bytes} bytes from {address} are refused: they are not valid messages of the protocol")]
    Invalid {
        /// Address of the sender.
        address: SocketAddr,
        /// Number of bytes.
        bytes: usize,
    },
}

impl PeerNote {
    /// True for a warning.
    pub fn is_warning(&self) -> bool {
        !matches!(self, Self::Adopted(_))
    }
}

/// A configured time as text.
fn seconds(time: &Duration) -> String {
    format!("{} s", time.as_secs_f64())
}

#[derive(Debug, Clone, Copy)]
struct Held {
    address: SocketAddr,
    /// Time of its last valid data, or of its connection.
    at: Duration,
    has_spoken: bool,
}

/// Determines the peer of one link.
#[derive(Debug, Clone)]
pub struct PeerKeeper {
    pin: Option<Pin>,
    silence: Duration,
    held: Option<Held>,
    counts: PeerCounts,
    /// Counts reported since the peer was adopted.
    told: PeerCounts,
    notes: VecDeque<PeerNote>,
}

impl PeerKeeper {
    /// A link without a peer; a peer may be replaced after `silence`.
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

    /// Address of the peer.
    pub fn peer(&self) -> Option<SocketAddr> {
        self.held.map(|held| held.address)
    }

    /// Silence after which a peer may be replaced.
    pub fn silence(&self) -> Duration {
        self.silence
    }

    /// True when a new peer may be adopted: there is none, or it has been silent for too long.
    pub fn is_free(&self, now: Duration) -> bool {
        self.held.is_none_or(|held| now.saturating_sub(held.at) > self.silence)
    }

    /// True when the peer has ever sent valid data.
    pub fn has_spoken(&self) -> bool {
        self.held.is_some_and(|held| held.has_spoken)
    }

    /// True unless the pin excludes a sender; an excluded one is counted.
    pub fn admits(&mut self, from: SocketAddr) -> bool {
        let Some(pin) = self.pin.filter(|pin| !pin.admits(from)) else { return true };
        self.counts.not_pinned += 1;
        if std::mem::replace(&mut self.told.not_pinned, 1) == 0 {
            self.notes.push_back(PeerNote::NotPinned { address: from, pin });
        }
        false
    }

    /// Verdict on data from this sender; refused data are counted.
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

    /// Makes a candidate with valid data the peer; returns the peer that it replaces.
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

    /// Assigns the link to a connected client that has sent nothing yet.
    pub fn hold(&mut self, address: SocketAddr, now: Duration) {
        self.held = Some(Held { address, at: now, has_spoken: false });
        // Reports on the pin do not depend on the peer.
        self.told = PeerCounts { not_pinned: self.told.not_pinned, ..PeerCounts::default() };
    }

    /// Records valid data of the peer.
    pub fn keep(&mut self, now: Duration) {
        if let Some(held) = &mut self.held {
            (held.at, held.has_spoken) = (now, true);
        }
    }

    /// Records the end of the peer's connection.
    pub fn release(&mut self) {
        self.held = None;
    }

    /// Records invalid data of a candidate.
    pub fn refuse(&mut self, address: SocketAddr, bytes: usize) {
        self.counts.invalid += 1;
        if std::mem::replace(&mut self.told.invalid, 1) == 0 {
            self.notes.push_back(PeerNote::Invalid { address, bytes });
        }
    }

    /// Counts of discarded data.
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
