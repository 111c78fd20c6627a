//! Network encoding of messages: schema hash, then postcard.

use crate::Message;

/// Length of the schema hash in front of every encoded message, bytes.
pub const SCHEMA_HASH_BYTES: usize = 8;

/// Reason why bytes are not the expected message.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// The peer speaks another version of the message.
    #[error(
        "{type_name} has schema {found:#018x} at the peer and {expected:#018x} here: both sides must run the same message version"
    )]
    Schema {
        /// Message type.
        type_name: &'static str,
        /// Hash in this program.
        expected: u64,
        /// Hash in the received bytes.
        found: u64,
    },
    /// The bytes are too short or do not encode the fields.
    #[error("{type_name} cannot be read from {length} bytes: {reason}")]
    Malformed {
        /// Message type.
        type_name: &'static str,
        /// Length of the bytes.
        length: usize,
        /// Error of postcard.
        reason: String,
    },
}

/// Replaces the content of `out` by the bytes of `message`; allocates only while `out` grows.
pub fn encode<M: Message>(message: &M, out: &mut Vec<u8>) {
    out.clear();
    out.extend_from_slice(&M::SCHEMA_HASH.to_le_bytes());
    let serialised = postcard::to_extend(message, std::mem::take(out));
    // Serialising fixed-size plain data into a growing vector cannot fail.
    *out = serialised.unwrap_or_else(|e| unreachable!("postcard into a vector: {e}"));
}

/// Decodes bytes of [`encode`].
///
/// # Errors
/// [`DecodeError::Schema`] when the hash differs, [`DecodeError::Malformed`] when the bytes do not fit.
pub fn decode<M: Message>(bytes: &[u8]) -> Result<M, DecodeError> {
    let malformed =
        |reason: String| DecodeError::Malformed { type_name: M::TYPE_NAME, length: bytes.len(), reason };
    let (hash, body) = bytes
        .split_first_chunk::<SCHEMA_HASH_BYTES>()
        .ok_or_else(|| malformed("too short for a schema hash".into()))?;
    let found = u64::from_le_bytes(*hash);
    if found != M::SCHEMA_HASH {
        return Err(DecodeError::Schema { type_name: M::TYPE_NAME, expected: M::SCHEMA_HASH, found });
    }
    let (message, rest) = postcard::take_from_bytes(body).map_err(|e| malformed(e.to_string()))?;
    if rest.is_empty() { Ok(message) } else { Err(malformed(format!("{} bytes too many", rest.len()))) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Adjustment, Autopilot, Command, Disturbance, Estimate, Health, Imu, Odometry, Outputs, Progress,
        Reported, Sent, Setpoint, Stick, Truth,
    };
    use proptest::prelude::*;

    fn contiguous<M: Message>() {
        let size = |kind: &str| match kind {
            "Head" => 24,
            "f64" | "u64" => 8,
            "u32" => 4,
            "u8" => 1,
            other => panic!("{other}"),
        };
        let end = M::FIELDS.iter().fold(0, |at, f| {
            assert_eq!(f.offset, at, "{}.{}", M::TYPE_NAME, f.name);
            let start = if f.kind == "Head" { 0 } else { f.offset };
            assert_eq!(start % size(f.kind).min(8), 0, "{}.{} is aligned", M::TYPE_NAME, f.name);
            at + size(f.kind) * f.count
        });
        assert_eq!(end, size_of::<M>());
        assert_eq!(size_of::<M>() % 8, 0);
        let text = M::SCHEMA.lines().take_while(|l| !l.starts_with("===")).collect::<Vec<_>>();
        for (line, f) in text.iter().zip(M::FIELDS) {
            let ros = match f.kind {
                "Head" => "Head",
                "f64" => "float64",
                "u64" => "uint64",
                "u32" => "uint32",
                _ => "uint8",
            };
            let ros = if f.count == 1 { ros.to_string() } else { format!("{ros}[{}]", f.count) };
            assert_eq!(*line, format!("{ros} {}", f.name), "{}", M::TYPE_NAME);
        }
        assert_eq!(text.len(), M::FIELDS.len());
    }

    #[test]
    fn layouts_have_no_gap_and_schemas_say_what_memory_holds() {
        contiguous::<Imu>();
        contiguous::<Odometry>();
        contiguous::<Outputs>();
        contiguous::<Estimate>();
        contiguous::<Command>();
        contiguous::<Setpoint>();
        contiguous::<Truth>();
        contiguous::<Disturbance>();
        contiguous::<Sent>();
        contiguous::<Reported>();
        contiguous::<Autopilot>();
        contiguous::<Health>();
        contiguous::<Progress>();
        contiguous::<Adjustment>();
        contiguous::<Stick>();
    }

    #[test]
    fn another_version_is_refused_by_name() {
        let mut bytes = Vec::new();
        encode(&Imu::zeroed(), &mut bytes);
        let error = decode::<Odometry>(&bytes).unwrap_err();
        assert!(matches!(error, DecodeError::Schema { found, .. } if found == Imu::SCHEMA_HASH), "{error}");
    }

    proptest! {
        #[test]
        fn any_memory_image_survives_the_wire(bytes in prop::collection::vec(any::<u8>(), size_of::<Health>())) {
            let health: Health = bytemuck::pod_read_unaligned(&bytes);
            let mut wire = Vec::new();
            encode(&health, &mut wire);
            let back = decode::<Health>(&wire).unwrap();
            prop_assert_eq!(bytemuck::bytes_of(&back), &bytes[..]);
        }

        #[test]
        fn damaged_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400), keep_hash in any::<bool>()) {
            let mut bytes = bytes;
            if keep_hash && bytes.len() >= 8 {
                bytes[..8].copy_from_slice(&Command::SCHEMA_HASH.to_le_bytes());
            }
            let _ = decode::<Command>(&bytes);
        }
    }
}
