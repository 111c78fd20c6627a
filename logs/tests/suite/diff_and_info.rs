//! Two logs compared, and what a log says about itself.

use std::path::{Path, PathBuf};

use whirlstand_logs::{BenchInfo, LogWriter, PanelChannels, Panels, SignalInfo, diff, info};
use whirlstand_msgs::{Head, Health, Imu, Message, Truth};

const PERIOD_NS: u64 = 1_000_000;

/// What to change in a log: by step.
#[derive(Default)]
struct Change {
    roll: Option<u64>,
    skip_truth: Option<u64>,
    steps: Option<u64>,
    seed: u64,
    transport: &'static str,
    /// Publish truth and IMU the other way round.
    swapped: bool,
    /// Nothing for panels, as logs had it once.
    plain: bool,
}

fn write(folder: &Path, name: &str, change: &Change) -> PathBuf {
    let path = folder.join(name);
    let bench = BenchInfo {
        seed: change.seed,
        transport: change.transport.into(),
        period_ns: PERIOD_NS,
        started_unix_ns: name.len() as u64,
        states: vec![SignalInfo::new("roll", "rad")],
        ..BenchInfo::default()
    };
    let mut log = LogWriter::create(&path, &bench).unwrap();
    let (imus, truths) = (log.channel::<Imu>().unwrap(), log.channel::<Truth>().unwrap());
    let healths = log.channel::<Health>().unwrap();
    let mut channels = (!change.plain).then(|| PanelChannels::open(&mut log).unwrap());
    let mut panels = Panels::new(&bench, Default::default());
    for step in 0..change.steps.unwrap_or(500) {
        let head = Head { seq: step, step, stamp_ns: step * PERIOD_NS };
        let mut imu = Imu { head, roll: step as f64, ..Imu::zeroed() };
        if change.roll == Some(step) {
            imu.roll = f64::from_bits(imu.roll.to_bits() + 1);
        }
        let truth = Truth { head, ..Truth::zeroed() };
        if change.swapped {
            log.write(&imus, &imu).unwrap();
        }
        if change.skip_truth != Some(step) {
            log.write(&truths, &truth).unwrap();
        }
        if !change.swapped {
            log.write(&imus, &imu).unwrap();
        }
        if let Some(channels) = &mut channels {
            panels.hear(&truth.into(), |ns, panel| channels.write(&mut log, ns, &panel).unwrap());
        }
        if step % 100 == 0 {
            let wall = Head { stamp_ns: name.len() as u64 + step, ..head };
            log.write(&healths, &Health { head: wall, ..Health::zeroed() }).unwrap();
        }
    }
    log.finish().unwrap();
    path
}

#[test]
fn the_same_messages_are_identical_however_topics_interleave() {
    let folder = tempfile::tempdir().unwrap();
    let a = write(folder.path(), "a.mcap", &Change { transport: "inproc", ..Change::default() });
    let b =
        write(folder.path(), "bb.mcap", &Change { transport: "zenoh", swapped: true, ..Change::default() });
    let found = diff(&a, &b).unwrap();
    assert!(found.identical && found.first.is_none() && found.remarks.is_empty(), "{found:?}");
    let equal: Vec<_> = found.topics.iter().map(|t| (t.topic.as_str(), t.equal, t.set_aside)).collect();
    let set_aside = |topic: &'static str| (topic, 0, true);
    assert_eq!(equal[0..2], [set_aside("/health"), ("/imu", 500, false)]);
    assert_eq!(equal[2..], [set_aside("/scene"), set_aside("/tf"), ("/truth", 500, false)]);
    // Another transport and another time of day are told and are no difference.
    assert_eq!(found.benches.len(), 1);
    assert_eq!(found.benches[0].key, "transport");
    // Nor is what was made of the other topics, which older logs do not have.
    let old =
        write(folder.path(), "old.mcap", &Change { transport: "inproc", plain: true, ..Change::default() });
    let found = diff(&a, &old).unwrap();
    assert!(
        found.identical && found.topics.iter().any(|t| t.is_made_of_others && t.messages_b == 0),
        "{found:?}"
    );
}

#[test]
fn the_first_sample_that_differs_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let a = write(folder.path(), "a.mcap", &Change::default());
    let b = write(folder.path(), "b.mcap", &Change { roll: Some(321), ..Change::default() });
    let found = diff(&a, &b).unwrap();
    assert!(!found.identical);
    assert_eq!(
        found.first.unwrap().to_string(),
        "/imu, step 321, message 321 of the topic: roll is 321 in A and 321.00000000000006 in B"
    );
    let imu = found.topics.iter().find(|t| t.topic == "/imu").unwrap();
    assert_eq!((imu.equal, imu.messages_a, imu.messages_b), (499, 500, 500));
}

#[test]
fn missing_and_extra_messages_are_differences() {
    let folder = tempfile::tempdir().unwrap();
    let a = write(folder.path(), "a.mcap", &Change::default());
    let lost = write(folder.path(), "lost.mcap", &Change { skip_truth: Some(40), ..Change::default() });
    let first = diff(&a, &lost).unwrap().first.unwrap();
    assert_eq!((first.topic.as_str(), first.step, first.field.as_str()), ("/truth", Some(40), "head.seq"));
    let short = write(folder.path(), "short.mcap", &Change { steps: Some(450), ..Change::default() });
    let first = diff(&short, &a).unwrap().first.unwrap();
    assert_eq!((first.step, first.field.as_str()), (Some(450), "message"));
    assert_eq!((first.a.as_str(), first.b.as_str()), ("missing", "there"));
}

#[test]
fn what_a_log_holds_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = write(folder.path(), "a.mcap", &Change { skip_truth: Some(40), seed: 9, ..Change::default() });
    let found = info(&path).unwrap();
    assert_eq!((found.kind, found.bench.as_ref().unwrap().seed, found.remarks.len()), ("mcap", 9, 0));
    assert!((found.duration - 0.499).abs() < 1e-9);
    let truth = found.topics.iter().find(|t| t.name == "/truth").unwrap();
    assert_eq!((truth.messages, truth.lost, truth.gaps), (499, 1, 1));
    assert!((truth.rate_hz.unwrap() - 1000.0).abs() < 1e-6);
    assert_eq!(truth.longest_gap.unwrap().after, 39);
    let imu = found.topics.iter().find(|t| t.name == "/imu").unwrap();
    assert_eq!((imu.message_type.as_str(), imu.lost, imu.gaps), ("whirlstand/msg/Imu", 0, 0));
    assert!(serde_json::to_value(&found).unwrap()["files"][0]["ending"] == "complete");

    let csv = folder.path().join("a.csv");
    std::fs::write(&csv, "t,roll[deg]\n0,180\n0.1,\n0.2,-180\n0.5,0\n").unwrap();
    let found = info(&csv).unwrap();
    assert_eq!((found.kind, found.signals[0].missing), ("csv", 1));
    assert_eq!(found.signals[0].max, Some(std::f64::consts::PI));
    assert_eq!(found.sampling.unwrap().gaps.len(), 1);
}

#[test]
fn a_log_that_was_cut_off_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let path = write(folder.path(), "a.mcap", &Change::default());
    let bytes = std::fs::read(&path).unwrap();
    let cut = folder.path().join("cut.mcap");
    std::fs::write(&cut, &bytes[..bytes.len() - 500]).unwrap();
    assert!(info(&cut).unwrap().remarks[0].contains("is incomplete"));
    let found = diff(&path, &cut).unwrap();
    assert!(found.identical && found.remarks.len() == 1, "{:?}", found.first);
}
