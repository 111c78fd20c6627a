//! Logs of flown autopilots, whole and damaged, and a DataFlash log as ArduPilot's own reader reads it.

#[path = "support/dataflash.rs"]
mod file;

use std::fs;
use std::path::Path;
use std::process::Command as Process;

use whirlstand_logs::{Mapping, Record, info, read};
use whirlstand_test_harness::{Outcome, data, python_with};

/// Places at which a measured log is cut or damaged.
const PLACES: usize = 40;

fn record(path: &Path, maps: &[&str]) -> Record {
    let maps: Vec<Mapping> = maps.iter().map(|text| text.parse().unwrap()).collect();
    read(path, &maps).unwrap()
}

/// Least and greatest value, and mean.
fn range(record: &Record, name: &str) -> (f64, f64, f64) {
    let values: Vec<f64> =
        record.signal(name).unwrap().values.iter().copied().filter(|v| !v.is_nan()).collect();
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    let greatest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    (least, greatest, values.iter().sum::<f64>() / values.len() as f64)
}

/// Standard deviation of the difference of two signals.
fn apart(record: &Record, one: &str, other: &str) -> f64 {
    let values = |name: &str| record.signal(name).unwrap().values.clone();
    let differences: Vec<f64> = values(one).iter().zip(values(other)).map(|(a, b)| a - b).collect();
    (differences.iter().map(|d| d * d).sum::<f64>() / differences.len() as f64).sqrt()
}

fn a_flight_at_1_khz_has_the_units_of_its_header() -> Outcome {
    let path = data()?.join("flights/LOG00037.BFL");
    let told = info(&path).unwrap();
    assert_eq!((told.kind, told.remarks.len()), ("blackbox", 0), "{:?}", told.remarks);
    let counts: Vec<_> = told.topics.iter().map(|t| (t.name.as_str(), t.messages, t.gaps)).collect();
    assert_eq!(counts, [("gps", 86, 0), ("main", 16774, 0), ("slow", 3, 0)]);
    assert!((told.duration - 17.022).abs() < 0.001);
    let record = record(
        &path,
        &[
            "rate=main.gyroADC[0]",
            "target=main.setpoint[0]",
            "u_motor=main.motor[0]",
            "acceleration=main.accSmooth[2]",
            "battery=main.vbatLatest",
        ],
    );
    // The header has motors from 158 to 2047, a battery of 22.77 V at arming, and the gyroscope follows its target.
    let (least, greatest, _) = range(&record, "u_motor");
    assert!(least >= 157.0 && greatest == 2047.0, "{least} to {greatest}");
    let (least, greatest, _) = range(&record, "battery");
    assert!(least > 17.0 && greatest < 23.0, "{least} to {greatest}");
    let (_, _, mean) = range(&record, "acceleration");
    assert!((mean - 9.8).abs() < 0.5, "{mean}");
    assert!(apart(&record, "rate", "target") < 5f64.to_radians(), "{}", apart(&record, "rate", "target"));
    assert!(range(&record, "rate").1 > 0.5);
    Ok(())
}

fn a_flight_at_500_hz_follows_its_targets() -> Outcome {
    let path = data()?.join("flights/btfl_002.bbl");
    let told = info(&path).unwrap();
    let main = told.topics.iter().find(|t| t.name == "main").unwrap();
    assert_eq!((main.messages, main.gaps), (66640, 0));
    assert!((main.rate_hz.unwrap() - 500.0).abs() < 1e-3);
    let maps = ["rate=main.gyroADC[0]", "target=main.setpoint[0]", "u_motor=main.motor[0]"];
    let record = record(&path, &maps);
    let (least, greatest, _) = range(&record, "u_motor");
    assert!(least >= 157.0 && greatest <= 2047.0, "{least} to {greatest}");
    // Up to 730 deg/s.
    let (_, greatest, _) = range(&record, "rate");
    assert!((greatest - 730f64.to_radians()).abs() < 0.05, "{greatest}");
    assert!(apart(&record, "rate", "target") < 30f64.to_radians(), "{}", apart(&record, "rate", "target"));
    Ok(())
}

fn a_damaged_flight_gives_what_is_whole_or_an_error() -> Outcome {
    let whole = fs::read(data()?.join("flights/LOG00037.BFL")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("damaged.bfl");
    let maps = ["u_motor=main.motor[0]".parse::<Mapping>().unwrap()];
    let mut longest = 0;
    for n in 0..PLACES {
        // The first places are in the header.
        let place = if n < PLACES / 4 { n * 400 } else { whole.len() / PLACES * n };
        fs::write(&path, &whole[..place]).unwrap();
        match read(&path, &maps) {
            Ok(record) => {
                assert!(record.len() >= longest, "cut at {place}");
                longest = record.len();
            }
            Err(error) => assert!(error.to_string().contains("damaged.bfl"), "{error}"),
        }
        let mut bytes = whole.clone();
        bytes[place..place + 40].fill(0xff);
        fs::write(&path, &bytes).unwrap();
        match read(&path, &maps) {
            // Nothing checks the numbers of the header, so a damaged one may change what the frames mean.
            Ok(_) if n < PLACES / 4 => {}
            Ok(record) => {
                let values = &record.signal("u_motor").unwrap().values;
                // A held signal goes on through a pause of a few samples.
                let missing = values.iter().filter(|v| v.is_nan()).count();
                assert!(record.len() >= 16_700 && missing <= 80, "{place}: {missing}");
                let told = info(&path).unwrap();
                let main = told.topics.iter().find(|t| t.name == "main").unwrap();
                assert!((16_600..16_774).contains(&main.messages), "{place}: {}", main.messages);
                assert!(told.remarks[0].contains("is damaged"), "{place}: {:?}", told.remarks);
            }
            Err(error) => assert!(error.to_string().contains("damaged.bfl"), "{error}"),
        }
    }
    assert!(longest > 16_000);
    Ok(())
}

fn pymavlink_reads_the_same_dataflash_log() -> Outcome {
    let python = python_with("pymavlink")?;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.bin");
    fs::write(&path, file::flight(|_| true)).unwrap();
    let script = "import json, sys\n\
        from pymavlink import DFReader\n\
        log = DFReader.DFReader_binary(sys.argv[1], zero_time_base=True)\n\
        found = {}\n\
        while (m := log.recv_msg()) is not None:\n\
        \x20   fields = [f for f in m.get_fieldnames() if f not in ('TimeUS', 'I')]\n\
        \x20   sensor = '.1' if getattr(m, 'I', 0) == 1 else ''\n\
        \x20   if m.get_type() in ('IMU', 'RATE', 'ATT', 'RCOU', 'POS'):\n\
        \x20       for f in fields:\n\
        \x20           found.setdefault(m.get_type() + sensor + '.' + f, []).append([m.TimeUS * 1e-6, getattr(m, f)])\n\
        print(json.dumps(found))\n";
    let output = Process::new(python).args(["-c", script]).arg(&path).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let found = found.as_object().unwrap();
    assert_eq!(found.len(), 11, "{:?}", found.keys());
    for (source, samples) in found {
        let samples = samples.as_array().unwrap();
        // As stored: its unit is taken for a pure number.
        let record = record(&path, &[&format!("x={source}[1]")]);
        assert_eq!(record.len(), samples.len(), "{source}");
        let start = samples[0][0].as_f64().unwrap();
        for ((time, value), sample) in record.time.iter().zip(&record.signals()[0].values).zip(samples) {
            let (at, expected) = (sample[0].as_f64().unwrap() - start, sample[1].as_f64().unwrap());
            assert!((time - at).abs() < 1e-6, "{source}: {time} s, not {at} s");
            assert!(
                (value - expected).abs() < 1e-9 * expected.abs().max(1.0),
                "{source}: {value}, not {expected}"
            );
        }
    }
    Ok(())
}

whirlstand_test_harness::tests!(
    a_flight_at_1_khz_has_the_units_of_its_header,
    a_flight_at_500_hz_follows_its_targets,
    a_damaged_flight_gives_what_is_whole_or_an_error,
    pymavlink_reads_the_same_dataflash_log
);
