//! Small files of every format that are right.

#![allow(dead_code, reason = "the writers are those of other tests, of which each uses a part")]

#[path = "../../../logs/tests/support/blackbox.rs"]
mod blackbox_writer;
#[path = "../../../logs/tests/support/dataflash.rs"]
mod dataflash_writer;
#[path = "../../support/foreign.rs"]
mod foreign;

use std::collections::BTreeMap;
use std::sync::OnceLock;

use foreign::{Encoding, Topic};

/// Rows of each topic.
const ROWS: usize = 12;

fn topic(name: &'static str, period_s: f64) -> Topic {
    let rows = (0..ROWS).map(|k| (period_s * k as f64, vec![0.1 * k as f64, -1.0]));
    Topic { name, fields: vec!["x", "y"], rows: rows.collect() }
}

/// A ULog of two topics.
pub fn ulog() -> Vec<u8> {
    foreign::ulog(&[topic("rates", 0.01), topic("actuators", 0.02)])
}

/// An MCAP log of another program: JSON, CDR and protocol buffers.
fn foreign_mcap() -> &'static [u8] {
    static WHOLE: OnceLock<Vec<u8>> = OnceLock::new();
    WHOLE.get_or_init(|| {
        let topics = [
            (topic("/json", 0.01), Encoding::Json),
            (topic("/ros", 0.02), Encoding::Ros2),
            (topic("/proto", 0.02), Encoding::Protobuf),
        ];
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("seed.mcap");
        foreign::mcap(&path, &topics);
        std::fs::read(&path).expect("it was written")
    })
}

/// The log of another program, with right lengths and checksums, whose schemas and messages went through `edit`.
pub fn mcap(edit: &mut dyn FnMut(&[u8]) -> Vec<u8>) -> Vec<u8> {
    let whole = foreign_mcap();
    let mut out = std::io::Cursor::new(Vec::new());
    let options = mcap::WriteOptions::new().compression(None);
    let mut writer = options.create(&mut out).expect("in memory");
    let mut channels = BTreeMap::new();
    for message in mcap::MessageStream::new(whole).expect("a log").map_while(Result::ok) {
        let from = &message.channel;
        let channel = *channels.entry(from.id).or_insert_with(|| {
            let schema = from.schema.as_ref().map_or(0, |schema| {
                writer.add_schema(&schema.name, &schema.encoding, &edit(&schema.data)).expect("in memory")
            });
            writer
                .add_channel(schema, &from.topic, &from.message_encoding, &from.metadata)
                .expect("in memory")
        });
        let header = mcap::records::MessageHeader {
            channel_id: channel,
            sequence: message.sequence,
            log_time: message.log_time,
            publish_time: message.publish_time,
        };
        writer.write_to_known_channel(&header, &edit(&message.data)).expect("in memory");
    }
    writer.finish().expect("in memory");
    drop(writer);
    out.into_inner()
}

/// A DataFlash log: all definitions, and the beginning of a flight.
pub fn dataflash() -> Vec<u8> {
    let mut log = dataflash_writer::flight(|_| true);
    log.truncate(dataflash_writer::definitions().bytes.len() + 600);
    log
}

/// A blackbox log of a few frames.
pub fn blackbox() -> Vec<u8> {
    blackbox_writer::log(blackbox_writer::HEADER, 1_000_000, 40, |k| k != 30)
}

/// A CSV file with units, a gap and an empty cell.
pub const CSV: &str = "t[ms],u_roll,roll[deg],\"roll rate[deg/s]\"\n0,0.1,1.5,0\n5,0.1,1.6,\n10,-0.2,1e0,3\n15,0,+.5,4\n40,0,2,5\n";
