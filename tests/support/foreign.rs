//! Logs of other programs, written byte by byte according to their published formats.

use std::collections::BTreeMap;
use std::path::Path;

/// A topic with one clock: name, fields, and rows of time in s and values.
pub struct Topic {
    pub name: &'static str,
    pub fields: Vec<&'static str>,
    pub rows: Vec<(f64, Vec<f64>)>,
}

/// A ULog according to the PX4 user guide, "ULog File Format": all fields are 32-bit floats, times are microseconds
/// since boot.
pub fn ulog(topics: &[Topic]) -> Vec<u8> {
    fn message(kind: u8, content: &[u8]) -> Vec<u8> {
        [&(content.len() as u16).to_le_bytes()[..], &[kind], content].concat()
    }
    const BOOT_US: f64 = 5e6;
    let mut file = b"ULog\x01\x12\x35\x01".to_vec();
    file.extend((BOOT_US as u64).to_le_bytes());
    file.extend(message(b'B', &[0; 40]));
    let key = b"char[6] sys_name";
    file.extend(message(b'I', &[&[key.len() as u8][..], key, b"bench0"].concat()));
    for topic in topics {
        let fields: String = topic.fields.iter().map(|f| format!("float {f};")).collect();
        file.extend(message(b'F', format!("{}:uint64_t timestamp;{fields}", topic.name).as_bytes()));
    }
    for (id, topic) in topics.iter().enumerate() {
        let id = (id as u16).to_le_bytes();
        file.extend(message(b'A', &[&[0][..], &id, topic.name.as_bytes()].concat()));
    }
    // A logger writes samples in the order in which they arrive.
    let mut all: Vec<(f64, usize, &[f64])> = Vec::new();
    for (id, topic) in topics.iter().enumerate() {
        all.extend(topic.rows.iter().map(|(t, values)| (*t, id, &values[..])));
    }
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    for (t, id, values) in all {
        let mut data = (id as u16).to_le_bytes().to_vec();
        data.extend(((BOOT_US + 1e6 * t).round() as u64).to_le_bytes());
        data.extend(values.iter().flat_map(|v| (*v as f32).to_le_bytes()));
        file.extend(message(b'D', &data));
    }
    file
}

/// Encoding of the topics of an MCAP log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// JSON objects.
    Json,
    /// ROS 2: CDR with `ros2msg` schemas.
    Ros2,
    /// Protocol buffers with a descriptor set.
    Protobuf,
}

fn field(number: u8, content: &[u8]) -> Vec<u8> {
    [&[number << 3 | 2, content.len() as u8][..], content].concat()
}

/// A descriptor set of one message whose fields are all doubles.
fn descriptors(message: &str, fields: &[&str]) -> Vec<u8> {
    let mut body = field(1, message.as_bytes());
    for (n, name) in fields.iter().enumerate() {
        // Number, label "optional", type "double".
        let kind = [3 << 3, n as u8 + 1, 4 << 3, 1, 5 << 3, 1];
        body.extend(field(2, &[field(1, name.as_bytes()), kind.to_vec()].concat()));
    }
    let file = [field(1, b"test.proto"), field(2, b"test"), field(4, &body), field(12, b"proto3")].concat();
    field(1, &file)
}

/// An MCAP log of another program.
pub fn mcap(path: &Path, topics: &[(Topic, Encoding)]) {
    const START_NS: f64 = 1.7e18;
    let mut writer = mcap::Writer::new(std::fs::File::create(path).unwrap()).unwrap();
    for (topic, encoding) in topics {
        let (schema, kind, data, message) = match encoding {
            Encoding::Json => ("Test".to_string(), "jsonschema", b"{}".to_vec(), "json"),
            Encoding::Ros2 => {
                let text: String = topic.fields.iter().map(|f| format!("float64 {f}\n")).collect();
                ("test_msgs/msg/Test".to_string(), "ros2msg", text.into_bytes(), "cdr")
            }
            Encoding::Protobuf => {
                ("test.Test".to_string(), "protobuf", descriptors("Test", &topic.fields), "protobuf")
            }
        };
        let schema = writer.add_schema(&schema, kind, &data).unwrap();
        let channel = writer.add_channel(schema, topic.name, message, &BTreeMap::new()).unwrap();
        for (n, (t, values)) in topic.rows.iter().enumerate() {
            let time = START_NS as u64 + (1e9 * t).round() as u64;
            let header = mcap::records::MessageHeader {
                channel_id: channel,
                sequence: n as u32,
                log_time: time,
                publish_time: time,
            };
            let named = topic.fields.iter().zip(values);
            let data = match encoding {
                Encoding::Json => {
                    let members: Vec<String> = named.map(|(f, v)| format!("\"{f}\":{v}")).collect();
                    format!("{{{}}}", members.join(",")).into_bytes()
                }
                Encoding::Ros2 => {
                    [0, 1, 0, 0].into_iter().chain(values.iter().flat_map(|v| v.to_le_bytes())).collect()
                }
                Encoding::Protobuf => values
                    .iter()
                    .enumerate()
                    .flat_map(|(n, v)| [&[(n as u8 + 1) << 3 | 1][..], &v.to_le_bytes()].concat())
                    .collect(),
            };
            writer.write_to_known_channel(&header, &data).unwrap();
        }
    }
    writer.finish().unwrap();
}
