//! Logs of other programs: MCAP in JSON, ROS 2, ROS 1 and protobuf, and PX4 ULog.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader;
use proptest::prelude::*;
use whirlstand_logs::{Log, Mapping, catalogue, info, read};

fn mappings(texts: &[&str]) -> Vec<Mapping> {
    texts.iter().map(|t| t.parse().unwrap()).collect()
}

/// A topic with its messages: log time in ns, bytes.
struct TestTopic {
    name: &'static str,
    encoding: &'static str,
    schema: (&'static str, &'static str, Vec<u8>),
    messages: Vec<(u64, Vec<u8>)>,
}

fn write(path: &Path, topics: &[TestTopic]) {
    let mut writer = mcap::Writer::new(File::create(path).unwrap()).unwrap();
    for topic in topics {
        let (name, encoding, data) = &topic.schema;
        let schema = if name.is_empty() { 0 } else { writer.add_schema(name, encoding, data).unwrap() };
        let channel = writer.add_channel(schema, topic.name, topic.encoding, &BTreeMap::new()).unwrap();
        for (n, (time, data)) in topic.messages.iter().enumerate() {
            let header = MessageHeader {
                channel_id: channel,
                sequence: n as u32,
                log_time: *time,
                publish_time: *time,
            };
            writer.write_to_known_channel(&header, data).unwrap();
        }
    }
    writer.finish().unwrap();
}

const START: u64 = 1_700_000_000_000_000_000;

fn json() -> TestTopic {
    let message =
        |k: u64| format!("{{\"rc\":{{\"roll\":{}}},\"armed\":true,\"name\":\"x\"}}", k as f64 * 0.1);
    TestTopic {
        name: "/sticks",
        encoding: "json",
        schema: ("Sticks", "jsonschema", b"{}".to_vec()),
        messages: (0..11).map(|k| (START + k * 100_000_000, message(k).into_bytes())).collect(),
    }
}

fn ros2() -> TestTopic {
    let message = |k: u64| {
        let mut bytes = vec![0, 1, 0, 0];
        bytes.extend((k as i32).to_le_bytes());
        bytes.extend(0u32.to_le_bytes());
        bytes.extend([4, 0, 0, 0]);
        bytes.extend(b"imu\0");
        for value in [180.0 * k as f64, -1.0, 0.0] {
            bytes.extend(f64::to_le_bytes(value));
        }
        bytes
    };
    let text = "std_msgs/Header header\nVector3 rate\n===\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n===\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n===\nMSG: test_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n";
    TestTopic {
        name: "/imu/data",
        encoding: "cdr",
        schema: ("test_msgs/msg/Imu", "ros2msg", text.into()),
        messages: (0..101).map(|k| (START + k * 10_000_000, message(k))).collect(),
    }
}

fn ros1() -> TestTopic {
    TestTopic {
        name: "/battery",
        encoding: "ros1",
        schema: ("test_msgs/Battery", "ros1msg", b"uint8 cells\nfloat32 volts".to_vec()),
        messages: (0..11)
            .map(|k| (START + k * 100_000_000, [&[3][..], &12.5f32.to_le_bytes()].concat()))
            .collect(),
    }
}

/// Descriptors of `message Pose { double x = 1; repeated float v = 2; }`, put together by hand.
fn protobuf() -> TestTopic {
    fn field(number: u8, content: &[u8]) -> Vec<u8> {
        [&[number << 3 | 2, content.len() as u8][..], content].concat()
    }
    let descriptor = |name: &[u8], number: u8, label: u8, kind: u8| {
        field(2, &[field(1, name), vec![3 << 3, number, 4 << 3, label, 5 << 3, kind]].concat())
    };
    let message = [field(1, b"Pose"), descriptor(b"x", 1, 1, 1), descriptor(b"v", 2, 3, 2)].concat();
    let file =
        [field(1, b"pose.proto"), field(2, b"test"), field(4, &message), field(12, b"proto3")].concat();
    let pose = |k: u64| {
        let v = [(k as f32).to_le_bytes(), 2f32.to_le_bytes()].concat();
        [&[1 << 3 | 1][..], &(k as f64).to_le_bytes(), &[2 << 3 | 2, 8], &v].concat()
    };
    TestTopic {
        name: "/pose",
        encoding: "protobuf",
        schema: ("test.Pose", "protobuf", field(1, &file)),
        messages: (0..11).map(|k| (START + k * 100_000_000, pose(k))).collect(),
    }
}

fn unsupported() -> TestTopic {
    TestTopic { name: "/blob", encoding: "cbor", schema: ("", "", vec![]), messages: vec![(START, vec![1])] }
}

fn everything(folder: &Path) -> PathBuf {
    let path = folder.join("foreign.mcap");
    write(&path, &[json(), ros2(), ros1(), protobuf(), unsupported()]);
    path
}

#[test]
fn signals_of_all_encodings_come_onto_one_clock() {
    let folder = tempfile::tempdir().unwrap();
    let path = everything(folder.path());
    let maps = mappings(&[
        "u_roll=/sticks.rc.roll",
        "roll_rate=/imu/data.rate.x[deg/s]",
        "pitch_rate=-/imu/data.rate.y",
        "battery=/battery.volts[V]",
        "longitudinal_position=/pose.x[m]",
        "second=/pose.v[1]",
    ]);
    let record = read(&path, &maps).unwrap();
    assert_eq!(record.len(), 101);
    assert!(record.time.iter().enumerate().all(|(k, t)| (t - k as f64 * 0.01).abs() < 1e-9));
    let at = |name: &str, k: usize| record.signal(name).unwrap().values[k];
    assert!((at("roll_rate", 50) - 50.0 * std::f64::consts::PI).abs() < 1e-9);
    assert_eq!((at("pitch_rate", 3), at("battery", 77), at("second", 5)), (1.0, 12.5, 2.0));
    // The stick is held, the position is interpolated.
    assert!((at("u_roll", 59) - 0.5).abs() < 1e-12 && (at("u_roll", 60) - 0.6).abs() < 1e-12);
    assert!((at("longitudinal_position", 55) - 5.5).abs() < 1e-6);
    assert_eq!(record.signal("battery").unwrap().unit, "V");
}

#[test]
fn what_a_foreign_log_has_is_listed() {
    let folder = tempfile::tempdir().unwrap();
    let path = everything(folder.path());
    let found = catalogue(&Log::open(&path).unwrap()).unwrap();
    for name in
        ["/sticks.rc.roll", "/sticks.armed", "/imu/data.header.stamp.sec", "/pose.v[0]", "/battery.cells"]
    {
        assert!(found.signals.iter().any(|s| s == name), "{name} in {:?}", found.signals);
    }
    assert_eq!(found.unreadable.len(), 1);
    assert!(found.unreadable[0].starts_with("/blob: "), "{:?}", found.unreadable);
    let told = info(&path).unwrap();
    let imu = told.topics.iter().find(|t| t.name == "/imu/data").unwrap();
    assert!(imu.signals.contains(&"/imu/data.rate.z".to_string()));
    assert!((imu.rate_hz.unwrap() - 100.0).abs() < 1e-3);

    let error = read(&path, &[]).unwrap_err().to_string();
    assert!(error.contains("--map NAME=SIGNAL[unit]") && error.contains("/pose.x"), "{error}");
    let error = read(&path, &mappings(&["roll_rate=/imu/data.rate.w"])).unwrap_err().to_string();
    assert!(error.contains("/imu/data.rate.z") && error.contains("/blob"), "{error}");
}

/// A ULog after the published format (PX4 user guide, "ULog File Format"): two topics, one with two instances.
fn ulog() -> Vec<u8> {
    fn message(kind: u8, content: &[u8]) -> Vec<u8> {
        [&(content.len() as u16).to_le_bytes()[..], &[kind], content].concat()
    }
    let mut file = b"ULog\x01\x12\x35\x01".to_vec();
    file.extend(1_000_000u64.to_le_bytes());
    file.extend(message(b'B', &[0; 40]));
    file.extend(message(
        b'F',
        b"vehicle_attitude:uint64_t timestamp;float[4] q;uint8_t count;uint8_t[3] _padding0;",
    ));
    file.extend(message(b'F', b"actuator_motors:uint64_t timestamp;double roll;bool armed;"));
    for (id, instance, name) in
        [(0u16, 0u8, "vehicle_attitude"), (1, 0, "actuator_motors"), (2, 1, "actuator_motors")]
    {
        file.extend(message(b'A', &[&[instance][..], &id.to_le_bytes(), name.as_bytes()].concat()));
    }
    for k in 0..200u64 {
        let time = (1_000_000 + k * 4000).to_le_bytes();
        let q: Vec<u8> = [1.0f32, k as f32, 0.0, 0.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        file.extend(message(b'D', &[&0u16.to_le_bytes()[..], &time, &q, &[k as u8]].concat()));
        if k % 5 == 0 {
            for (id, value) in [(1u16, k as f64), (2, -(k as f64))] {
                file.extend(message(
                    b'D',
                    &[&id.to_le_bytes()[..], &time, &value.to_le_bytes(), &[1]].concat(),
                ));
            }
        }
    }
    file
}

#[test]
fn a_ulog_is_read_by_topic_and_field() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.ulg");
    fs::write(&path, ulog()).unwrap();
    let maps = mappings(&[
        "q1=vehicle_attitude.q[1]",
        "roll=vehicle_attitude.q[1][deg]",
        "u_roll=actuator_motors.roll",
        "other=actuator_motors.1.roll",
    ]);
    let record = read(&path, &maps).unwrap();
    assert!((record.time[1] - 0.004).abs() < 1e-9);
    let at = |name: &str, k: usize| record.signal(name).unwrap().values[k];
    // Points of the clock miss the samples by rounding, which interpolation shows.
    assert!((at("q1", 100) - 100.0).abs() < 1e-9 && (at("other", 100) + 100.0).abs() < 1e-9);
    assert_eq!(at("u_roll", 104), 100.0);
    assert!((at("other", 103) + 103.0).abs() < 1e-6);
    assert!((at("roll", 180) - std::f64::consts::PI).abs() < 1e-6);
    let error = read(&path, &mappings(&["roll=vehicle_attitude.roll"])).unwrap_err().to_string();
    assert!(error.contains("vehicle_attitude.q[0]") && error.contains("actuator_motors.1.armed"), "{error}");
    let told = info(&path).unwrap();
    assert_eq!((told.kind, told.topics.len()), ("ulog", 3));
    let attitude = told.topics.iter().find(|t| t.name == "vehicle_attitude").unwrap();
    assert_eq!((attitude.messages, attitude.gaps), (200, 0));
    assert!((attitude.rate_hz.unwrap() - 250.0).abs() < 1e-6);

    let cut = folder.path().join("cut.ulg");
    fs::write(&cut, &ulog()[..4000]).unwrap();
    assert!(read(&cut, &maps).is_ok());
    assert!(info(&cut).unwrap().remarks[0].contains("ends in the middle"));
}

#[test]
fn a_length_that_leads_outside_its_message_is_damage() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lengths.ulg");
    let mut bytes = ulog();
    // Behind head and flags: a parameter whose name is said to have 200 characters, in a message of 4 bytes.
    bytes.splice(59..59, [4, 0, b'P', 200, b'a', b'b', b'c']);
    fs::write(&path, bytes).unwrap();
    let error = info(&path).unwrap_err().to_string();
    assert!(error.contains("lengths.ulg") && error.contains("points past its end"), "{error}");
    // A subscription that ends before its name.
    let mut bytes = ulog();
    bytes.extend([1, 0, b'A', 0]);
    fs::write(&path, bytes).unwrap();
    let error = info(&path).unwrap_err().to_string();
    assert!(error.contains("lengths.ulg") && error.contains("points past its end"), "{error}");
}

#[test]
fn data_appended_after_a_crash_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("crash.ulg");
    let whole = ulog();
    // The first section is cut inside a message; the flags say where the appended one, with the last sample, begins.
    const CUT: usize = 4000;
    const LAST_SAMPLE: usize = 3 + 2 + 8 + 4 * 4 + 1;
    const FLAGS: usize = 16 + 3;
    let cut = folder.path().join("cut.ulg");
    fs::write(&cut, &whole[..CUT]).unwrap();
    let mut bytes = [&whole[..CUT], &whole[whole.len() - LAST_SAMPLE..]].concat();
    bytes[FLAGS + 8] = 1;
    bytes[FLAGS + 16..][..8].copy_from_slice(&(CUT as u64).to_le_bytes());
    fs::write(&path, bytes).unwrap();
    let count = |path: &Path| info(path).unwrap().topics.iter().map(|t| t.messages).sum::<u64>();
    assert_eq!(count(&path), count(&cut) + 1);
    assert_eq!(info(&path).unwrap().remarks, Vec::<String>::new());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn a_damaged_ulog_never_panics(
        flips in prop::collection::vec((0.0f64..1.0, 1u8..), 0..6),
        cut in 0.0f64..1.5,
        early in any::<bool>(),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.ulg");
        let mut bytes = ulog();
        for (at, xor) in flips {
            // Half of the cases are aimed at the head and the definitions.
            let reach = if early { 400.0 } else { bytes.len() as f64 };
            bytes[(at * reach) as usize] ^= xor;
        }
        bytes.truncate((bytes.len() as f64 * cut) as usize);
        fs::write(&path, bytes).unwrap();
        let _ = read(&path, &mappings(&["roll=vehicle_attitude.q[1]"]));
        let _ = info(&path);
    }

    #[test]
    fn a_damaged_foreign_log_never_panics(flips in prop::collection::vec((0.0f64..1.0, 1u8..), 0..6)) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.mcap");
        write(&path, &[json(), ros2(), ros1(), protobuf()]);
        let mut bytes = fs::read(&path).unwrap();
        for (at, xor) in flips {
            let index = (at * bytes.len() as f64) as usize;
            bytes[index] ^= xor;
        }
        fs::write(&path, bytes).unwrap();
        let _ = read(&path, &mappings(&["x=/pose.x", "y=/imu/data.rate.x"]));
        let _ = info(&path);
    }

    #[test]
    fn damaged_messages_never_panic(which in 0usize..4, data in prop::collection::vec(any::<u8>(), 0..100)) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.mcap");
        let mut topic = [json, ros2, ros1, protobuf][which]();
        topic.messages.insert(3, (START + 5, data));
        write(&path, &[topic]);
        let _ = info(&path);
    }
}

#[test]
fn a_pointer_of_git_lfs_is_told_apart_from_a_log() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["flight.ulg", "flight.csv", "flight.bin", "flight.bbl"] {
        let path = folder.path().join(name);
        fs::write(&path, "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n")
            .unwrap();
        for error in [read(&path, &[]).unwrap_err().to_string(), info(&path).unwrap_err().to_string()] {
            assert!(error.contains(name) && error.contains("`git lfs pull`"), "{error}");
        }
    }
}

/// What a copy that was broken off leaves, or a recorder that was killed.
#[test]
fn an_empty_file_is_called_empty_whatever_its_name() {
    let dir = tempfile::tempdir().unwrap();
    for name in ["log.ulg", "log.bin", "log.bbl", "log.csv"] {
        let path = dir.path().join(name);
        fs::write(&path, "").unwrap();
        for error in [read(&path, &[]).unwrap_err().to_string(), info(&path).unwrap_err().to_string()] {
            assert!(error.contains(name) && error.contains("the file is empty"), "{error}");
        }
    }
}
