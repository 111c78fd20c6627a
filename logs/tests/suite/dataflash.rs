//! ArduPilot DataFlash logs: values with their units, rates, gaps, and damage.

use std::f64::consts::PI;
use std::fs;
use std::path::{Path, PathBuf};

use proptest::prelude::*;
use whirlstand_logs::{Kind, info, kind, read};

use crate::damage::{self, mappings};
use crate::dataflash_file::{self as file, START_US, Writer, flight};

/// Points that the record of a damaged log may have at most: the flight, and the longest step of time that is believed.
const MOST_POINTS: usize = 2 * 62 * 400;

fn written(folder: &Path, bytes: &[u8]) -> PathBuf {
    damage::written(folder, "flight.bin", bytes)
}

#[test]
fn signals_have_the_units_and_scales_of_the_log() {
    let folder = tempfile::tempdir().unwrap();
    // Whatever it is called.
    let path = folder.path().join("00000042.log");
    fs::write(&path, flight(|_| true)).unwrap();
    assert_eq!(kind(&path).unwrap(), Kind::Dataflash);
    let record = read(
        &path,
        &mappings(&[
            "roll_rate=IMU.GyrX",
            "other=-IMU.1.GyrX",
            "vertical_acceleration=IMU.AccZ",
            "roll_rate_target=RATE.RDes",
            "roll=ATT.Roll",
            "u_roll=RCOU.C1[1]",
            "u_pitch=RCOU.C2",
            "latitude=POS.Lat",
        ]),
    )
    .unwrap();
    assert_eq!(record.len(), 801);
    assert!((record.time[1] - 0.0025).abs() < 1e-9);
    let at = |name: &str, k: usize| record.signal(name).unwrap().values[k];
    let unit = |name: &str| record.signal(name).unwrap().unit.as_str();
    assert!((at("roll_rate", 500) - 5.0).abs() < 1e-6 && (at("other", 500) - 5.0).abs() < 1e-6);
    assert_eq!((at("vertical_acceleration", 3), unit("vertical_acceleration")), (-9.5, "m/s^2"));
    // Interpolated between samples; hundredths of a degree in the file.
    assert!((at("roll", 404) - 4.04f64.to_radians()).abs() < 1e-9 && unit("roll") == "rad");
    assert!((at("roll_rate_target", 9) - PI / 2.0).abs() < 1e-9 && unit("roll_rate_target") == "rad/s");
    // Held from sample to sample; the unit in the brackets, or that of the log.
    assert_eq!((at("u_roll", 31), at("u_roll", 32)), (1116.0, 1132.0));
    assert!((at("u_pitch", 0) - 1500e-6).abs() < 1e-12 && unit("u_pitch") == "s");
    assert!((at("latitude", 7) - 47.3977f64.to_radians()).abs() < 1e-9);
}

#[test]
fn what_a_log_has_is_listed() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path(), &flight(|_| true));
    let told = info(&path).unwrap();
    assert_eq!((told.kind, told.remarks.len()), ("dataflash", 0), "{:?}", told.remarks);
    let names: Vec<_> = told.topics.iter().map(|t| t.name.as_str()).collect();
    assert_eq!(names, ["ATT", "IMU", "IMU.1", "MSG", "POS", "RATE", "RCOU"]);
    let imu = told.topics.iter().find(|t| t.name == "IMU").unwrap();
    assert_eq!(imu.signals, ["IMU.I", "IMU.GyrX[rad/s]", "IMU.AccZ[m/s/s]"]);
    assert_eq!((imu.messages, imu.gaps), (801, 0));
    assert!((imu.rate_hz.unwrap() - 400.0).abs() < 1e-6 && (told.duration - 2.0).abs() < 1e-9);

    let error = read(&path, &[]).unwrap_err().to_string();
    assert!(error.contains("--map NAME=SIGNAL[unit]") && error.contains("RATE.RDes"), "{error}");
    let error = read(&path, &mappings(&["roll=ATT.Rol"])).unwrap_err().to_string();
    assert!(error.contains("flight.bin") && error.contains("did you mean 'ATT.Roll'"), "{error}");
}

#[test]
fn a_pause_of_the_logger_is_a_hole_in_the_record() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path(), &flight(|k| !(300..400).contains(&k)));
    let record = read(&path, &mappings(&["roll_rate=IMU.GyrX", "roll=ATT.Roll"])).unwrap();
    let holes = |name: &str| record.signal(name).unwrap().values.iter().filter(|v| v.is_nan()).count();
    assert_eq!((record.len(), holes("roll_rate"), holes("roll")), (801, 100, 0));
    let told = info(&path).unwrap();
    let imu = told.topics.iter().find(|t| t.name == "IMU").unwrap();
    assert_eq!((imu.gaps, imu.longest_gap.unwrap().missing), (1, 100));
}

#[test]
fn an_old_log_without_units_is_read_with_the_scales_of_its_types() {
    let folder = tempfile::tempdir().unwrap();
    let mut log = Writer::default();
    // ArduCopter 3.2 leaves out the last name.
    log.define(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format");
    log.define(9, 75, "ACC", "Igca", "TimeMS,Half,Hundredths,Raw");
    for k in 0..50u32 {
        let raw: Vec<u8> = (0..32i16).flat_map(|n| (n - 16).to_le_bytes()).collect();
        log.message(9, &[&(1000 + 20 * k).to_le_bytes(), &[0, 0xc0], &(-150i16).to_le_bytes(), &raw]);
    }
    let path = written(folder.path(), &log.bytes);
    assert_eq!(info(&path).unwrap().remarks, Vec::<String>::new());
    let maps = mappings(&["half=ACC.Half", "speed=ACC.Hundredths[m/s]", "raw=ACC.Raw[3]"]);
    let record = read(&path, &maps).unwrap();
    let at = |name: &str| record.signal(name).unwrap().values[7];
    assert_eq!((record.len(), at("half"), at("speed"), at("raw")), (50, -2.0, -1.5, -13.0));
    assert!((record.time[1] - 0.02).abs() < 1e-9);
}

#[test]
fn a_log_of_px4s_former_format_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let mut log = Writer::default();
    log.define(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Labels");
    log.define(129, 11, "TIME", "Q", "StartTime");
    log.define(2, 7, "ATT", "f", "Roll");
    for k in 0..50u64 {
        log.message(129, &[&(20_000 * k).to_le_bytes()]);
        log.message(2, &[&(k as f32).to_le_bytes()]);
    }
    let error = info(written(folder.path(), &log.bytes)).unwrap_err().to_string();
    assert!(error.contains("sdlog2") && error.contains("CSV"), "{error}");
}

#[test]
fn damage_is_told_with_its_place_and_the_rest_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let whole = flight(|_| true);
    let maps = mappings(&["roll_rate=IMU.GyrX"]);
    let count = |path: &Path| info(path).unwrap().topics.iter().map(|t| t.messages).sum::<u64>();
    let messages = count(&written(folder.path(), &whole));

    let mut bytes = whole.clone();
    let place = 20_000 + bytes[20_000..].windows(2).position(|w| w == [0xa3, 0x95]).unwrap();
    bytes.splice(place..place, [0x55; 700]);
    let path = written(folder.path(), &bytes);
    let told = info(&path).unwrap().remarks;
    assert!(told[0].contains("flight.bin is damaged") && told[0].contains("in 1 places"), "{told:?}");
    // The message before the damage cannot be told from it.
    assert_eq!(count(&path), messages - 1);
    assert!(read(&path, &maps).unwrap().len() == 801);

    let path = written(folder.path(), &whole[..whole.len() - 5]);
    let told = info(&path).unwrap().remarks;
    let cut = whole.len() - 15;
    assert!(told[0].contains(&format!("in the middle of the message at byte {cut}")), "{told:?}");
    assert_eq!((told.len(), count(&path)), (1, messages - 1));
}

#[test]
fn a_damaged_time_does_not_stretch_the_record() {
    let folder = tempfile::tempdir().unwrap();
    let maps = mappings(&["roll_rate=IMU.GyrX"]);
    for at_start in [true, false] {
        let mut bytes = flight(|_| true);
        let time = if at_start { START_US } else { START_US + 100 * 2500 };
        let place = bytes.windows(8).position(|w| w == time.to_le_bytes()).unwrap();
        // Some 140 years.
        bytes[place + 6] ^= 0x10;
        let path = written(folder.path(), &bytes);
        assert_eq!(read(&path, &maps).unwrap().len(), 801);
        assert!(info(&path).unwrap().remarks[0].contains("1 messages are left out"));
    }
}

#[test]
fn what_is_no_log_is_an_error_that_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let mut lying = file::definitions();
    // A type whose messages are said to be shorter than their own header.
    lying.define(140, 2, "LIE", "", "");
    lying.bytes.extend([0xa3, 0x95, 140, 0, 0]);
    let told = info(written(folder.path(), &lying.bytes)).unwrap();
    assert!(told.remarks[0].contains("is damaged"), "{:?}", told.remarks);
    for bytes in [&b"t,roll\n0,1\n"[..], &[0xa3, 0x95, 0x80], &[0xff; 1000]] {
        let path = written(folder.path(), bytes);
        for error in [info(&path).unwrap_err().to_string(), read(&path, &[]).unwrap_err().to_string()] {
            assert!(error.contains("flight.bin") && error.contains("Download the log"), "{error}");
        }
    }
}

#[test]
fn a_log_cut_anywhere_gives_what_was_whole_or_an_error() {
    let longest =
        damage::cut_anywhere("flight.bin", &flight(|_| true), 331, &mappings(&["roll_rate=IMU.GyrX"]));
    assert!(longest > 790);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn a_damaged_log_never_panics_nor_grows(damage in damage::damage()) {
        let maps = mappings(&["roll_rate=IMU.GyrX", "roll=ATT.Roll"]);
        damage.is_survived("flight.bin", flight(|_| true), 2500, (&maps, MOST_POINTS))?;
    }

    #[test]
    fn noise_never_panics(noise in prop::collection::vec(any::<u8>(), 0..3000)) {
        let folder = tempfile::tempdir().unwrap();
        let mut log = file::definitions();
        for piece in noise.chunks(20) {
            log.message(piece[0], &[piece]);
        }
        let path = written(folder.path(), &log.bytes);
        let _ = info(&path);
        let _ = read(&path, &mappings(&["roll_rate=IMU.GyrX"]));
    }
}
