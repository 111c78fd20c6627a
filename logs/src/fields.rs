//! The bytes of a message as named values, for known message types.

use whirlstand_msgs::{
    Command, Disturbance, Estimate, Field, Health, Imu, Message, Odometry, Outputs, Progress, Setpoint, Truth,
};

use crate::stream::RawMessage;
use crate::writer::CDR_HEADER;

/// Type name and fields of every message.
const TYPES: [(&str, &[Field]); 10] = [
    (Imu::TYPE_NAME, Imu::FIELDS),
    (Odometry::TYPE_NAME, Odometry::FIELDS),
    (Outputs::TYPE_NAME, Outputs::FIELDS),
    (Estimate::TYPE_NAME, Estimate::FIELDS),
    (Command::TYPE_NAME, Command::FIELDS),
    (Setpoint::TYPE_NAME, Setpoint::FIELDS),
    (Truth::TYPE_NAME, Truth::FIELDS),
    (Disturbance::TYPE_NAME, Disturbance::FIELDS),
    (Health::TYPE_NAME, Health::FIELDS),
    (Progress::TYPE_NAME, Progress::FIELDS),
];

/// The fields of [`whirlstand_msgs::Head`], with which every message begins.
const HEAD: [&str; 3] = ["head.seq", "head.step", "head.stamp_ns"];

/// The step of a message, read from its head.
pub(crate) fn step(type_name: &str, body: &[u8]) -> Option<u64> {
    TYPES.iter().any(|(name, _)| *name == type_name).then(|| integer(body.get(8..16)?))?
}

/// The full sequence number of a message; for a message of unknown type, the 32 bits that MCAP keeps.
pub(crate) fn sequence(message: &RawMessage<'_>) -> u64 {
    let known = TYPES.iter().any(|(name, _)| *name == message.topic.schema_name);
    let body = message.data.strip_prefix(&CDR_HEADER).filter(|_| known);
    body.and_then(|b| integer(b.get(..8)?)).unwrap_or(message.sequence.into())
}

fn integer(bytes: &[u8]) -> Option<u64> {
    Some(u64::from_ne_bytes(bytes.try_into().ok()?))
}

/// The first value in which two messages of one type differ: name, value in `a`, value in `b`.
pub(crate) fn first_difference(type_name: &str, a: &[u8], b: &[u8]) -> (String, String, String) {
    let Some(at) = a.iter().zip(b).position(|(x, y)| x != y) else {
        return ("length".into(), format!("{} bytes", a.len()), format!("{} bytes", b.len()));
    };
    let by_byte = || (format!("byte {at}"), format!("{:#04x}", a[at]), format!("{:#04x}", b[at]));
    let Some((_, fields)) = TYPES.iter().find(|(name, _)| *name == type_name) else { return by_byte() };
    if at < 8 * HEAD.len() {
        let (name, range) = (HEAD[at / 8], at / 8 * 8..at / 8 * 8 + 8);
        let text = |body: &[u8]| body.get(range.clone()).and_then(integer).map(|n| n.to_string());
        return text(a).zip(text(b)).map_or_else(by_byte, |(x, y)| (name.into(), x, y));
    }
    let Some(field) = fields.iter().rev().find(|f| f.offset <= at) else { return by_byte() };
    let width = match field.kind {
        "f64" | "u64" => 8,
        "u32" => 4,
        _ => 1,
    };
    let index = (at - field.offset) / width;
    let start = field.offset + index * width;
    let (Some(x), Some(y)) = (a.get(start..start + width), b.get(start..start + width)) else {
        return by_byte();
    };
    let name = if field.count == 1 { field.name.to_string() } else { format!("{}[{index}]", field.name) };
    let (mut left, mut right) = (text(field.kind, x), text(field.kind, y));
    if left == right {
        // Two NaN can differ in bits that no decimal number shows.
        let bits = |bytes: &[u8]| bytes.iter().rev().map(|b| format!("{b:02x}")).collect::<String>();
        (left, right) = (format!("{left} (0x{})", bits(x)), format!("{right} (0x{})", bits(y)));
    }
    (name, left, right)
}

fn text(kind: &str, bytes: &[u8]) -> String {
    match (kind, bytes.len()) {
        ("f64", 8) => bytemuck::pod_read_unaligned::<f64>(bytes).to_string(),
        ("u64", 8) => bytemuck::pod_read_unaligned::<u64>(bytes).to_string(),
        ("u32", 4) => bytemuck::pod_read_unaligned::<u32>(bytes).to_string(),
        _ => bytes.iter().map(|b| b.to_string()).collect::<Vec<_>>().join(" "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::bytes_of;

    #[test]
    fn the_first_value_that_differs_is_named() {
        let a = Estimate::zeroed();
        let mut b = a;
        b.std[3] = -0.0;
        b.nis = 1.5;
        let named =
            |a: &Estimate, b: &Estimate| first_difference(Estimate::TYPE_NAME, bytes_of(a), bytes_of(b));
        assert_eq!(named(&a, &b), ("std[3]".into(), "0".into(), "-0".into()));
        b.std[3] = 0.0;
        assert_eq!(named(&a, &b), ("nis".into(), "0".into(), "1.5".into()));
        b.head.step = 7;
        assert_eq!(named(&a, &b), ("head.step".into(), "0".into(), "7".into()));
        let (mut a, mut b) = (Estimate::zeroed(), Estimate::zeroed());
        (a.x[0], b.x[0]) = (f64::NAN, f64::from_bits(f64::NAN.to_bits() + 1));
        assert_eq!(named(&a, &b).1, "NaN (0x7ff8000000000000)");
        assert_eq!(first_difference("other/Type", &[1, 2], &[1, 3]).0, "byte 1");
        assert_eq!(first_difference("other/Type", &[1, 2], &[1]).0, "length");
        assert_eq!(step(Estimate::TYPE_NAME, bytes_of(&Estimate::zeroed())), Some(0));
        assert_eq!(step("other/Type", &[0; 80]), None);
    }
}
