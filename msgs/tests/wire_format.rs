//! The wire format is what `docs/` says it is: the layout tables of `docs/wire-format.md`, the vectors of
//! `docs/wire-vectors.json` and the layouts of the Python example are compared with the types.
//!
//! After a wanted change raise `whirlstand_msgs::VERSION` and run this test with `WHIRLSTAND_BLESS=1` to write them anew.

use std::fmt::Write as _;
use std::path::PathBuf;

use serde_json::{Value, json};
use whirlstand_msgs::{
    Adjustment, Command, Disturbance, Estimate, Field, Health, Imu, Message, Odometry, Outputs, Progress,
    Setpoint, Truth, VERSION, decode, encode,
};

/// Calls a generic function for each message type.
macro_rules! for_each_message {
    ($function:ident) => {
        [
            $function::<Imu>(),
            $function::<Odometry>(),
            $function::<Outputs>(),
            $function::<Estimate>(),
            $function::<Command>(),
            $function::<Setpoint>(),
            $function::<Truth>(),
            $function::<Disturbance>(),
            $function::<Health>(),
            $function::<Progress>(),
            $function::<Adjustment>(),
        ]
    };
}

/// The vectors' content: element i of the message (the head aside) is (-1)^i (i + 1) / 4 as f64, 300 (i + 1) as u64,
/// 7 (i + 1) as u32, and the letter i of the alphabet as u8; the head is sequence number 1, step 300, 1.5 s.
fn sample<M: Message>() -> M {
    let mut image = Vec::new();
    for head in [1u64, 300, 1_500_000_000] {
        image.extend_from_slice(&head.to_le_bytes());
    }
    let elements = M::FIELDS[1..].iter().flat_map(|f| std::iter::repeat_n(f.kind, f.count));
    for (i, kind) in elements.enumerate() {
        let n = i as u64 + 1;
        match kind {
            "f64" => {
                let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
                image.extend_from_slice(&(sign * n as f64 / 4.0).to_le_bytes());
            }
            "u64" => image.extend_from_slice(&(300 * n).to_le_bytes()),
            "u32" => image.extend_from_slice(&(7 * n as u32).to_le_bytes()),
            _ => image.push(b'a' + (i % 26) as u8),
        }
    }
    assert_eq!(image.len(), size_of::<M>());
    bytemuck::pod_read_unaligned(&image)
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, b| {
        let _ = write!(text, "{b:02x}");
        text
    })
}

fn vector<M: Message>() -> Value {
    let message = sample::<M>();
    let mut wire = Vec::new();
    encode(&message, &mut wire);
    assert_eq!(decode::<M>(&wire).unwrap(), message);
    json!({
        "type": M::TYPE_NAME,
        "topic": M::TOPIC,
        "schema_hash": format!("{:#018x}", M::SCHEMA_HASH),
        "message": serde_json::to_value(message).unwrap(),
        "memory": hex(bytemuck::bytes_of(&message)),
        "network": hex(&wire),
    })
}

fn table<M: Message>() -> String {
    let mut text = format!(
        "### `{}` on topic `{}`\n\n{} bytes, schema hash `{:#018x}`.\n\n| offset | field | type |\n|---:|---|---|\n",
        M::TYPE_NAME,
        M::TOPIC,
        size_of::<M>(),
        M::SCHEMA_HASH
    );
    for f in M::FIELDS {
        let kind = if f.count == 1 { f.kind.to_string() } else { format!("[{}; {}]", f.kind, f.count) };
        let _ = writeln!(text, "| {} | `{}` | `{kind}` |", f.offset, f.name);
    }
    text
}

fn python<M: Message>() -> String {
    let name = M::TYPE_NAME.rsplit('/').next().unwrap_or_default();
    let mut text = format!(
        "\n\nclass {name}(Message):\n    TOPIC = \"{}\"\n    TYPE_NAME = \"{}\"\n    SCHEMA_HASH = {:#018x}\n    _fields_ = [\n",
        M::TOPIC,
        M::TYPE_NAME,
        M::SCHEMA_HASH
    );
    for Field { name, kind, count, .. } in M::FIELDS {
        let kind = match *kind {
            "f64" => "c_double",
            "u64" => "c_uint64",
            "u32" => "c_uint32",
            "u8" => "c_uint8",
            other => other,
        };
        let times = if *count == 1 { String::new() } else { format!(" * {count}") };
        let _ = writeln!(text, "        (\"{name}\", {kind}{times}),");
    }
    text + "    ]\n"
}

/// Compares the part of a file between two marks with what it should be, or writes it.
fn check(file: &str, marks: Option<(&str, &str)>, wanted: &str) {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("..").join(file);
    let bless = std::env::var_os("WHIRLSTAND_BLESS").is_some();
    let content = std::fs::read_to_string(&path).unwrap_or_default();
    let (start, end) = match marks {
        Some((begin, end)) => (
            content.find(begin).unwrap_or_else(|| panic!("{file} has no mark {begin}")) + begin.len(),
            content.find(end).unwrap_or_else(|| panic!("{file} has no mark {end}")),
        ),
        None => (0, content.len()),
    };
    if bless {
        let whole = [&content[..start], wanted, &content[end..]].concat();
        std::fs::write(&path, whole).unwrap();
    } else {
        assert!(
            content[start..end] == *wanted,
            "{file} is not what the message types say. If the change is wanted, raise VERSION in msgs/src/lib.rs \
             and run this test with WHIRLSTAND_BLESS=1. It should be:\n{wanted}"
        );
    }
}

#[test]
fn the_layout_tables_are_those_of_the_types() {
    let tables = for_each_message!(table).join("\n");
    check("docs/wire-format.md", Some(("<!-- layouts: begin -->\n", "<!-- layouts: end -->")), &tables);
}

#[test]
fn the_golden_vectors_hold() {
    let vectors = json!({ "version": VERSION, "messages": for_each_message!(vector) });
    let text = serde_json::to_string_pretty(&vectors).unwrap() + "\n";
    check("docs/wire-vectors.json", None, &text);
}

#[test]
fn the_python_layouts_are_those_of_the_types() {
    let classes = for_each_message!(python).concat();
    let marks = ("# layouts: begin\n", "# layouts: end");
    check("examples/python/whirlstand_messages.py", Some(marks), &(classes + "\n\n"));
}

/// The vectors pin the types; this pins the vectors to what this document's rules say, worked out by hand.
#[test]
fn one_vector_worked_out_by_hand() {
    let progress: Progress = sample();
    let mut wire = Vec::new();
    encode(&progress, &mut wire);
    let mut by_hand = Progress::SCHEMA_HASH.to_le_bytes().to_vec();
    // seq 1, step 300, stamp 1 500 000 000, written 300, lost 600, as LEB128.
    by_hand.extend([0x01, 0xac, 0x02, 0x80, 0xde, 0xa0, 0xcb, 0x05, 0xac, 0x02, 0xd8, 0x04]);
    assert_eq!(hex(&wire), hex(&by_hand));
}
