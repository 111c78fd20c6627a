//! What the fuzz targets in `tests/` share: an input is a script of pieces, each of them raw bytes or a whole frame of
//! its protocol around them, as it was sent or damaged on the way. So inputs get behind the checksums, and every way
//! in which a line spoils a frame comes up. `docs/bridges.md` says how to run the targets.

// What the fuzzing engine's coverage calls must be there in each test program, this library's own too.
#[cfg(test)]
use bolero as _;
use mavlink::Message as _;
use mavlink::dialects::common::MavMessage;

/// Longest content of a piece.
const LONGEST: usize = 90;

/// Numbers of the MAVLink messages that the bridges read or refuse, and of one that no dialect has.
const MAVLINK_IDS: [u32; 20] =
    [0, 1, 26, 30, 31, 32, 65, 69, 70, 76, 77, 82, 93, 105, 111, 116, 129, 147, 253, 60_000];

/// One thing that came over the line.
#[derive(Debug, Clone, Copy)]
pub struct Piece<'a> {
    op: u8,
    /// Bytes, or what a frame is made of.
    pub content: &'a [u8],
}

/// Reads an input as a script: what to do, how many bytes, the bytes.
pub fn pieces(input: &[u8]) -> impl Iterator<Item = Piece<'_>> {
    let mut rest = input;
    std::iter::from_fn(move || {
        let (&op, tail) = rest.split_first()?;
        let (length, tail) =
            tail.split_first().map_or((0, tail), |(n, tail)| (usize::from(*n) % LONGEST, tail));
        let (content, tail) = tail.split_at(length.min(tail.len()));
        rest = tail;
        Some(Piece { op, content })
    })
}

impl Piece<'_> {
    /// A choice of the input's, 0 to 3: a port, or another thing that may happen.
    pub fn choice(&self) -> usize {
        usize::from(self.op >> 1 & 3)
    }

    /// How long after the piece before it came, in steps of the target's choice, 0 to 3.
    pub fn pause(&self) -> u32 {
        u32::from(self.op >> 3 & 3)
    }

    /// What came over the line: the content, or a frame around it; cut, falsified, doubled, or as it is.
    pub fn wire(&self, frame: impl FnOnce(&[u8]) -> Vec<u8>) -> Vec<u8> {
        let mut bytes = if self.op & 1 == 0 { self.content.to_vec() } else { frame(self.content) };
        let at = self.content.iter().fold(0usize, |sum, b| sum + usize::from(*b)) % bytes.len().max(1);
        match self.op >> 5 {
            5 => bytes.truncate(at),
            6 => bytes.iter_mut().skip(at).take(1).for_each(|b| *b ^= 1 << (at % 8)),
            7 => bytes.extend_from_within(..),
            _ => {}
        }
        bytes
    }
}

/// A MAVLink frame with a right checksum, of the version and with the header that the content says, and any payload.
pub fn mavlink_frame(content: &[u8]) -> Vec<u8> {
    let byte = |i: usize| content.get(i).copied().unwrap_or(0);
    let id = MAVLINK_IDS[usize::from(byte(0)) % MAVLINK_IDS.len()];
    let (sequence, system) = (byte(1), byte(2) & 3);
    let payload = content.get(3..).unwrap_or_default();
    let length = payload.len() as u8;
    let [low, middle, high, _] = id.to_le_bytes();
    let head = if byte(2) & 0x80 != 0 && id < 256 {
        vec![0xFE, length, sequence, system, 1, low]
    } else {
        vec![0xFD, length, 0, 0, sequence, system, 1, low, middle, high]
    };
    let mut frame = [head, payload.to_vec()].concat();
    let crc = mavlink::calculate_crc(&frame[1..], MavMessage::extra_crc(id));
    frame.extend(crc.to_le_bytes());
    frame
}

/// A CRSF frame with a right checksum: address, type and payload as the content says.
pub fn crsf_frame(content: &[u8]) -> Vec<u8> {
    let byte = |i: usize| content.get(i).copied().unwrap_or(0);
    let address = [0xC8, 0xEA, 0xEE, 0xC8][usize::from(byte(0)) % 4];
    // Channels, attitude, battery, link statistics with their own lengths, or anything.
    let (kind, length) = match byte(0) >> 2 & 7 {
        0 | 1 => (0x16, 22),
        2 => (0x1E, 6),
        3 => (0x08, 8),
        4 => (0x14, 10),
        _ => (byte(1), usize::from(byte(2)) % 61),
    };
    let mut body = vec![kind];
    body.extend((0..length).map(|i| byte(i + 3)));
    let crc = body.iter().fold(0u8, |crc, b| {
        (0..8).fold(crc ^ b, |crc, _| if crc & 0x80 != 0 { crc << 1 ^ 0xD5 } else { crc << 1 })
    });
    [vec![address, body.len() as u8 + 1], body, vec![crc]].concat()
}

/// An SBUS frame, of both generations, with any channels and flags.
pub fn sbus_frame(content: &[u8]) -> Vec<u8> {
    let byte = |i: usize| content.get(i).copied().unwrap_or(0);
    let mut frame = vec![0x0F];
    frame.extend((0..22).map(|i| byte(i + 1)));
    frame.extend([byte(0) & 0x0F, [0x00, 0x04, 0x14, 0x34][usize::from(byte(0) >> 6)]]);
    frame
}

/// An answer in the MultiWii Serial Protocol, an attitude more often than not.
pub fn msp_frame(content: &[u8]) -> Vec<u8> {
    let (&first, payload) = content.split_first().unwrap_or((&0, &[]));
    let command = if first & 3 == 0 { first } else { 108 };
    let mut frame = vec![b'$', b'M', b'>', payload.len() as u8, command];
    frame.extend(payload);
    frame.push(frame[3..].iter().fold(0, |sum, b| sum ^ b));
    frame
}
