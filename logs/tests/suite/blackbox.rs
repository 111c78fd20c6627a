//! Blackbox logs of Betaflight: values with their units, several logs in one file, gaps, and damage.

use std::fs;
use std::path::{Path, PathBuf};

use proptest::prelude::*;
use whirlstand_logs::{Kind, info, kind, read};

use crate::blackbox_file::{END, HEADER, fields, log, unsigned};
use crate::damage::{self, mappings};

/// Points that the record of a damaged log may have at most, whatever its times became: what a common clock may have for 1000
/// samples of two signals. Times are stored as differences of differences, so that a wrong step of up to 10 s is
/// repeated by every frame up to the next one that stands for itself.
const MOST_POINTS: usize = 2_000_000 + 100 * 2 * 1000;

fn written(folder: &Path, bytes: &[u8]) -> PathBuf {
    damage::written(folder, "flight.bbl", bytes)
}

#[test]
fn signals_have_the_units_of_their_fields() {
    let folder = tempfile::tempdir().unwrap();
    // Whatever it is called.
    let path = folder.path().join("flight.txt");
    // The clock's 32 bits begin anew in the middle.
    fs::write(&path, log(HEADER, u32::MAX - 500_000, 1000, |_| true)).unwrap();
    assert_eq!(kind(&path).unwrap(), Kind::Blackbox);
    let maps = mappings(&[
        "roll_rate=main.gyroADC[0]",
        "roll_rate_target=main.setpoint[0]",
        "u_one=main.motor[0]",
        "u_two=main.motor[1]",
        "vertical_acceleration=main.accSmooth[2]",
        "battery=main.vbatLatest",
    ]);
    let record = read(&path, &maps).unwrap();
    assert_eq!(record.len(), 1000);
    for (k, time) in record.time.iter().enumerate() {
        let [rate, target, one, two, acceleration, voltage] = fields(k as u32).map(f64::from);
        assert!((time - k as f64 * 1e-3).abs() < 1e-9);
        let near = |name: &str, value: f64| {
            let found = record.signal(name).unwrap().values[k];
            assert!((found - value).abs() < 1e-6, "{name} at {k}: {found}, not {value}");
        };
        near("roll_rate", rate.to_radians());
        near("roll_rate_target", target.to_radians());
        near("u_one", one);
        near("u_two", two);
        near("vertical_acceleration", acceleration / 2048.0 * 9.80665);
        near("battery", voltage / 100.0);
    }
    let units = record.signals().iter().map(|s| s.unit.as_str());
    assert_eq!(units.collect::<Vec<_>>(), ["rad/s", "rad/s", "", "", "m/s^2", "V"]);
}

#[test]
fn numbers_of_a_logger_of_high_resolution_are_tenths() {
    let folder = tempfile::tempdir().unwrap();
    let header = format!("{HEADER}H blackbox_high_resolution:1\n");
    let path = written(folder.path(), &log(&header, 0, 100, |_| true));
    let record = read(&path, &mappings(&["rate=main.gyroADC[0]", "u_one=main.motor[0]"])).unwrap();
    let at = |name: &str| record.signal(name).unwrap().values[30];
    let [rate, _, one, ..] = fields(30).map(f64::from);
    assert!((at("rate") - (rate / 10.0).to_radians()).abs() < 1e-9 && at("u_one") == one);
}

#[test]
fn the_longest_of_several_logs_is_read_and_the_others_by_their_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let broken = HEADER.replace("Data version:2", "Data version:9");
    let logs = [
        log(HEADER, 5_000_000, 200, |_| true),
        log(HEADER, 9_000_000, 1500, |_| true),
        log(&broken, 0, 100, |_| true),
        log(HEADER, 20_000_000, 300, |_| true),
    ];
    let path = written(folder.path(), &logs.concat());
    let told = info(&path).unwrap();
    let counts: Vec<_> = told.topics.iter().map(|t| (t.name.as_str(), t.messages)).collect();
    assert_eq!(
        counts,
        [("main", 1500), ("main.1", 200), ("main.4", 300), ("slow", 15), ("slow.1", 2), ("slow.4", 3)]
    );
    let main = &told.topics[0];
    assert!(main.signals.contains(&"main.gyroADC[0][deg/s]".into()), "{:?}", main.signals);
    let remarks = told.remarks.join("\n");
    for word in ["holds 4 logs", "of log 2, the longest", "main.1 of 0.2 s, main.4 of 0.3 s"] {
        assert!(remarks.contains(word), "{remarks}");
    }
    assert!(remarks.contains("log 3 at byte ") && remarks.contains("version is 9"), "{remarks}");

    let record = read(&path, &mappings(&["rate=main.gyroADC[0]"])).unwrap();
    assert_eq!(record.len(), 1500);
    assert!(record.origin.ends_with("flight.bbl, log 2 of 4"), "{}", record.origin);
    let record = read(&path, &mappings(&["rate=main.4.gyroADC[0]"])).unwrap();
    assert_eq!(record.len(), 300);
    assert!(record.origin.ends_with("log 4 of 4"), "{}", record.origin);
    let error = read(&path, &mappings(&["a=main.motor[0]", "b=main.1.motor[0]"])).unwrap_err().to_string();
    assert!(error.contains("do not overlap"), "{error}");
}

#[test]
fn lost_frames_are_a_hole_in_the_record() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path(), &log(HEADER, 0, 1000, |k| !(400..500).contains(&k)));
    let record = read(&path, &mappings(&["rate=main.gyroADC[0]", "phase=slow.failsafePhase"])).unwrap();
    let holes = record.signal("rate").unwrap().values.iter().filter(|v| v.is_nan()).count();
    assert_eq!(holes, 100);
    let told = info(&path).unwrap();
    assert_eq!((told.topics[0].gaps, told.topics[0].longest_gap.unwrap().missing), (1, 100));
    assert_eq!(told.remarks, Vec::<String>::new());
}

#[test]
fn a_logger_that_was_off_for_a_minute_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    const BACK_US: u32 = 60_000_000;
    let before = log(HEADER, 0, 200, |_| true);
    let before = &before[..before.len() - END.len()];
    let after = log("", BACK_US, 200, |_| true);
    let mut event = b"E\x0e".to_vec();
    unsigned(&mut event, 60_000);
    unsigned(&mut event, BACK_US);
    // Without the event, the frames are believed once two that stand for themselves fit each other.
    for (event, frames, remarks) in [(&event[..], 400, 0), (&[], 368, 1)] {
        let path = written(folder.path(), &[before, event, &after].concat());
        let told = info(&path).unwrap();
        assert_eq!((told.topics[0].messages, told.remarks.len()), (frames, remarks), "{:?}", told.remarks);
        assert!((told.duration - 60.199).abs() < 1e-9 && told.topics[0].gaps == 1, "{}", told.duration);
        let record = read(&path, &mappings(&["rate=main.gyroADC[0]"])).unwrap();
        let values = record.signal("rate").unwrap().values.iter().filter(|v| !v.is_nan()).count();
        assert_eq!((record.len(), values as u64), (60_200, frames));
    }
}

#[test]
fn damage_is_told_with_its_place_and_the_rest_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let whole = log(HEADER, 0, 1000, |_| true);
    let maps = mappings(&["u_one=main.motor[0]"]);
    let mut bytes = whole.clone();
    let place = HEADER.len() + 4000;
    bytes[place..place + 20].fill(0xff);
    let path = written(folder.path(), &bytes);
    let told = info(&path).unwrap();
    assert!(told.remarks[0].contains("flight.bbl, log 1, is damaged"), "{:?}", told.remarks);
    // Up to the next frame that stands for itself.
    let lost = 1000 - told.topics[0].messages;
    assert!((2..=34).contains(&lost) && told.topics[0].gaps == 1, "{lost}");
    let record = read(&path, &maps).unwrap();
    for (k, value) in record.signal("u_one").unwrap().values.iter().enumerate() {
        let expected = f64::from(fields(k as u32)[2]);
        assert!(value.is_nan() || (value - expected).abs() < 1e-6, "{value}, not {expected}, at {k}");
    }

    let path = written(folder.path(), &whole[..whole.len() - 40]);
    let told = info(&path).unwrap();
    assert!(told.remarks[0].contains("has no end marker"), "{:?}", told.remarks);
    assert!(told.topics[0].messages >= 990);
    // The memory behind the last frame was never written.
    let path = written(folder.path(), &[&whole[..whole.len() - 40], &[0xff; 4096][..]].concat());
    assert_eq!(info(&path).unwrap().remarks.len(), 1);
}

#[test]
fn a_header_that_cannot_be_used_is_an_error_with_its_place() {
    let folder = tempfile::tempdir().unwrap();
    for (from, to, word) in [
        ("H Field P encoding:9,0,0,6", "H Field P encoding:9,0,0,77", "'77' is not a known number"),
        ("H Field I signed:0,", "H Field I signed:", "8 fields but 7 in 'Field I signed'"),
        ("H motorOutput:48,2047\n", "", "refers to 'motorOutput'"),
        ("motor[0]", "motor[9]", "motor[0], which does not precede it"),
        (",time", ",tame", "no time"),
        ("Field I name:", "Field Q name:", "no line 'Field I name'"),
    ] {
        let path = written(folder.path(), &log(&HEADER.replace(from, to), 0, 100, |_| true));
        for error in [info(&path).unwrap_err().to_string(), read(&path, &[]).unwrap_err().to_string()] {
            assert!(error.contains("flight.bbl: log 1 at byte 0") && error.contains(word), "{error}");
        }
    }
    let many = HEADER.replace("name:loopIteration", &format!("name:{}loopIteration", "x,".repeat(200)));
    let error = info(written(folder.path(), many.as_bytes())).unwrap_err().to_string();
    assert!(error.contains("208 fields"), "{error}");
    for bytes in [&b"t,roll\n0,1\n"[..], &[0xff; 1000]] {
        let error = info(written(folder.path(), bytes)).unwrap_err().to_string();
        assert!(error.contains("flight.bbl") && error.contains("Copy the log"), "{error}");
    }
}

#[test]
fn a_log_cut_anywhere_gives_what_was_whole_or_an_error() {
    let longest = damage::cut_anywhere(
        "flight.bbl",
        &log(HEADER, 0, 1000, |_| true),
        47,
        &mappings(&["rate=main.gyroADC[0]"]),
    );
    assert!(longest > 990);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn a_damaged_log_never_panics_nor_grows(damage in damage::damage()) {
        let maps = mappings(&["rate=main.gyroADC[0]", "u_one=main.motor[0]"]);
        damage.is_survived("flight.bbl", log(HEADER, 5_000_000, 1000, |_| true), HEADER.len(), (&maps, MOST_POINTS))?;
    }

    #[test]
    fn noise_behind_a_header_never_panics(noise in prop::collection::vec(any::<u8>(), 0..3000)) {
        let folder = tempfile::tempdir().unwrap();
        let path = written(folder.path(), &[HEADER.as_bytes(), &noise].concat());
        let _ = info(&path);
        let _ = read(&path, &mappings(&["rate=main.gyroADC[0]"]));
    }
}
