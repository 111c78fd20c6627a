//! Bytes of ROS messages: CDR (OMG DDS-XTypes 1.3, section 7.4, plain encodings) and the ROS 1 serialisation.

use super::ros::{Count, Definition, Field, Kind};
use super::visit::{MOST_ELEMENTS, MOST_NESTING, PathStack, Visit};

/// Binary layout of values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Wire {
    /// ROS 2: aligned, after a header that states the byte order.
    Cdr,
    /// ROS 1: little-endian, packed.
    Ros1,
}

/// Position of a reader in a message.
struct Cursor<'a> {
    data: &'a [u8],
    at: usize,
    big_endian: bool,
    /// Greatest alignment: 1 when packed, 4 in CDR version 2, 8 in version 1.
    alignment: usize,
    /// Whether strings count their final zero, and a message without fields has one byte.
    cdr: bool,
}

impl Wire {
    /// Visits every number of a message.
    pub fn visit(self, definition: &Definition, data: &[u8], visit: &mut Visit<'_>) -> Result<(), String> {
        let mut cursor = match self {
            Self::Ros1 => Cursor { data, at: 0, big_endian: false, alignment: 1, cdr: false },
            Self::Cdr => {
                let (head, body) = data.split_at_checked(4).ok_or("a message without CDR header")?;
                let (big_endian, alignment) = match (head[0], head[1]) {
                    (0, 0) => (true, 8),
                    (0, 1) => (false, 8),
                    (0, 6) => (true, 4),
                    (0, 7) => (false, 4),
                    (a, b) => return Err(format!("CDR representation {a:#04x}{b:02x} is not supported")),
                };
                Cursor { data: body, at: 0, big_endian, alignment, cdr: true }
            }
        };
        cursor.message(definition, 0, &mut PathStack::new(), visit, 0)
    }
}

impl<'a> Cursor<'a> {
    fn message(
        &mut self,
        definition: &Definition,
        index: usize,
        path: &mut PathStack,
        visit: &mut Visit<'_>,
        depth: usize,
    ) -> Result<(), String> {
        if depth > MOST_NESTING {
            return Err("its types are nested without limit".into());
        }
        let fields = &definition.types[index];
        if fields.is_empty() && self.cdr {
            self.take(1, 1)?;
        }
        for field in fields {
            path.field(&field.name, |path| self.field(definition, field, path, visit, depth))?;
        }
        Ok(())
    }

    fn field(
        &mut self,
        definition: &Definition,
        field: &Field,
        path: &mut PathStack,
        visit: &mut Visit<'_>,
        depth: usize,
    ) -> Result<(), String> {
        let count = match field.count {
            Count::One => return self.value(definition, field.kind, path, visit, depth),
            Count::Fixed(n) => n,
            Count::Sequence => self.u32()? as usize,
        };
        if let (Some(width), true) = (width(field.kind), count > MOST_ELEMENTS) {
            let bytes = count.checked_mul(width).ok_or("an unterminated array")?;
            return self.take(bytes, width).map(|_| ());
        }
        for i in 0..count {
            let before = self.at;
            let mut silent = |_: &str, _: f64| {};
            let visit: &mut Visit<'_> = if i < MOST_ELEMENTS { visit } else { &mut silent };
            path.element(i, |path| self.value(definition, field.kind, path, visit, depth))?;
            if self.at == before {
                // Elements without content are not visited: damaged bytes could count four billion of them.
                break;
            }
        }
        Ok(())
    }

    fn value(
        &mut self,
        definition: &Definition,
        kind: Kind,
        path: &mut PathStack,
        visit: &mut Visit<'_>,
        depth: usize,
    ) -> Result<(), String> {
        let number = match kind {
            Kind::Bool | Kind::U8 => f64::from(self.array::<1>()?[0]),
            Kind::I8 => f64::from(i8::from_le_bytes(self.array()?)),
            Kind::I16 => f64::from(i16::from_le_bytes(self.array()?)),
            Kind::U16 => f64::from(u16::from_le_bytes(self.array()?)),
            Kind::I32 => f64::from(i32::from_le_bytes(self.array()?)),
            Kind::U32 => f64::from(self.u32()?),
            Kind::I64 => i64::from_le_bytes(self.array()?) as f64,
            Kind::U64 => u64::from_le_bytes(self.array()?) as f64,
            Kind::F32 => f64::from(f32::from_le_bytes(self.array()?)),
            Kind::F64 => f64::from_le_bytes(self.array()?),
            Kind::String => {
                let length = self.u32()? as usize;
                return self.take(length, 1).map(|_| ());
            }
            Kind::Time | Kind::Duration => {
                let signed = kind == Kind::Duration;
                for name in ["secs", "nsecs"] {
                    let raw = self.u32()?;
                    let number = if signed { f64::from(raw as i32) } else { f64::from(raw) };
                    path.field(name, |path| visit(&path.text, number));
                }
                return Ok(());
            }
            Kind::Message(index) => return self.message(definition, index, path, visit, depth + 1),
        };
        visit(&path.text, number);
        Ok(())
    }

    fn u32(&mut self) -> Result<u32, String> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    /// The next `N` bytes as a little-endian number.
    fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let mut bytes = [0; N];
        bytes.copy_from_slice(self.take(N, N)?);
        if self.big_endian {
            bytes.reverse();
        }
        Ok(bytes)
    }

    fn take(&mut self, count: usize, alignment: usize) -> Result<&'a [u8], String> {
        let start = self.at.next_multiple_of(alignment.min(self.alignment).max(1));
        let end = start.checked_add(count).ok_or("an unterminated message")?;
        let bytes = self.data.get(start..end).ok_or("a truncated message")?;
        self.at = end;
        Ok(bytes)
    }
}

/// Width of a kind whose elements all have the same width.
fn width(kind: Kind) -> Option<usize> {
    match kind {
        Kind::Bool | Kind::I8 | Kind::U8 => Some(1),
        Kind::I16 | Kind::U16 => Some(2),
        Kind::I32 | Kind::U32 | Kind::F32 => Some(4),
        Kind::I64 | Kind::U64 | Kind::F64 => Some(8),
        Kind::String | Kind::Time | Kind::Duration | Kind::Message(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn numbers(text: &str, wire: Wire, data: &[u8]) -> Result<Vec<(String, f64)>, String> {
        let definition = Definition::parse("p/T", text).unwrap();
        let mut found = Vec::new();
        wire.visit(&definition, data, &mut |path, value| found.push((path.to_string(), value)))?;
        Ok(found)
    }

    const TEXT: &str =
        "uint8 a\nfloat64 b\nstring s\nuint16[] c\nIn d\n===\nMSG: p/In\nfloat32[2] x\nbool ok";

    fn values() -> Vec<(String, f64)> {
        [
            ("a", 7.0),
            ("b", 1.5),
            ("c[0]", 3.0),
            ("c[1]", 4.0),
            ("d.x[0]", 0.5),
            ("d.x[1]", -0.5),
            ("d.ok", 1.0),
        ]
        .map(|(n, v)| (n.to_string(), v))
        .to_vec()
    }

    #[test]
    fn cdr_is_read_with_its_padding_in_both_byte_orders() {
        let mut le = vec![0, 1, 0, 0, 7, 0, 0, 0, 0, 0, 0, 0];
        le.extend(1.5f64.to_le_bytes());
        le.extend([3, 0, 0, 0, b'h', b'i', 0, 0, 2, 0, 0, 0, 3, 0, 4, 0]);
        le.extend(0.5f32.to_le_bytes());
        le.extend((-0.5f32).to_le_bytes());
        le.push(1);
        assert_eq!(numbers(TEXT, Wire::Cdr, &le).unwrap(), values());
        let mut be = vec![0, 0, 0, 0, 7, 0, 0, 0, 0, 0, 0, 0];
        be.extend(1.5f64.to_be_bytes());
        be.extend([0, 0, 0, 3, b'h', b'i', 0, 0, 0, 0, 0, 2, 0, 3, 0, 4]);
        be.extend(0.5f32.to_be_bytes());
        be.extend((-0.5f32).to_be_bytes());
        be.push(1);
        assert_eq!(numbers(TEXT, Wire::Cdr, &be).unwrap(), values());
        assert!(numbers(TEXT, Wire::Cdr, &le[..le.len() - 1]).unwrap_err().contains("truncated"));
        assert!(numbers(TEXT, Wire::Cdr, &[0, 2, 0, 0]).unwrap_err().contains("0x0002"));
    }

    #[test]
    fn ros1_is_packed() {
        let mut data = vec![7];
        data.extend(1.5f64.to_le_bytes());
        data.extend([2, 0, 0, 0, b'h', b'i', 2, 0, 0, 0, 3, 0, 4, 0]);
        data.extend(0.5f32.to_le_bytes());
        data.extend((-0.5f32).to_le_bytes());
        data.push(1);
        assert_eq!(numbers(TEXT, Wire::Ros1, &data).unwrap(), values());
        let stamp = numbers("time t", Wire::Ros1, &[1, 0, 0, 0, 2, 0, 0, 0]).unwrap();
        assert_eq!(stamp, [("t.secs".to_string(), 1.0), ("t.nsecs".to_string(), 2.0)]);
    }

    #[test]
    fn endless_types_and_counts_end() {
        let definition = Definition::parse("p/T", "T t").unwrap();
        assert!(Wire::Ros1.visit(&definition, &[0; 64], &mut |_, _| {}).is_err());
        assert_eq!(numbers("In[] d\n===\nMSG: p/In\n", Wire::Ros1, &[255; 8]), Ok(Vec::new()));
        assert!(
            numbers(
                "uint8[] image\nuint8 after",
                Wire::Ros1,
                &[&[0, 4, 0, 0][..], &[9; 1024], &[5]].concat()
            )
            .is_ok_and(|v| v == [("after".to_string(), 5.0)])
        );
    }

    proptest! {
        #[test]
        fn any_bytes_are_a_message_or_an_error(data in prop::collection::vec(any::<u8>(), 0..200), ros1 in any::<bool>()) {
            let _ = numbers(TEXT, if ros1 { Wire::Ros1 } else { Wire::Cdr }, &data);
        }

        #[test]
        fn any_text_is_a_definition_or_an_error(text in "[a-z0-9\\[\\]<=# \\nMSG:/]{0,80}") {
            let _ = Definition::parse("p/T", &text);
        }
    }
}
