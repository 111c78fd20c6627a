//! Encodings of numbers in a frame: bytes with a continuation bit, and groups after a byte of tags.
//!
//! After Betaflight's developer documentation, "Blackbox Internals".

/// Most numbers in one group.
pub(super) const LONGEST_GROUP: usize = 8;

/// Most bytes of a number with a continuation bit in each byte.
const LONGEST_NUMBER: u32 = 5;

/// Encoding of a field or of a group of fields.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    /// One signed number with continuation bits.
    Signed,
    /// One unsigned number with continuation bits.
    Unsigned,
    /// One number of 14 bits with its sign inverted.
    Negative14,
    /// Up to eight signed numbers, of which zeros are left out.
    Tagged8,
    /// Three numbers of 2 to 32 bits.
    Tagged3,
    /// Four numbers of 0 to 16 bits.
    Tagged4,
    /// No bytes: the number is 0.
    Nothing,
}

/// Error: the content is not one that a logger writes, or ends too early.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Broken;

impl Encoding {
    /// The encoding of a number in the header.
    pub fn parse(number: &str) -> Option<Self> {
        Some(match number {
            "0" => Self::Signed,
            "1" => Self::Unsigned,
            "3" => Self::Negative14,
            "6" => Self::Tagged8,
            "7" => Self::Tagged3,
            "8" => Self::Tagged4,
            "9" => Self::Nothing,
            _ => return None,
        })
    }

    /// Number of fields in a group that begins with `alike` consecutive fields of this encoding, of which `left`
    /// fields remain.
    pub fn group(self, alike: usize, left: usize) -> usize {
        match self {
            Self::Tagged8 => alike.min(LONGEST_GROUP),
            Self::Tagged3 => left.min(3),
            Self::Tagged4 => left.min(4),
            _ => 1,
        }
    }
}

/// Reads a frame byte by byte.
#[derive(Debug, Clone)]
pub(super) struct Bytes<'a> {
    data: &'a [u8],
    /// Position of the next byte.
    pub at: usize,
}

impl<'a> Bytes<'a> {
    pub fn new(data: &'a [u8], at: usize) -> Self {
        Self { data, at }
    }

    pub fn byte(&mut self) -> Result<u8, Broken> {
        let byte = *self.data.get(self.at).ok_or(Broken)?;
        self.at += 1;
        Ok(byte)
    }

    /// Skips a text, which must match.
    pub fn text(&mut self, text: &[u8]) -> Result<(), Broken> {
        let found = self.data.get(self.at..).is_some_and(|rest| rest.starts_with(text));
        self.at += text.len();
        if found { Ok(()) } else { Err(Broken) }
    }

    /// A number whose bytes hold seven bits each, the lowest first.
    pub fn unsigned(&mut self) -> Result<u32, Broken> {
        let mut number = 0;
        for n in 0..LONGEST_NUMBER {
            let byte = self.byte()?;
            number |= u32::from(byte & 0x7f) << (7 * n);
            if byte & 0x80 == 0 {
                return Ok(number);
            }
        }
        Err(Broken)
    }

    /// A number with its sign in the lowest bit.
    pub fn signed(&mut self) -> Result<i32, Broken> {
        let number = self.unsigned()?;
        Ok((number >> 1) as i32 ^ -((number & 1) as i32))
    }

    /// A group of `count` numbers, in the first elements of the result.
    pub fn group(&mut self, encoding: Encoding, count: usize) -> Result<[i32; LONGEST_GROUP], Broken> {
        let mut group = [0; LONGEST_GROUP];
        match encoding {
            Encoding::Signed => group[0] = self.signed()?,
            Encoding::Unsigned => group[0] = self.unsigned()? as i32,
            Encoding::Negative14 => group[0] = -extend(self.unsigned()?, 14),
            // A group of one number has no tags.
            Encoding::Tagged8 if count == 1 => group[0] = self.signed()?,
            Encoding::Tagged8 => {
                let tags = self.byte()?;
                for (n, number) in group.iter_mut().enumerate().take(count) {
                    if tags >> n & 1 == 1 {
                        *number = self.signed()?;
                    }
                }
            }
            Encoding::Tagged3 => self.three(&mut group)?,
            Encoding::Tagged4 => self.four(&mut group)?,
            Encoding::Nothing => {}
        }
        Ok(group)
    }

    /// Three numbers; the two highest bits of the first byte give their width.
    fn three(&mut self, group: &mut [i32]) -> Result<(), Broken> {
        let first = self.byte()?;
        let field = |byte: u8, shift: u8, bits: u32| extend(u32::from(byte >> shift), bits);
        match first >> 6 {
            0 => {
                for (n, shift) in [4, 2, 0].into_iter().enumerate() {
                    group[n] = field(first, shift, 2);
                }
            }
            1 => {
                let second = self.byte()?;
                (group[0], group[1], group[2]) =
                    (field(first, 0, 4), field(second, 4, 4), field(second, 0, 4));
            }
            2 => {
                group[0] = field(first, 0, 6);
                for number in &mut group[1..3] {
                    *number = field(self.byte()?, 0, 6);
                }
            }
            _ => {
                for (n, number) in group.iter_mut().enumerate().take(3) {
                    let bytes = u32::from(first >> (2 * n) & 3) + 1;
                    let mut bits = 0;
                    for byte in 0..bytes {
                        bits |= u32::from(self.byte()?) << (8 * byte);
                    }
                    *number = extend(bits, 8 * bytes);
                }
            }
        }
        Ok(())
    }

    /// Four numbers of 0, 4, 8 or 16 bits, packed in half bytes, the higher half first.
    fn four(&mut self, group: &mut [i32]) -> Result<(), Broken> {
        let tags = self.byte()?;
        let mut left_over: Option<u8> = None;
        for (n, number) in group.iter_mut().enumerate().take(4) {
            let halves = [0, 1, 2, 4][usize::from(tags >> (2 * n) & 3)];
            let mut bits = 0;
            for _ in 0..halves {
                let half = match left_over.take() {
                    Some(lower) => lower,
                    None => {
                        let byte = self.byte()?;
                        left_over = Some(byte & 0x0f);
                        byte >> 4
                    }
                };
                bits = bits << 4 | u32::from(half);
            }
            *number = if halves == 0 { 0 } else { extend(bits, 4 * halves) };
        }
        Ok(())
    }
}

/// The signed number in the lowest bits.
fn extend(bits: u32, width: u32) -> i32 {
    let unused = 32 - width;
    (bits << unused) as i32 >> unused
}

#[cfg(test)]
mod tests {
    use super::*;

    fn group(encoding: Encoding, count: usize, bytes: &[u8]) -> Vec<i32> {
        let mut reader = Bytes::new(bytes, 0);
        let group = reader.group(encoding, count).unwrap();
        assert_eq!(reader.at, bytes.len(), "{encoding:?}");
        for cut in 0..bytes.len() {
            assert_eq!(Bytes::new(&bytes[..cut], 0).group(encoding, count), Err(Broken), "{encoding:?}");
        }
        group[..count].to_vec()
    }

    #[test]
    fn numbers_of_every_encoding_are_read() {
        assert_eq!(group(Encoding::Unsigned, 1, &[0xac, 0x02]), [300]);
        assert_eq!(group(Encoding::Signed, 1, &[0x03]), [-2]);
        assert_eq!(group(Encoding::Negative14, 1, &[0x05]), [-5]);
        assert_eq!(group(Encoding::Nothing, 1, &[]), [0]);
        assert_eq!(group(Encoding::Tagged8, 1, &[0x04]), [2]);
        assert_eq!(group(Encoding::Tagged8, 3, &[0b101, 0x02, 0x01]), [1, 0, -1]);
        assert_eq!(group(Encoding::Tagged3, 3, &[0b00_01_10_11]), [1, -2, -1]);
        assert_eq!(group(Encoding::Tagged3, 3, &[0b0100_0111, 0x8f]), [7, -8, -1]);
        assert_eq!(group(Encoding::Tagged3, 3, &[0b1001_1111, 0x20, 0x01]), [31, -32, 1]);
        let wide = [0b1110_0100, 0x80, 0x00, 0x80, 0xff, 0xff, 0x7f];
        assert_eq!(group(Encoding::Tagged3, 3, &wide), [-128, -32768, 0x7f_ffff]);
        let packed = [0b1110_0100, 0x8f, 0xf1, 0x23, 0x40];
        assert_eq!(
            group(Encoding::Tagged4, 4, &packed[..1].iter().chain(&packed[1..]).copied().collect::<Vec<_>>()),
            [0, -8, -1, 0x1234]
        );
    }

    #[test]
    fn a_number_without_end_is_broken() {
        assert_eq!(Bytes::new(&[0x80; 9], 0).unsigned(), Err(Broken));
    }
}
