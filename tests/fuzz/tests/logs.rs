//! Any bytes at all, as a log of every format: a record or an error that names the file, in bounded time and memory.
//!
//! `cargo test` tries the kept corpus and some random inputs; `docs/architecture.md` says how to search for long.

use whirlstand_file_fuzz::{Sheet, edited, seeds};
use whirlstand_logs::{Mapping, read, write_csv};

/// Most points of a record of a small log: those that any clock may have, and some for every sample.
const POINTS: usize = 2_200_000;

fn mappings(texts: &[&str]) -> Vec<Mapping> {
    texts.iter().map(|text| text.parse().unwrap_or_else(|e| panic!("{text}: {e}"))).collect()
}

#[test]
fn csv() {
    let (sheet, copy) = (Sheet::new("a.csv"), Sheet::new("copy.csv"));
    let words: [&[u8]; 16] = [
        b",",
        b"\n",
        b"\"",
        b"\r\n",
        b";",
        b"\t",
        b"nan",
        b"inf",
        b"-",
        b"1e308",
        b"1e-320",
        b"[deg]",
        b"[ms]",
        b"t",
        b"\xef\xbb\xbf",
        b"9007199254740993",
    ];
    bolero::check!().for_each(|input: &[u8]| {
        let bytes = edited(seeds::CSV.as_bytes(), input, &words);
        sheet.is_survived(&bytes, &[], POINTS);
        // What can be read can be written, and reads back as the same.
        let Ok(record) = read(sheet.path(), &[]) else { return };
        write_csv(&record, copy.path()).expect("room for the copy");
        let again = read(copy.path(), &[]).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((record.len(), record.names()), (again.len(), again.names()));
    });
}

#[test]
fn ulog() {
    let (sheet, seed) = (Sheet::new("a.ulg"), seeds::ulog());
    let mappings = mappings(&["roll_rate=rates.x", "u_roll=actuators.y"]);
    let words: [&[u8]; 8] = [
        b"F",
        b"A",
        b"D",
        b"float x;",
        b"uint64_t timestamp;",
        b"int8_t[4000] x;",
        b"rates",
        b"rates:rates y;",
    ];
    bolero::check!().for_each(|input: &[u8]| {
        sheet.is_survived(&edited(&seed, input, &words), &mappings, POINTS);
    });
}

#[test]
fn dataflash() {
    let (sheet, seed) = (Sheet::new("a.bin"), seeds::dataflash());
    let mappings = mappings(&["roll_rate=IMU[0].GyrX", "u_roll=RCOU.C1"]);
    let words: [&[u8]; 8] = [
        b"\xa3\x95\x80",
        b"\xa3\x95",
        b"QBff",
        b"TimeUS,I,GyrX,AccZ",
        b"s#Eo",
        b"F-00",
        b"a",
        b"\xa3\x95\x85",
    ];
    bolero::check!().for_each(|input: &[u8]| {
        sheet.is_survived(&edited(&seed, input, &words), &mappings, POINTS);
    });
}

#[test]
fn blackbox() {
    let (sheet, seed) = (Sheet::new("a.bbl"), seeds::blackbox());
    let mappings = mappings(&["roll_rate=gyroADC[0]", "u_roll=motor[0]"]);
    let words: [&[u8]; 12] = [
        b"I",
        b"P",
        b"S",
        b"E\xff",
        b"H ",
        b"H Field I encoding:",
        b"H Field P predictor:",
        b"H Data version:2\n",
        b"H Product:Blackbox flight data recorder by Nicholas Sherlock\n",
        b",9,9,9",
        b"motorOutput:",
        b"\n",
    ];
    bolero::check!().for_each(|input: &[u8]| {
        sheet.is_survived(&edited(&seed, input, &words), &mappings, POINTS);
    });
}

/// The container of an MCAP log, byte by byte.
#[test]
fn mcap_container() {
    let sheet = Sheet::new("a.mcap");
    let seed = seeds::mcap(&mut <[u8]>::to_vec);
    let mappings = mappings(&["roll=/json.x", "u_roll=/ros.y"]);
    let words: [&[u8]; 6] = [b"\x89MCAP0\r\n", b"\x03", b"\x04", b"\x05", b"\x06", b"\x0f"];
    bolero::check!().for_each(|input: &[u8]| {
        sheet.is_survived(&edited(&seed, input, &words), &mappings, POINTS);
    });
}

/// What is in the messages and schemas of a log whose container is right.
#[test]
fn mcap_content() {
    let sheet = Sheet::new("a.mcap");
    let mappings = mappings(&["roll=/json.x", "u_roll=/ros.y", "pitch=/proto.x"]);
    let words: [&[u8]; 10] = [
        b"{",
        b"[",
        b"\"x\":",
        b"null",
        b"1e999",
        b"float64 x\n",
        b"string[<=5] s\n",
        b"MSG: a/B\n",
        b"uint8[] d\n",
        b"=\n",
    ];
    bolero::check!().for_each(|input: &[u8]| {
        // Each schema and message has its own part of the script, so that most of them are right.
        let mut parts = input.chunks(6);
        let log = seeds::mcap(&mut |data| edited(data, parts.next().unwrap_or_default(), &words));
        sheet.is_survived(&log, &mappings, POINTS);
    });
}
