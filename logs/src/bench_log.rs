//! The typed messages of a bench's log: the list of the recorded topics, and how they are read.

use whirlstand_msgs::{
    Adjustment, Autopilot, Command, Disturbance, Estimate, Finding, Head, Health, Imu, MAX_OUTPUTS, Message,
    Odometry, Outputs, Reported, Sent, Setpoint, Truth, valid,
};

use crate::bench_info::BenchInfo;
use crate::hole::Hole;
use crate::log::Log;
use crate::named_schema::named_schema;
use crate::read_error::ReadError;
use crate::stream::{LogStream, RawMessage};

/// Passes the topics of the loop, which are recorded, to another macro: a field's name and the message's type.
///
/// The order is that in which a recorder reads the topics: truth comes first, because its progress bounds how many
/// messages of the others can be waiting. [`Health`] is recorded as well; it concerns nodes and not the loop.
#[macro_export]
macro_rules! loop_topics {
    ($to:ident) => {
        $to! {
            truth: Truth,
            disturbance: Disturbance,
            odometry: Odometry,
            outputs: Outputs,
            imu: Imu,
            estimate: Estimate,
            command: Command,
            setpoint: Setpoint,
            sent: Sent,
            reported: Reported,
            autopilot: Autopilot,
            finding: Finding,
        }
    };
}

/// Type and schema of the messages of a topic.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MessageType {
    /// Topic, without its `/`.
    pub topic: &'static str,
    /// Name of the type.
    pub name: &'static str,
    /// Its schema in ROS 2 message syntax, with the names of a bench's signals.
    pub schema: String,
}

impl MessageType {
    fn of<M: Message>(info: &BenchInfo) -> Self {
        Self { topic: M::TOPIC, name: M::TYPE_NAME, schema: named_schema::<M>(info) }
    }
}

macro_rules! bench_message {
    ($($name:ident: $message:ident),* $(,)?) => {
        bench_message!(all $($message)* Adjustment Health);
    };
    (all $($message:ident)*) => {
        /// A message of a bench: of the loop, about a change requested from outside, or about a node.
        #[derive(Debug, Clone, Copy)]
        #[expect(missing_docs, reason = "each holds the message of its name")]
        pub enum BenchMessage {
            $($message($message),)*
        }

        $(impl From<$message> for BenchMessage {
            fn from(message: $message) -> Self {
                Self::$message(message)
            }
        })*

        impl BenchMessage {
            /// Head of the message: number, step and time.
            pub fn head(&self) -> &Head {
                match self {
                    $(Self::$message(m) => &m.head,)*
                }
            }

            /// Topic, without its `/`, and the message's bytes in memory.
            pub fn raw(&self) -> (&'static str, &[u8]) {
                match self {
                    $(Self::$message(m) => ($message::TOPIC, bytemuck::bytes_of(m)),)*
                }
            }

            /// All message types, with the schemas of a bench.
            pub fn types(info: &BenchInfo) -> Vec<MessageType> {
                vec![$(MessageType::of::<$message>(info),)*]
            }

            /// Decodes a message into its type; `None` when no bench records its topic.
            ///
            /// # Errors
            /// As [`RawMessage::decode`].
            pub fn decode(raw: &RawMessage<'_>) -> Result<Option<Self>, ReadError> {
                Ok(match raw.topic.name.strip_prefix('/') {
                    $(Some($message::TOPIC) => Some(Self::$message(raw.decode()?)),)*
                    _ => None,
                })
            }
        }
    };
}

impl BenchMessage {
    /// Bench time of the message, ns; `None` for `Health`, which carries wall-clock time.
    pub fn bench_ns(&self) -> Option<u64> {
        match self {
            Self::Health(_) => None,
            other => Some(other.head().stamp_ns),
        }
    }
}

loop_topics!(bench_message);

/// The recorded messages of a bench's log, in file order.
pub struct BenchMessages {
    stream: LogStream,
}

impl Log {
    /// The messages that a bench records, in file order, one at a time.
    ///
    /// # Errors
    /// [`ReadError::Io`] when the file no longer exists.
    pub fn bench_messages(&self) -> Result<BenchMessages, ReadError> {
        Ok(BenchMessages { stream: self.stream()? })
    }
}

impl BenchMessages {
    /// Holes in the log, as far as the files read so far report them.
    pub fn holes(&self) -> Vec<Hole> {
        self.stream.holes().collect()
    }
}

impl Iterator for BenchMessages {
    type Item = Result<BenchMessage, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let raw = match self.stream.next() {
                Ok(raw) => raw?,
                Err(error) => return Some(Err(error)),
            };
            match BenchMessage::decode(&raw) {
                Ok(None) => {}
                Ok(Some(message)) => return Some(Ok(message)),
                Err(error) => return Some(Err(error)),
            }
        }
    }
}

/// The states that a setpoint requests, SI; NaN where a state is not tracked.
pub fn wanted(setpoint: &Setpoint) -> Vec<f64> {
    let tracked = |i: usize| i < 64 && setpoint.tracked >> i & 1 == 1;
    setpoint.x.iter().enumerate().map(|(i, x)| if tracked(i) { *x } else { f64::NAN }).collect()
}

/// Location of a vehicle's output in the messages of its sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SensorField {
    /// Topic of the sensor's messages.
    pub topic: &'static str,
    /// Offset of the value in the message, bytes.
    offset: usize,
    /// Offset of the byte of `valid` that holds the output's bit.
    valid_offset: usize,
    valid_bit: u8,
}

impl SensorField {
    /// Finds output `index` of a vehicle: by its name among the fields of [`Imu`] and [`Odometry`], or by its
    /// number in [`Outputs`]. `None` for an output that no message has room for.
    pub fn of(output: &str, index: usize) -> Option<Self> {
        Self::named::<Imu>(output).or_else(|| Self::named::<Odometry>(output)).or_else(|| {
            let offset_of = |name: &str| Outputs::FIELDS.iter().find(|f| f.name == name).map(|f| f.offset);
            (index < MAX_OUTPUTS).then_some(Self {
                topic: Outputs::TOPIC,
                offset: offset_of("y")? + index * size_of::<f64>(),
                valid_offset: offset_of("valid")? + index / 8,
                valid_bit: 1 << (index % 8),
            })
        })
    }

    fn named<M: Message>(output: &str) -> Option<Self> {
        let values: Vec<_> = M::FIELDS.iter().filter(|f| f.kind == "f64").collect();
        let index = values.iter().position(|f| f.name == output)?;
        let valid_offset = M::FIELDS.iter().find(|f| f.name == "valid")?.offset;
        // Both sensor messages have two groups of equal size. Messages are little-endian, so the first byte holds
        // both bits.
        let valid_bit = if 2 * index < values.len() { valid::FIRST } else { valid::SECOND } as u8;
        Some(Self { topic: M::TOPIC, offset: values[index].offset, valid_offset, valid_bit })
    }

    /// The value in a message of the field's topic, SI; NaN when it is not fresh.
    pub fn read<M: Message>(&self, message: &M) -> f64 {
        let bytes = bytemuck::bytes_of(message);
        if bytes[self.valid_offset] & self.valid_bit == 0 {
            return f64::NAN;
        }
        bytemuck::pod_read_unaligned(&bytes[self.offset..self.offset + 8])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_output_is_read_where_its_sensor_says_that_it_is_fresh() {
        let imu = Imu { roll: 0.1, pitch_rate: 0.2, valid: valid::FIRST, ..Imu::zeroed() };
        let field = |name: &str| SensorField::of(name, 3).unwrap();
        assert_eq!(field("roll").topic, Imu::TOPIC);
        assert_eq!(field("roll").read(&imu), 0.1);
        assert!(field("pitch_rate").read(&imu).is_nan());
        assert_eq!(field("lateral_speed").topic, Odometry::TOPIC);
        let mut outputs = Outputs { valid: 1 << 31 | 1 << 3, ..Outputs::zeroed() };
        (outputs.y[3], outputs.y[31]) = (290.0, 1.5);
        let at = |index: usize| SensorField::of("temperature", index).unwrap();
        assert_eq!((at(3).topic, at(3).read(&outputs), at(31).read(&outputs)), (Outputs::TOPIC, 290.0, 1.5));
        assert!(at(4).read(&outputs).is_nan());
        assert_eq!(SensorField::of("temperature", 32), None);
    }
}
