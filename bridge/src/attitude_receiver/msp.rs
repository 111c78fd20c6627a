//! The attitude in the MultiWii Serial Protocol, version 1: `$M>`, length, command, payload, and the exclusive or of all
//! from the length on.
//!
//! Source: `src/main/msp` of Betaflight; <https://www.multiwii.com/wiki/index.php?title=Multiwii_Serial_Protocol>.

use crate::stream::Stream;

/// Number of MSP_ATTITUDE: i16 roll and pitch in 0.1 deg, i16 heading in deg.
const ATTITUDE: u8 = 108;
/// Bytes of its payload.
const PAYLOAD: usize = 6;
/// `$M>`, length and command.
const HEAD: usize = 5;

/// The question for the attitude: no payload.
pub(super) const ATTITUDE_REQUEST: [u8; 6] = [b'$', b'M', b'<', 0, ATTITUDE, ATTITUDE];

/// An attitude, rad: right side down, nose up, clockwise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Attitude {
    pub(super) angles: [f64; 3],
}

/// Finds attitudes in a stream of answers.
#[derive(Debug, Default)]
pub(super) struct Parser(Stream);

impl Parser {
    pub(super) fn push(&mut self, bytes: &[u8]) {
        self.0.push(bytes);
    }

    /// The next attitude; `None` until more bytes come. What is no attitude is skipped.
    pub(super) fn next_attitude(&mut self) -> Option<Attitude> {
        loop {
            let bytes = self.0.waiting();
            let start = bytes.iter().position(|b| *b == b'$').unwrap_or(bytes.len());
            self.0.skip(start);
            let bytes = self.0.waiting();
            let head = bytes.first_chunk::<HEAD>()?;
            let length = usize::from(head[3]);
            if head[1] != b'M' || head[2] != b'>' {
                self.0.skip(1);
                continue;
            }
            let frame = bytes.get(..HEAD + length + 1)?;
            let sum = frame[3..HEAD + length].iter().fold(0, |sum, b| sum ^ b);
            let whole = sum == frame[HEAD + length];
            let attitude =
                if whole && head[4] == ATTITUDE { read(&frame[HEAD..HEAD + length]) } else { None };
            self.0.skip(if whole { HEAD + length + 1 } else { 1 });
            if attitude.is_some() {
                return attitude;
            }
        }
    }
}

/// Betaflight's pitch is positive nose down.
fn read(payload: &[u8]) -> Option<Attitude> {
    let payload = payload.first_chunk::<PAYLOAD>()?;
    let value = |at: usize| f64::from(i16::from_le_bytes([payload[at], payload[at + 1]]));
    let angles = [0.1 * value(0), -0.1 * value(2), value(4)].map(f64::to_radians);
    Some(Attitude { angles })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn frame(command: u8, payload: &[u8]) -> Vec<u8> {
        let mut bytes = vec![b'$', b'M', b'>', payload.len() as u8, command];
        bytes.extend(payload);
        bytes.push(bytes[3..].iter().fold(0, |sum, b| sum ^ b));
        bytes
    }

    proptest! {
        #[test]
        fn attitudes_are_found_between_other_bytes_in_any_pieces(
            noise in prop::collection::vec(any::<u8>().prop_filter("no frame begins", |b| *b != b'$'), 0..40),
            raw in prop::array::uniform3(any::<i16>()),
            piece in 1usize..30,
        ) {
            let payload = raw.map(i16::to_le_bytes).concat();
            let stream = [&noise[..], &frame(100, &[1, 2, 3]), &noise, &frame(ATTITUDE, &payload), b"$$M"].concat();
            let (mut parser, mut found) = (Parser::default(), Vec::new());
            for bytes in stream.chunks(piece) {
                parser.push(bytes);
                found.extend(std::iter::from_fn(|| parser.next_attitude()));
            }
            prop_assert_eq!(found, vec![read(&payload).unwrap()]);
        }

        #[test]
        fn any_bytes_are_taken_without_harm(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
            let mut parser = Parser::default();
            parser.push(&bytes);
            while parser.next_attitude().is_some() {}
            prop_assert!(parser.0.waiting().len() < HEAD + 256);
        }
    }
}
