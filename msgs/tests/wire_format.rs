//! The wire format is what `docs/` says it is: the layout tables of `docs/wire-format.md`, the vectors of
//! `docs/wire-vectors.json` and the layouts of the Python and C examples are compared with the types.
//!
//! After a wanted change raise `whirlstand_msgs::VERSION` and run this test with `WHIRLSTAND_BLESS=1` to write them anew.

use std::fmt::Write as _;
use std::path::PathBuf;

use serde_json::{Value, json};
use whirlstand_msgs::{
    Adjustment, Autopilot, Command, Disturbance, Estimate, Field, Finding, Health, Imu, Message, Odometry,
    Outputs, Progress, Reported, Sent, Setpoint, Stick, Truth, VERSION, decode, encode,
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
            $function::<Sent>(),
            $function::<Reported>(),
            $function::<Autopilot>(),
            $function::<Health>(),
            $function::<Progress>(),
            $function::<Adjustment>(),
            $function::<Stick>(),
            $function::<Finding>(),
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

/// Runs of fields of one type, as the header has them: letter and number of elements.
fn runs<M: Message>() -> Vec<(char, usize)> {
    let mut runs: Vec<(char, usize)> = Vec::new();
    for f in M::FIELDS {
        let (letter, count) = match f.kind {
            "Head" => ('q', 3),
            "f64" => ('d', f.count),
            "u64" => ('q', f.count),
            "u32" => ('i', f.count),
            _ => ('b', f.count),
        };
        match runs.last_mut() {
            Some((last, n)) if *last == letter => *n += count,
            _ => runs.push((letter, count)),
        }
    }
    runs
}

fn c_header<M: Message>() -> String {
    let name = M::TYPE_NAME.rsplit('/').next().unwrap_or_default();
    let name = format!("whirlstand_{}", name.to_lowercase());
    let mut text = format!("\n/* topic {}, {} bytes */\ntypedef struct {{\n", M::TOPIC, size_of::<M>());
    for Field { name, kind, count, .. } in M::FIELDS {
        let kind = match *kind {
            "f64" => "double",
            "u64" => "uint64_t",
            "u32" => "uint32_t",
            "u8" => "uint8_t",
            _ => "whirlstand_head",
        };
        let times = if *count == 1 { String::new() } else { format!("[{count}]") };
        let _ = writeln!(text, "    {kind} {name}{times};");
    }
    let runs = runs::<M>();
    assert!(runs.len() < 16, "{name}: make whirlstand_layout.fields longer");
    let runs: Vec<String> = runs.iter().map(|(letter, count)| format!("{{'{letter}', {count}}}")).collect();
    let _ = writeln!(
        text,
        "}} {name};\nstatic const whirlstand_layout {name}_layout = {{{:#018x}u, sizeof({name}), {{{}}}}};",
        M::SCHEMA_HASH,
        runs.join(", ")
    );
    text
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

#[test]
fn the_c_header_is_that_of_the_types() {
    let layouts = for_each_message!(c_header).concat();
    let marks = ("/* layouts: begin */\n", "/* layouts: end */");
    check("examples/c/whirlstand.h", Some(marks), &(layouts + "\n"));
}

/// A program that writes down each golden vector that it read and wrote as C has it.
fn c_vectors<M: Message>() -> String {
    let name = M::TYPE_NAME.rsplit('/').next().unwrap_or_default();
    let name = format!("whirlstand_{}", name.to_lowercase());
    let mut wire = Vec::new();
    encode(&sample::<M>(), &mut wire);
    let list = |bytes: &[u8]| bytes.iter().map(|b| b.to_string()).collect::<Vec<_>>().join(",");
    format!(
        "{{ static const uint8_t wire[] = {{{}}}, memory[] = {{{}}};\n\
         {name} message; uint8_t again[WHIRLSTAND_MAX_BYTES];\n\
         if (sizeof message != sizeof memory) return 1;\n\
         if (!whirlstand_decode(&{name}_layout, &message, wire, sizeof wire)) return 2;\n\
         if (memcmp(&message, memory, sizeof memory)) return 3;\n\
         if (whirlstand_encode(&{name}_layout, &message, again, sizeof again) != sizeof wire) return 4;\n\
         if (memcmp(again, wire, sizeof wire)) return 5;\n\
         for (size_t n = 0; n < sizeof wire; n++)\n\
         if (whirlstand_decode(&{name}_layout, &message, wire, n)) return 6;\n\
         memcpy(again, wire, sizeof wire);\n\
         if (whirlstand_decode(&{name}_layout, &message, again, sizeof wire + 1)) return 7;\n\
         again[0] ^= 1;\n\
         if (whirlstand_decode(&{name}_layout, &message, again, sizeof wire)) return 8; }}\n",
        list(&wire),
        list(bytemuck::bytes_of(&sample::<M>()))
    )
}

/// Every C compiler that is here reads and writes the golden vectors with the header, without a warning.
#[test]
fn the_c_header_reads_and_writes_the_vectors() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let text = format!(
        "#include \"whirlstand.h\"\nint main(void) {{\n{}return 0;\n}}\n",
        for_each_message!(c_vectors).concat()
    );
    std::fs::write(path("vectors.c"), text).unwrap();
    let include = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../examples/c");
    let strict = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O1"];
    let built = std::process::Command::new("cc")
        .args(strict)
        .arg("-I")
        .arg(include)
        .args([path("vectors.c"), PathBuf::from("-o"), path("vectors")])
        .status();
    // A linker of Rust needs a C compiler on most machines, so one is here.
    assert!(built.expect("cc is installed").success());
    let code = std::process::Command::new(path("vectors")).status().unwrap().code();
    assert_eq!(code, Some(0), "the number says which line of the program failed");
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
