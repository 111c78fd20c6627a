//! Decodes CRSF frames from bytes.

use super::frames::{Attitude, Battery, CHANNEL_BYTES, Channels, LinkStatistics, unpack_channels};
use super::{HANDSET, LONGEST_FRAME, SYNC, TRANSMITTER, crc8, kind};
use crate::stream::Stream;

/// Event decoded from the received bytes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Event {
    /// Channels of a handset or a receiver.
    Channels(Channels),
    /// Attitude telemetry.
    Attitude(Attitude),
    /// Battery telemetry.
    Battery(Battery),
    /// Quality of the radio link.
    LinkStatistics(LinkStatistics),
    /// A complete frame of another type.
    Other(u8),
    /// A discarded frame with a wrong checksum.
    Checksum,
    /// A discarded frame, too short for its type.
    Malformed(u8),
    /// Bytes outside of frames, with their number.
    Noise(usize),
}

/// Counts of everything received.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Number of bytes received.
    pub bytes: u64,
    /// Number of frames with a correct checksum.
    pub frames: u64,
    /// Number of frames with a wrong checksum.
    pub checksum: u64,
    /// Number of frames too short for their type.
    pub malformed: u64,
    /// Number of bytes outside of frames.
    pub noise_bytes: u64,
}

/// Finds frames in a stream of bytes. A damaged frame does not affect others: the search continues after its
/// first byte.
#[derive(Debug, Clone, Default)]
pub struct Parser {
    stream: Stream,
    counts: Counts,
}

impl Parser {
    /// A parser without data.
    pub fn new() -> Self {
        Self::default()
    }

    /// Counts of everything received so far.
    pub fn counts(&self) -> &Counts {
        &self.counts
    }

    /// Adds received bytes. Call [`Parser::next_event`] until it returns `None` before adding more.
    pub fn push(&mut self, bytes: &[u8]) {
        self.counts.bytes += bytes.len() as u64;
        self.stream.push(bytes);
    }

    /// Discards a partly received frame, after a reconnection.
    pub fn reset(&mut self) {
        self.counts.noise_bytes += self.stream.clear() as u64;
    }

    /// The next event; `None` until more bytes arrive.
    pub fn next_event(&mut self) -> Option<Event> {
        let bytes = self.stream.waiting();
        let is_start = |b: &u8| matches!(*b, SYNC | HANDSET | TRANSMITTER);
        let noise = bytes.iter().position(is_start).unwrap_or(bytes.len());
        if noise > 0 {
            return Some(self.noise(noise));
        }
        let &length = bytes.get(1)?;
        // At least type and checksum; a claimed length beyond the longest frame is invalid.
        let whole = usize::from(length) + 2;
        if length < 2 || whole > LONGEST_FRAME {
            return Some(self.noise(1));
        }
        let frame = bytes.get(2..whole)?;
        let (body, crc) = frame.split_at(frame.len() - 1);
        if [crc8(body)] != crc {
            self.stream.skip(1);
            self.counts.checksum += 1;
            return Some(Event::Checksum);
        }
        let event = content(body[0], &body[1..]);
        self.stream.skip(whole);
        match event {
            Event::Malformed(_) => self.counts.malformed += 1,
            _ => self.counts.frames += 1,
        }
        Some(event)
    }

    fn noise(&mut self, bytes: usize) -> Event {
        self.stream.skip(bytes);
        self.counts.noise_bytes += bytes as u64;
        Event::Noise(bytes)
    }
}

fn content(kind: u8, payload: &[u8]) -> Event {
    let event = match kind {
        kind::CHANNELS => <&[u8; CHANNEL_BYTES]>::try_from(payload)
            .ok()
            .map(|p| Event::Channels(Channels(unpack_channels(p)))),
        kind::ATTITUDE => Attitude::read(payload).map(Event::Attitude),
        kind::BATTERY => Battery::read(payload).map(Event::Battery),
        kind::LINK_STATISTICS => LinkStatistics::read(payload).map(Event::LinkStatistics),
        other => Some(Event::Other(other)),
    };
    event.unwrap_or(Event::Malformed(kind))
}

#[cfg(test)]
mod tests {
    use super::super::{write_attitude, write_channels};
    use super::*;

    fn events(bytes: &[u8]) -> Vec<Event> {
        let mut parser = Parser::new();
        parser.push(bytes);
        std::iter::from_fn(|| parser.next_event()).collect()
    }

    #[test]
    fn the_independent_crate_reads_our_channels() {
        let channels = std::array::from_fn(|i| 172 + 100 * i as u16);
        let mut bytes = Vec::new();
        write_channels(&Channels(channels), &mut bytes);
        assert_eq!((bytes.len(), &bytes[..3]), (26, &[0xC8, 0x18, 0x16][..]));
        let mut theirs = crsf::PacketParser::<128>::new();
        theirs.push_bytes(&bytes);
        let Some(Ok((_, crsf::Packet::RcChannels(read)))) = theirs.next_packet() else { panic!() };
        assert_eq!(read.0, channels);
        assert_eq!(events(&bytes), [Event::Channels(Channels(channels))]);
    }

    #[test]
    fn we_read_the_frames_of_the_independent_crate() {
        let channels = std::array::from_fn(|i| 2047 - 99 * i as u16);
        let packet = crsf::Packet::RcChannels(crsf::RcChannels(channels));
        let raw = packet.into_raw(crsf::PacketAddress::Controller);
        assert_eq!(events(raw.data()), [Event::Channels(Channels(channels))]);
    }

    #[test]
    fn telemetry_is_read_as_published() {
        // Frames by hand from the specification: 1.2345 rad pitch, -0.1 rad roll, 3.0416 rad yaw; 16.8 V, 12.3 A, 1500 mAh.
        let attitude = [0x30, 0x39, 0xFC, 0x18, 0x76, 0xD0];
        let battery = [0x00, 0xA8, 0x00, 0x7B, 0x00, 0x05, 0xDC, 0x4B];
        let link = [60, 61, 99, 0xF6, 0, 4, 2, 70, 100, 8];
        let mut bytes = vec![0x00, 0x55];
        for (kind, payload) in [(0x1E, &attitude[..]), (0x08, &battery), (0x14, &link), (0x29, &[1, 2, 3])] {
            let start = bytes.len() + 2;
            bytes.extend([0xC8, payload.len() as u8 + 2, kind]);
            bytes.extend(payload);
            bytes.push(crc8(&bytes[start..]));
        }
        let found = events(&bytes);
        assert_eq!(found[0], Event::Noise(2));
        let Event::Attitude(a) = found[1] else { panic!("{found:?}") };
        for (read, sent) in [(a.pitch, 1.2345), (a.roll, -0.1), (a.yaw, 3.0416)] {
            assert!((read - sent).abs() < 1e-9, "{a:?}");
        }
        let Event::Battery(b) = found[2] else { panic!("{found:?}") };
        assert!((b.voltage_v - 16.8).abs() < 1e-9 && (b.current_a - 12.3).abs() < 1e-9);
        assert_eq!((b.used_mah, b.remaining_percent), (1500, 75));
        let Event::LinkStatistics(l) = found[3] else { panic!("{found:?}") };
        assert_eq!((l.uplink_rssi_dbm, l.uplink_quality, l.uplink_snr_db), (-60, 99, -10));
        assert_eq!((l.downlink_rssi_dbm, l.downlink_quality), (-70, 100));
        assert_eq!(found[4], Event::Other(0x29));
    }

    #[test]
    fn a_damaged_frame_costs_itself_alone() {
        let mut bytes = Vec::new();
        for roll in [0.1, 0.2, 0.3] {
            write_attitude(&Attitude { roll, pitch: 0.0, yaw: 0.0 }, &mut bytes);
        }
        bytes[13] ^= 0x40;
        let rolls: Vec<_> = events(&bytes)
            .iter()
            .filter_map(|e| if let Event::Attitude(a) = e { Some((a.roll * 10.0).round()) } else { None })
            .collect();
        assert_eq!(rolls, [1.0, 3.0]);
    }
}
