//! SBUS, the serial protocol of Futaba receivers: channels out, and a receiver as the pilot's stick.
//!
//! 100 000 baud, 8E2, inverted (the inverter is hardware). A frame is 25 bytes: 0x0F, 16 channels of 11 bits
//! little-endian, a byte of flags, an end byte. There is no checksum: the only protection is the line's
//! parity, the first and the last byte and the pause between frames. So a frame is accepted only when the
//! flags' unused bits are zero and the next byte, if present, begins a frame as well.
//!
//! us = 5/8 ticks + 880.

use crate::crsf::{pack_channels, unpack_channels};
use crate::stream::Stream;

/// Length of a frame in bytes.
pub const FRAME: usize = 25;
/// Baud rate.
pub const BAUD: u32 = 100_000;

const START: u8 = 0x0F;
/// End of a frame of SBUS.
const END: u8 = 0x00;
/// Frames of SBUS2 end with 0x04, 0x14, 0x24 or 0x34.
const END_SBUS2: u8 = 0x04;
const CHANNEL_17: u8 = 1;
const CHANNEL_18: u8 = 2;
const FRAME_LOST: u8 = 4;
const FAILSAFE: u8 = 8;

/// A frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frame {
    /// Sixteen channels in ticks, 0 to 2047.
    pub channels: [u16; 16],
    /// Digital channels 17 and 18.
    pub digital: [bool; 2],
    /// The receiver missed a frame, and repeats the last one.
    pub lost: bool,
    /// The receiver lost its transmitter: the channels have their configured failsafe values.
    pub failsafe: bool,
}

/// Ticks of a pulse width, limited to 11 bits.
pub fn ticks_of_us(us: f64) -> u16 {
    (((us - 880.0) * 8.0 / 5.0).round() as u16).min(0x7FF)
}

/// Pulse width of ticks, us.
pub fn us_of_ticks(ticks: u16) -> f64 {
    f64::from(ticks) * 5.0 / 8.0 + 880.0
}

/// Appends a frame.
pub fn write(frame: &Frame, out: &mut Vec<u8>) {
    let mut packed = [0; 22];
    pack_channels(&frame.channels, &mut packed);
    let flags = [
        (frame.digital[0], CHANNEL_17),
        (frame.digital[1], CHANNEL_18),
        (frame.lost, FRAME_LOST),
        (frame.failsafe, FAILSAFE),
    ];
    let flags = flags.iter().filter(|(set, _)| *set).fold(0, |bits, (_, bit)| bits | bit);
    out.push(START);
    out.extend_from_slice(&packed);
    out.extend_from_slice(&[flags, END]);
}

/// Counts of everything received.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Number of bytes received.
    pub bytes: u64,
    /// Number of frames.
    pub frames: u64,
    /// Number of bytes outside of frames.
    pub noise_bytes: u64,
}

/// Finds frames in a stream of bytes.
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

    /// Adds received bytes. Call [`Parser::next_frame`] until it returns `None` before adding more.
    pub fn push(&mut self, bytes: &[u8]) {
        self.counts.bytes += bytes.len() as u64;
        self.stream.push(bytes);
    }

    /// Discards a partly received frame: after a pause in the line, which no frame contains, or a
    /// reconnection.
    pub fn reset(&mut self) {
        self.counts.noise_bytes += self.stream.clear() as u64;
    }

    /// The next frame; `None` until more bytes arrive.
    pub fn next_frame(&mut self) -> Option<Frame> {
        loop {
            let bytes = self.stream.waiting();
            let noise = bytes.iter().position(|b| *b == START).unwrap_or(bytes.len());
            if noise > 0 {
                self.skip(noise);
                continue;
            }
            let frame = bytes.first_chunk::<FRAME>()?;
            let (flags, end) = (frame[23], frame[24]);
            let ends = end == END || end & 0xCF == END_SBUS2;
            let follows = bytes.get(FRAME).is_none_or(|b| *b == START);
            if !ends || flags & 0xF0 != 0 || !follows {
                self.skip(1);
                continue;
            }
            let mut packed = [0; 22];
            packed.copy_from_slice(&frame[1..23]);
            self.stream.skip(FRAME);
            self.counts.frames += 1;
            return Some(Frame {
                channels: unpack_channels(&packed),
                digital: [flags & CHANNEL_17 != 0, flags & CHANNEL_18 != 0],
                lost: flags & FRAME_LOST != 0,
                failsafe: flags & FAILSAFE != 0,
            });
        }
    }

    fn skip(&mut self, bytes: usize) {
        self.stream.skip(bytes);
        self.counts.noise_bytes += bytes as u64;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn frames(bytes: &[u8]) -> Vec<Frame> {
        let mut parser = Parser::new();
        parser.push(bytes);
        std::iter::from_fn(|| parser.next_frame()).collect()
    }

    #[test]
    fn pulse_widths_are_those_of_the_protocol() {
        assert_eq!((ticks_of_us(1500.0), us_of_ticks(992)), (992, 1500.0));
        assert_eq!((ticks_of_us(1000.0), ticks_of_us(2000.0)), (192, 1792));
        assert_eq!((ticks_of_us(0.0), ticks_of_us(9000.0)), (0, 2047));
    }

    #[test]
    fn a_frame_is_laid_out_as_published() {
        let mut bytes = Vec::new();
        let mut channels = [0; 16];
        (channels[0], channels[1], channels[15]) = (0x7FF, 1, 0x400);
        write(&Frame { channels, digital: [true, false], lost: false, failsafe: true }, &mut bytes);
        assert_eq!(bytes.len(), FRAME);
        assert_eq!(
            (bytes[0], bytes[1], bytes[2], bytes[22], bytes[23], bytes[24]),
            (0x0F, 0xFF, 0x0F, 0x80, 9, 0)
        );
    }

    #[test]
    fn noise_and_half_frames_are_skipped_and_counted() {
        let frame = Frame { channels: [992; 16], digital: [false; 2], lost: true, failsafe: false };
        let mut bytes = vec![1, 2, 3];
        write(&frame, &mut bytes);
        bytes.truncate(20);
        write(&frame, &mut bytes);
        write(&frame, &mut bytes);
        let mut parser = Parser::new();
        parser.push(&bytes);
        assert_eq!(std::iter::from_fn(|| parser.next_frame()).collect::<Vec<_>>(), [frame, frame]);
        assert_eq!(parser.counts().noise_bytes, 20);
    }

    proptest! {
        #[test]
        fn frames_survive_the_wire_in_any_pieces(
            channels in prop::array::uniform16(0u16..2048),
            bits in prop::array::uniform4(any::<bool>()),
            cut in 0usize..50,
        ) {
            let [a, b, lost, failsafe] = bits;
            let frame = Frame { channels, digital: [a, b], lost, failsafe };
            let mut bytes = Vec::new();
            write(&frame, &mut bytes);
            write(&frame, &mut bytes);
            prop_assert_eq!(frames(&bytes), [frame, frame]);
            let mut parser = Parser::new();
            let (first, second) = bytes.split_at(cut);
            let mut found = Vec::new();
            for part in [first, second] {
                parser.push(part);
                found.extend(std::iter::from_fn(|| parser.next_frame()));
            }
            prop_assert_eq!(found, [frame, frame]);
        }
    }
}
