//! Logs written, read back, cut off and damaged.

use std::fs;
use std::path::Path;

use proptest::prelude::*;
use whirlstand_logs::{BenchInfo, Ending, Log, LogWriter, ReadError, SignalInfo, bench_record};
use whirlstand_msgs::{
    Command, Disturbance, Estimate, Head, Health, Imu, MAX_INPUTS, MAX_STATES, Message, Odometry, Sent,
    Setpoint, Truth, charge, valid,
};

const PERIOD_NS: u64 = 5_000_000;

fn head(step: u64) -> Head {
    Head { seq: step, step, stamp_ns: step * PERIOD_NS }
}

fn info() -> BenchInfo {
    BenchInfo {
        version: "0.1.0".into(),
        launch: "test".into(),
        vehicle: "quadrotor".into(),
        mode: "lockstep".into(),
        transport: "inproc".into(),
        seed: 7,
        period_ns: PERIOD_NS,
        states: vec![SignalInfo::new("roll", "rad"), SignalInfo::new("roll_rate", "rad/s")],
        inputs: vec![SignalInfo::new("u_roll", "")],
        outputs: vec![
            SignalInfo::new("roll", "rad"),
            SignalInfo::new("roll_rate", "rad/s"),
            SignalInfo::new("lateral_speed", "m/s"),
        ],
        ..BenchInfo::default()
    }
}

fn imu(step: u64) -> Imu {
    Imu {
        head: head(step),
        roll: 0.01 * step as f64,
        roll_rate: (step as f64).sin(),
        valid: if step.is_multiple_of(2) { valid::FIRST | valid::SECOND } else { valid::SECOND },
        ..Imu::zeroed()
    }
}

fn truth(step: u64) -> Truth {
    let mut x = [0.0; MAX_STATES];
    x[0] = 1.0 / (1.0 + step as f64);
    let mut u = [0.0; MAX_INPUTS];
    u[0] = 0.5 - step as f64;
    Truth { head: head(step), x, u, states: 2, inputs: 1, flags: 0, reserved: 0 }
}

fn command(step: u64) -> Command {
    let mut u = [0.0; MAX_INPUTS];
    u[0] = 100.0 + step as f64;
    Command { head: head(step), u, count: 1, flags: 0 }
}

/// Writes `steps` steps with all topics, flushing every `flush` steps, and returns the writer unfinished.
fn write(path: &Path, from: u64, steps: u64, flush: u64) -> LogWriter {
    let mut log = LogWriter::create(path, &info()).unwrap();
    log.attach("launch.toml", "application/toml", b"name = \"test\"").unwrap();
    let imus = log.channel::<Imu>().unwrap();
    let truths = log.channel::<Truth>().unwrap();
    let commands = log.channel::<Command>().unwrap();
    let healths = log.channel::<Health>().unwrap();
    for step in from..from + steps {
        log.write(&truths, &truth(step)).unwrap();
        log.write(&imus, &imu(step)).unwrap();
        log.write(&commands, &command(step)).unwrap();
        if step % 10 == 0 {
            let wall = Head { seq: step / 10, step, stamp_ns: 1_800_000_000_000_000_000 + step };
            log.write(&healths, &Health { head: wall, ..Health::zeroed() }).unwrap();
        }
        if step % flush == flush - 1 {
            log.flush().unwrap();
        }
    }
    log
}

fn read<M: Message>(path: &Path) -> Vec<M> {
    Log::open(path).unwrap().messages::<M>().unwrap().map(Result::unwrap).collect()
}

#[test]
fn what_is_written_reads_back_with_its_bench() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    let written = write(&path, 0, 1000, 300).finish().unwrap();
    assert_eq!(written.messages, 3100);
    assert_eq!(written.bytes, fs::metadata(&path).unwrap().len());
    let log = Log::open(folder.path()).unwrap();
    assert_eq!(log.info(), Some(&info()));
    assert_eq!(log.launch_text(), Some("name = \"test\""));
    assert_eq!(log.vehicle_text(), None);
    assert_eq!(read::<Imu>(&path), (0..1000).map(imu).collect::<Vec<_>>());
    assert_eq!(read::<Health>(&path).len(), 100);
    assert!(read::<Setpoint>(&path).is_empty());
    let mut stream = log.stream().unwrap();
    let mut last = 0;
    while let Some(message) = stream.next().unwrap() {
        // Health too stands on the bench's time axis.
        assert!(message.log_time >= last && message.log_time < 1000 * PERIOD_NS);
        last = message.log_time;
    }
    assert_eq!(stream.endings()[0].1, Ending::Complete);
    assert!(stream.damage().is_empty());
}

#[test]
fn a_record_has_the_vehicles_names_and_gaps_where_a_sensor_was_not_fresh() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    let mut log = write(&path, 0, 10, 5);
    let odometry = log.channel::<Odometry>().unwrap();
    let m = Odometry { head: head(4), lateral_speed: 2.5, valid: valid::SECOND, ..Odometry::zeroed() };
    log.write(&odometry, &m).unwrap();
    let estimates = log.channel::<Estimate>().unwrap();
    let mut estimate = Estimate { head: head(3), count: 2, ..Estimate::zeroed() };
    (estimate.x[1], estimate.std[1]) = (0.25, 0.125);
    log.write(&estimates, &estimate).unwrap();
    let setpoints = log.channel::<Setpoint>().unwrap();
    let mut setpoint = Setpoint { head: head(2), tracked: 0b10, ..Setpoint::zeroed() };
    (setpoint.x[1], setpoint.stick[0]) = (-1.0, 0.75);
    log.write(&setpoints, &setpoint).unwrap();
    let disturbances = log.channel::<Disturbance>().unwrap();
    let mut disturbance = Disturbance { head: head(6), count: 2, ..Disturbance::zeroed() };
    disturbance.dx[1] = 3.0;
    log.write(&disturbances, &disturbance).unwrap();
    log.finish().unwrap();

    let record = bench_record(&Log::open(&path).unwrap()).unwrap();
    assert_eq!(record.time, (0..10).map(|k| (k * PERIOD_NS) as f64 / 1e9).collect::<Vec<_>>());
    let at = |name: &str, k: usize| record.signal(name).unwrap().values[k];
    assert_eq!(at("roll", 4), 0.04);
    assert!(at("roll", 3).is_nan() && !at("roll_rate", 3).is_nan());
    assert_eq!(at("lateral_speed", 4), 2.5);
    assert!(at("lateral_speed", 5).is_nan());
    assert_eq!(at("u_roll", 7), -6.5);
    assert_eq!(at("truth.roll", 1), 0.5);
    assert_eq!(at("command.u_roll", 7), 107.0);
    assert_eq!((at("estimate.roll_rate", 3), at("estimate.std.roll_rate", 3)), (0.25, 0.125));
    assert_eq!((at("setpoint.roll_rate", 2), at("setpoint.stick.u_roll", 2)), (-1.0, 0.75));
    assert!(at("setpoint.roll", 2).is_nan());
    assert_eq!((at("disturbance.roll_rate", 5), at("disturbance.roll_rate", 9)), (0.0, 3.0));
    assert_eq!(record.signal("disturbance.roll_rate").unwrap().unit, "rad/s^2");
}

#[test]
fn without_truth_the_input_is_the_command_of_the_step_before() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    let mut log = LogWriter::create(&path, &info()).unwrap();
    let commands = log.channel::<Command>().unwrap();
    (0..5).for_each(|k| log.write(&commands, &command(k)).unwrap());
    log.finish().unwrap();
    let record = bench_record(&Log::open(&path).unwrap()).unwrap();
    let u = &record.signal("u_roll").unwrap().values;
    assert!(u[0].is_nan());
    assert_eq!(u[1..], [100.0, 101.0, 102.0, 103.0, 104.0]);
}

#[test]
fn the_input_of_a_real_vehicle_is_what_acted_while_the_controller_was_in_charge() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    let mut log = LogWriter::create(&path, &info()).unwrap();
    let (commands, sent) = (log.channel::<Command>().unwrap(), log.channel::<Sent>().unwrap());
    use charge::{CONTROLLER, FAILSAFE, NOBODY, PILOT};
    for (k, in_charge) in
        [NOBODY, CONTROLLER, CONTROLLER, PILOT, FAILSAFE, CONTROLLER].into_iter().enumerate()
    {
        log.write(&commands, &command(k as u64)).unwrap();
        let mut message = Sent { head: head(k as u64), count: 1, in_charge, ..Sent::zeroed() };
        message.u[0] = k as f64;
        log.write(&sent, &message).unwrap();
    }
    log.finish().unwrap();
    let record = bench_record(&Log::open(&path).unwrap()).unwrap();
    let u = &record.signal("u_roll").unwrap().values;
    let acted: Vec<Option<f64>> = u.iter().map(|u| u.is_finite().then_some(*u)).collect();
    assert_eq!(acted, [None, Some(1.0), Some(2.0), None, None, Some(5.0)]);
    assert_eq!(
        record.signal("command.u_roll").unwrap().values[3],
        103.0,
        "what was asked for is there as well"
    );
}

#[test]
fn files_of_a_restarted_recorder_are_one_log() {
    let folder = tempfile::tempdir().unwrap();
    // The first recorder was killed: no footer.
    std::mem::forget(write(&folder.path().join("log.mcap"), 0, 100, 100));
    std::mem::forget(write(&folder.path().join("log.2.mcap"), 120, 30, 10));
    write(&folder.path().join("log.3.mcap"), 150, 50, 100).finish().unwrap();
    let imus = read::<Imu>(folder.path());
    assert_eq!(imus.len(), 180);
    assert_eq!(imus[100].head.step, 120);
    let log = Log::open(folder.path()).unwrap();
    let mut stream = log.stream().unwrap();
    while stream.next().unwrap().is_some() {}
    let endings: Vec<_> = stream.endings().iter().map(|(_, e)| *e).collect();
    assert_eq!(endings, [Ending::Truncated, Ending::Truncated, Ending::Complete]);
    assert_eq!(bench_record(&log).unwrap().len(), 180);
}

#[test]
fn another_version_and_other_files_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("foreign.mcap");
    let mut writer = mcap::Writer::new(fs::File::create(&path).unwrap()).unwrap();
    let schema = writer.add_schema("whirlstand/msg/Imu", "ros2msg", b"float64 roll\n").unwrap();
    let channel = writer.add_channel(schema, "/imu", "cdr", &Default::default()).unwrap();
    let header =
        mcap::records::MessageHeader { channel_id: channel, sequence: 0, log_time: 0, publish_time: 0 };
    writer.write_to_known_channel(&header, &[0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]).unwrap();
    writer.finish().unwrap();
    let log = Log::open(&path).unwrap();
    assert!(log.info().is_none());
    let error = log.messages::<Imu>().unwrap().next().unwrap().unwrap_err();
    assert!(matches!(&error, ReadError::Schema { topic, .. } if topic == "/imu"), "{error}");

    let text = folder.path().join("notes.mcap");
    fs::write(&text, "this is not a log").unwrap();
    assert!(matches!(Log::open(&text), Err(ReadError::NotMcap { .. })));
    fs::create_dir(folder.path().join("empty")).unwrap();
    assert!(matches!(Log::open(folder.path().join("empty")), Err(ReadError::NoLog { .. })));
    // A recorder killed before its first write leaves an empty file.
    fs::write(folder.path().join("new.mcap"), "").unwrap();
    assert!(read::<Imu>(&folder.path().join("new.mcap")).is_empty());
}

/// A chunk whose length reaches beyond the file looks like the last one of a killed recorder, whose checksum cannot be tested.
#[test]
fn a_damaged_length_of_a_chunk_hides_neither_its_checksum_nor_what_follows() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    std::mem::forget(write(&path, 0, 60, 20));
    let sound = fs::read(&path).unwrap();
    let chunks: Vec<usize> = chunks(&sound);
    assert_eq!(chunks.len(), 3);
    for high in [3, 5, 8] {
        let mut bytes = sound.clone();
        bytes[chunks[1] + high] ^= 1;
        fs::write(&path, &bytes).unwrap();
        assert_eq!(read::<Imu>(&path).len(), 60, "the length alone");

        // A value in the middle of the chunk as well: all of it is left out, and said.
        bytes[(chunks[1] + chunks[2]) / 2] ^= 1;
        fs::write(&path, &bytes).unwrap();
        let imus = read::<Imu>(&path);
        assert_eq!(imus.len(), 40);
        assert!(imus.iter().all(|m| *m == imu(m.head.step)));
        let log = Log::open(&path).unwrap();
        let mut stream = log.stream().unwrap();
        while stream.next().unwrap().is_some() {}
        assert_eq!(stream.damage().len(), 1, "{:?}", stream.damage());
    }
}

/// Offsets of the chunks of a log.
fn chunks(bytes: &[u8]) -> Vec<usize> {
    let mut at = mcap::MAGIC.len();
    let mut found = Vec::new();
    while at + 9 <= bytes.len() {
        if bytes[at] == mcap::records::op::CHUNK {
            found.push(at);
        }
        at += 9 + u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
    }
    found
}

/// Reads everything there is, and checks that what is read was written.
fn survives(path: &Path) -> usize {
    let Ok(log) = Log::open(path) else { return 0 };
    let mut count = 0;
    if let Ok(mut stream) = log.stream() {
        while let Ok(Some(_)) = stream.next() {
            count += 1;
        }
    }
    let _ = log.messages::<Truth>().map(|m| m.take_while(Result::is_ok).count());
    let _ = bench_record(&log);
    count
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_message_reads_back_bit_for_bit(images in prop::collection::vec(prop::collection::vec(any::<u8>(), size_of::<Estimate>()), 0..20)) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.mcap");
        let mut log = LogWriter::create(&path, &info()).unwrap();
        let channel = log.channel::<Estimate>().unwrap();
        for image in &images {
            log.write(&channel, &bytemuck::pod_read_unaligned(image)).unwrap();
        }
        log.finish().unwrap();
        let back: Vec<Vec<u8>> =
            read::<Estimate>(&path).iter().map(|m| bytemuck::bytes_of(m).to_vec()).collect();
        prop_assert_eq!(back, images);
    }

    #[test]
    fn a_log_cut_anywhere_reads_up_to_the_last_flush_before_the_cut(cut in 0.0f64..1.0) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.mcap");
        let mut sizes = Vec::new();
        for steps in [20, 40, 60, 80] {
            std::mem::forget(write(&path, 0, steps, 20));
            sizes.push((fs::metadata(&path).unwrap().len(), steps));
        }
        let bytes = fs::read(&path).unwrap();
        let length = (bytes.len() as f64 * cut) as u64;
        fs::write(&path, &bytes[..length as usize]).unwrap();
        let whole = sizes.iter().rev().find(|(size, _)| *size <= length).map_or(0, |(_, steps)| *steps);
        if length == 0 || length >= 8 {
            let imus = read::<Imu>(&path);
            prop_assert!(imus.len() as u64 >= whole, "{} of {}", imus.len(), whole);
            for (k, m) in imus.iter().enumerate() {
                prop_assert_eq!(m, &imu(k as u64));
            }
        } else {
            prop_assert!(Log::open(&path).is_err());
        }
    }

    #[test]
    fn flipped_bytes_never_panic_and_never_give_a_message_that_was_not_written(
        flips in prop::collection::vec((0.0f64..1.0, 1u8..), 1..4),
        finished in any::<bool>(),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.mcap");
        let log = write(&path, 0, 60, 20);
        if finished { log.finish().unwrap(); } else { std::mem::forget(log); }
        let mut bytes = fs::read(&path).unwrap();
        for (at, xor) in flips {
            let index = (at * bytes.len() as f64) as usize;
            bytes[index] ^= xor;
        }
        fs::write(&path, bytes).unwrap();
        prop_assert!(survives(&path) <= 186);
        if let Ok(log) = Log::open(&path) && let Ok(imus) = log.messages::<Imu>() {
            for m in imus.map_while(Result::ok) {
                prop_assert_eq!(m, imu(m.head.step));
            }
        }
    }
}
