//! Layout of the messages of a log, as its FMT messages define it.

/// Type of the messages that define others.
pub(super) const DEFINITION: u8 = 128;

/// Bytes of a message header: two of magic and one for the type.
pub(super) const HEADER: usize = 3;

/// Bytes of a message that defines another one.
pub(super) const DEFINITION_LENGTH: u8 = 89;

/// Number of elements in a field of kind `a`.
const ARRAY: usize = 32;

/// The layout of one type of message.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Format {
    /// Its type.
    pub kind: u8,
    /// Bytes of a message, header included.
    pub length: u8,
    /// Its name, for example `IMU`.
    pub name: String,
    /// Its fields, up to the first one of unknown kind.
    pub fields: Vec<Field>,
    /// Kind of that field.
    pub unknown: Option<char>,
}

/// A field of a message.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Field {
    /// Its name, for example `GyrX`.
    pub label: String,
    /// The letter that defines how the field is stored.
    pub kind: u8,
    /// Offset of the field in the content, bytes.
    offset: usize,
}

impl Format {
    /// The format that the content of an FMT message defines; `None` if it is inconsistent.
    pub fn parse(content: &[u8]) -> Option<Self> {
        let (kind, length) = (*content.first()?, *content.get(1)?);
        let name = text(content.get(2..6)?);
        let (letters, labels) = (text(content.get(6..22)?), text(content.get(22..86)?));
        let mut labels = labels.split(',');
        let (mut fields, mut unknown, mut end) = (Vec::new(), None, 0);
        for letter in letters.chars() {
            let stored = u8::try_from(letter).ok().and_then(|kind| Some((kind, size(kind)?)));
            let Some((kind, bytes)) = stored else {
                unknown = Some(letter);
                break;
            };
            let label = labels.next().filter(|label| !label.is_empty())?;
            fields.push(Field { label: label.trim().into(), kind, offset: end });
            end += bytes;
        }
        let is_whole = !name.is_empty() && HEADER + end <= length.into();
        is_whole.then_some(Self { kind, length, name, fields, unknown })
    }

    /// Time of a message since the autopilot started, ns; `None` for the few messages without a time.
    pub fn time_ns(&self, content: &[u8]) -> Option<u64> {
        let first = self.fields.first()?;
        match (first.label.as_str(), first.kind) {
            ("TimeUS", b'Q') => Some(unsigned::<8>(content)?.saturating_mul(1000)),
            ("TimeMS", b'I') => Some(unsigned::<4>(content)? * 1_000_000),
            _ => None,
        }
    }

    /// True for the message in which PX4's sdlog2 keeps the time of all others.
    pub fn is_sdlog2_time(&self) -> bool {
        self.name == "TIME" && self.fields.first().is_some_and(|field| field.label == "StartTime")
    }
}

impl Field {
    /// Number of numeric elements in the field; 0 for a text.
    pub fn numbers(&self) -> usize {
        match self.kind {
            b'n' | b'N' | b'Z' => 0,
            b'a' => ARRAY,
            _ => 1,
        }
    }

    /// A number of the field as stored, without any scale.
    pub fn number(&self, content: &[u8], element: usize) -> Option<f64> {
        let bytes = content.get(self.offset..)?;
        match self.kind {
            b'a' => number(b'h', bytes.get(2 * element..)?),
            kind => number(kind, bytes),
        }
    }

    /// The text of the field.
    pub fn text(&self, content: &[u8]) -> Option<String> {
        Some(text(content.get(self.offset..)?.get(..size(self.kind)?)?))
    }

    /// Default scale of the field's kind, used where the log states no multiplier.
    pub fn scale(&self) -> f64 {
        match self.kind {
            b'c' | b'C' | b'e' | b'E' => 1e-2,
            b'L' => 1e-7,
            _ => 1.0,
        }
    }
}

/// Bytes of a field.
fn size(kind: u8) -> Option<usize> {
    Some(match kind {
        b'b' | b'B' | b'M' => 1,
        b'h' | b'H' | b'c' | b'C' | b'g' => 2,
        b'i' | b'I' | b'e' | b'E' | b'L' | b'f' | b'n' => 4,
        b'q' | b'Q' | b'd' => 8,
        b'N' => 16,
        b'Z' => 64,
        b'a' => 2 * ARRAY,
        _ => return None,
    })
}

/// The first number in bytes, stored little-endian.
fn number(kind: u8, bytes: &[u8]) -> Option<f64> {
    Some(match kind {
        b'b' => f64::from(unsigned::<1>(bytes)? as i8),
        b'B' | b'M' => unsigned::<1>(bytes)? as f64,
        b'h' | b'c' => f64::from(unsigned::<2>(bytes)? as i16),
        b'H' | b'C' => unsigned::<2>(bytes)? as f64,
        b'i' | b'e' | b'L' => f64::from(unsigned::<4>(bytes)? as i32),
        b'I' | b'E' => unsigned::<4>(bytes)? as f64,
        b'q' => unsigned::<8>(bytes)? as i64 as f64,
        b'Q' => unsigned::<8>(bytes)? as f64,
        b'f' => f64::from(f32::from_bits(unsigned::<4>(bytes)? as u32)),
        b'd' => f64::from_bits(unsigned::<8>(bytes)?),
        b'g' => half(unsigned::<2>(bytes)? as u16),
        _ => return None,
    })
}

fn unsigned<const N: usize>(bytes: &[u8]) -> Option<u64> {
    Some(bytes.get(..N)?.iter().rev().fold(0, |n, b| n << 8 | u64::from(*b)))
}

/// A number of IEEE 754 in half precision.
fn half(bits: u16) -> f64 {
    let sign = if bits & 0x8000 == 0 { 1.0 } else { -1.0 };
    let (exponent, fraction) = (i32::from(bits >> 10 & 0x1f), f64::from(bits & 0x3ff) / 1024.0);
    sign * match exponent {
        0 => fraction * (-14f64).exp2(),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        _ => (1.0 + fraction) * f64::from(exponent - 15).exp2(),
    }
}

/// Text up to the first zero byte.
fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|b| *b == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).trim().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_every_kind_are_read() {
        for (kind, bytes, expected) in [
            (b'b', vec![0xff], -1.0),
            (b'B', vec![0xff], 255.0),
            (b'h', vec![0, 0x80], -32768.0),
            (b'C', vec![0xff, 0xff], 65535.0),
            (b'L', (-473_977_000i32).to_le_bytes().to_vec(), -473_977_000.0),
            (b'I', vec![0xff; 4], 4_294_967_295.0),
            (b'q', vec![0xff; 8], -1.0),
            (b'f', 1.5f32.to_le_bytes().to_vec(), 1.5),
            (b'd', 0.1f64.to_le_bytes().to_vec(), 0.1),
            (b'g', vec![0x00, 0xc0], -2.0),
            (b'g', vec![0x55, 0x35], 0.333_251_953_125),
            (b'g', vec![0x01, 0x00], 5.960_464_477_539_063e-8),
            (b'g', vec![0x00, 0x7c], f64::INFINITY),
        ] {
            assert_eq!(number(kind, &bytes), Some(expected), "{}", char::from(kind));
            assert_eq!(number(kind, &bytes[1..]), None);
        }
        assert!(half(0x7e00).is_nan());
    }
}
