//! Signatures of MAVLink 2 frames: SHA-256 over key, frame, link and time, of which 6 bytes are transmitted.
//!
//! Source: <https://mavlink.io/en/guide/message_signing.html>. Times count in 10 us since 1 January 2015 and
//! must increase with every frame of a stream, so that a recorded frame cannot be replayed.

use std::collections::BTreeMap;
use std::time::Duration;

use sha2::{Digest, Sha256};

use super::SIGNATURE;

/// Largest age of a stream's first frame: one minute, in units of 10 us.
const OLDEST_NEW_STREAM: u64 = 60 * 100_000;

/// Largest number of streams remembered; otherwise other senders could fill the memory.
const STREAMS: usize = 64;

/// 1 January 2015, as a Unix time, s.
const EPOCH_2015: Duration = Duration::from_secs(1_420_070_400);

/// Secret key shared by both ends: 32 bytes.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Key(pub [u8; 32]);

impl std::fmt::Debug for Key {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Key(secret)")
    }
}

impl Key {
    /// The key of a text: 64 hexadecimal digits are the key itself, any other text is a passphrase.
    pub fn from_text(text: &str) -> Self {
        let mut key = [0; 32];
        let digits = text.as_bytes().chunks(2).zip(&mut key);
        let is_key = text.len() == 64
            && text.is_ascii()
            && digits.fold(true, |good, (pair, byte)| {
                let parsed = std::str::from_utf8(pair).ok().and_then(|p| u8::from_str_radix(p, 16).ok());
                *byte = parsed.unwrap_or(0);
                good && parsed.is_some()
            });
        if is_key { Self(key) } else { Self::from_passphrase(text) }
    }

    /// The key of a passphrase: its SHA-256, as in ground stations.
    pub fn from_passphrase(passphrase: &str) -> Self {
        Self(Sha256::digest(passphrase.as_bytes()).into())
    }
}

/// Reason why a frame was refused for its signature.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SignatureFault {
    /// The frame has no signature.
    Missing,
    /// The signature was made with another key, or the frame was modified.
    Wrong,
    /// The time of the frame is not after that of the previous frame: the frame was replayed.
    Replayed,
    /// The first frame of the stream is more than a minute old.
    Old,
}

/// Signs outgoing frames or checks incoming ones.
#[derive(Debug, Clone)]
pub struct Signing {
    key: Key,
    link: u8,
    /// Time at the origin of `now`, in 10 us since 2015.
    origin: u64,
    /// The latest time sent or accepted.
    newest: u64,
    streams: BTreeMap<(u8, u8, u8), u64>,
}

impl Signing {
    /// Signatures with this key on this link; `unix_origin` is the Unix time at the origin of `now`.
    pub fn new(key: Key, link: u8, unix_origin: Duration) -> Self {
        let origin = ten_us(unix_origin.saturating_sub(EPOCH_2015));
        Self { key, link, origin, newest: 0, streams: BTreeMap::new() }
    }

    /// The signature of an unsigned frame; `frame` begins with its first byte and ends with its checksum.
    pub fn sign(&mut self, frame: &[u8], now: Duration) -> [u8; SIGNATURE] {
        self.newest = (self.newest + 1).max(self.clock(now));
        let mut signature = [0; SIGNATURE];
        signature[0] = self.link;
        signature[1..7].copy_from_slice(&self.newest.to_le_bytes()[..6]);
        let hash = self.hash(frame, &signature[..7]);
        signature[7..].copy_from_slice(&hash);
        signature
    }

    /// Checks the signature of a frame of this system and component.
    ///
    /// # Errors
    /// The [`SignatureFault`]; the stream stays as it was.
    pub fn check(
        &mut self,
        frame: &[u8],
        signature: &[u8; SIGNATURE],
        (system, component): (u8, u8),
        now: Duration,
    ) -> Result<(), SignatureFault> {
        if self.hash(frame, &signature[..7]) != signature[7..] {
            return Err(SignatureFault::Wrong);
        }
        let mut bytes = [0; 8];
        bytes[..6].copy_from_slice(&signature[1..7]);
        let time = u64::from_le_bytes(bytes);
        let stream = (signature[0], system, component);
        match self.streams.get(&stream) {
            Some(&last) if time <= last => return Err(SignatureFault::Replayed),
            None if time + OLDEST_NEW_STREAM < self.clock(now).max(self.newest) => {
                return Err(SignatureFault::Old);
            }
            None if self.streams.len() >= STREAMS => return Err(SignatureFault::Old),
            _ => {}
        }
        self.streams.insert(stream, time);
        self.newest = self.newest.max(time);
        Ok(())
    }

    fn clock(&self, now: Duration) -> u64 {
        self.origin + ten_us(now)
    }

    fn hash(&self, frame: &[u8], link_and_time: &[u8]) -> [u8; 6] {
        let digest =
            Sha256::new().chain_update(self.key.0).chain_update(frame).chain_update(link_and_time).finalize();
        let mut hash = [0; 6];
        hash.copy_from_slice(&digest[..6]);
        hash
    }
}

fn ten_us(time: Duration) -> u64 {
    u64::try_from(time.as_micros() / 10).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: Duration = Duration::from_secs(5);

    fn pair() -> (Signing, Signing) {
        let unix = Duration::from_secs(1_700_000_000);
        let key = Key::from_passphrase("bench");
        (Signing::new(key, 3, unix), Signing::new(key, 0, unix))
    }

    #[test]
    fn a_frame_is_believed_once_and_never_changed() {
        let (mut sender, mut receiver) = pair();
        let first = sender.sign(b"\xfdone", NOW);
        let second = sender.sign(b"\xfdtwo", NOW);
        assert_eq!(receiver.check(b"\xfdone", &first, (1, 1), NOW), Ok(()));
        assert_eq!(receiver.check(b"\xfdone", &first, (1, 1), NOW), Err(SignatureFault::Replayed));
        assert_eq!(receiver.check(b"\xfdtwx", &second, (1, 1), NOW), Err(SignatureFault::Wrong));
        assert_eq!(receiver.check(b"\xfdtwo", &second, (1, 1), NOW), Ok(()));
        assert_eq!(receiver.check(b"\xfdone", &first, (2, 1), NOW), Ok(()), "streams are told apart");
    }

    #[test]
    fn a_key_is_given_in_digits_or_as_a_passphrase() {
        assert_eq!(Key::from_text(&"0f".repeat(32)), Key([15; 32]));
        for phrase in ["bench", &"0g".repeat(32)] {
            assert_eq!(Key::from_text(phrase), Key::from_passphrase(phrase));
        }
    }

    #[test]
    fn an_old_stream_is_not_believed() {
        let (mut sender, mut receiver) = pair();
        let old = sender.sign(b"\xfdone", NOW);
        let later = NOW + Duration::from_secs(61);
        assert_eq!(receiver.check(b"\xfdone", &old, (1, 1), later), Err(SignatureFault::Old));
        let mut other = Signing::new(Key([1; 32]), 0, Duration::from_secs(1_700_000_000));
        let foreign = other.sign(b"\xfdone", NOW);
        assert_eq!(receiver.check(b"\xfdone", &foreign, (1, 1), NOW), Err(SignatureFault::Wrong));
        assert!(!format!("{receiver:?}").contains("1, 1"), "the key is not shown");
    }
}
