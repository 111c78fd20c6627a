//! A bench's log as a [`Record`]: step k of the loop is one point in time, and signals have the vehicle's names.
//!
//! | signal | from |
//! |---|---|
//! | outputs (`roll`, `roll_rate`, `lateral_speed`, ...) | `Imu`, `Odometry` and `Outputs`; NaN at steps where the sensor gave no fresh value |
//! | inputs (`u_roll`, ...) | `Truth`: what the plant applied from this step on; without `Truth`, the `Command` of the step before |
//! | `truth.NAME` | states of `Truth` |
//! | `estimate.NAME`, `estimate.std.NAME` | states of `Estimate` and their standard deviation |
//! | `setpoint.NAME` | states of `Setpoint` that are tracked; NaN at steps where they are not |
//! | `setpoint.stick.NAME` | stick of `Setpoint` |
//! | `command.NAME` | inputs of `Command`, at the step that it answers |
//! | `disturbance.NAME` | `Disturbance`, held from message to message |

use whirlstand_msgs::units::Unit;
use whirlstand_msgs::{Imu, Message, Odometry, Outputs, flags};

use crate::bench_info::{BenchInfo, SignalInfo};
use crate::bench_log::{BenchMessage, SensorField, wanted};
use crate::log::Log;
use crate::read_error::ReadError;
use crate::record::{Record, RecordError};

/// Why a log cannot be made a record.
#[derive(Debug, thiserror::Error)]
pub enum BenchRecordError {
    /// The log cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The log is of another program.
    #[error("{path} is not a log of a bench: it has no metadata called whirlstand")]
    NotABench {
        /// The log.
        path: String,
    },
    /// The signals do not fit together.
    #[error(transparent)]
    Record(#[from] RecordError),
}

/// Columns that one topic fills together.
struct Group {
    prefix: &'static str,
    signals: Vec<SignalInfo>,
    stamps: Vec<u64>,
    /// Row by row, one value a signal.
    values: Vec<f64>,
}

impl Group {
    fn new(prefix: &'static str, signals: &[SignalInfo]) -> Self {
        Self { prefix, signals: signals.to_vec(), stamps: Vec::new(), values: Vec::new() }
    }

    fn push(&mut self, stamp_ns: u64, values: &[f64]) {
        let used = values.iter().copied().chain(std::iter::repeat(f64::NAN)).take(self.signals.len());
        self.values.extend(used);
        self.stamps.push(stamp_ns);
    }

    /// One column a signal over the common axis. Of two rows with one stamp the later holds.
    fn columns(&self, axis: &[u64]) -> Vec<Vec<f64>> {
        let width = self.signals.len();
        let mut columns = vec![vec![f64::NAN; axis.len()]; width];
        let mut at = 0;
        for (stamp, row) in self.stamps.iter().zip(self.values.chunks(width.max(1))) {
            // Rows come in order but for a restart: look on from the last one first.
            if axis.get(at) != Some(stamp) {
                at = axis.partition_point(|t| t < stamp);
            }
            for (column, value) in columns.iter_mut().zip(row) {
                column[at] = *value;
            }
            at += 1;
        }
        columns
    }
}

/// All groups of a bench.
struct Groups {
    sensors: Vec<(Group, Vec<SensorField>)>,
    applied: Group,
    truth: Group,
    estimate: Group,
    deviation: Group,
    setpoint: Group,
    stick: Group,
    command: Group,
    disturbance: Group,
}

impl Groups {
    fn new(info: &BenchInfo) -> Self {
        let sensors = [Imu::TOPIC, Odometry::TOPIC, Outputs::TOPIC].map(|topic| {
            let (signals, fields): (Vec<_>, Vec<_>) = info
                .outputs
                .iter()
                .enumerate()
                .filter_map(|(i, o)| Some((o.clone(), SensorField::of(&o.name, i)?)))
                .filter(|(_, field)| field.topic == topic)
                .unzip();
            (Group::new("", &signals), fields)
        });
        let rates: Vec<_> =
            info.states.iter().map(|s| SignalInfo::new(&s.name, per_second(&s.unit))).collect();
        Self {
            sensors: sensors.into(),
            applied: Group::new("", &info.inputs),
            truth: Group::new("truth.", &info.states),
            estimate: Group::new("estimate.", &info.states),
            deviation: Group::new("estimate.std.", &info.states),
            setpoint: Group::new("setpoint.", &info.states),
            stick: Group::new("setpoint.stick.", &info.inputs),
            command: Group::new("command.", &info.inputs),
            disturbance: Group::new("disturbance.", &rates),
        }
    }

    fn take(&mut self, message: &BenchMessage) {
        match message {
            BenchMessage::Imu(m) => self.sensor(0, m),
            BenchMessage::Odometry(m) => self.sensor(1, m),
            BenchMessage::Outputs(m) => self.sensor(2, m),
            BenchMessage::Truth(m) => {
                self.truth.push(m.head.stamp_ns, &m.x);
                self.applied.push(m.head.stamp_ns, &m.u);
            }
            BenchMessage::Estimate(m) => {
                self.estimate.push(m.head.stamp_ns, &m.x);
                self.deviation.push(m.head.stamp_ns, &m.std);
            }
            BenchMessage::Setpoint(m) => {
                self.setpoint.push(m.head.stamp_ns, &wanted(m));
                self.stick.push(m.head.stamp_ns, &m.stick);
            }
            BenchMessage::Command(m) if m.flags & flags::WITHHELD != 0 => {}
            BenchMessage::Command(m) => self.command.push(m.head.stamp_ns, &m.u),
            BenchMessage::Disturbance(m) => self.disturbance.push(m.head.stamp_ns, &m.dx),
            BenchMessage::Health(_) => {}
        }
    }

    fn sensor<M: Message>(&mut self, index: usize, message: &M) {
        let (group, fields) = &mut self.sensors[index];
        let values: Vec<f64> = fields.iter().map(|f| f.read(message)).collect();
        group.push(message.head().stamp_ns, &values);
    }

    fn into_record(mut self, origin: String, period_ns: u64) -> Result<Record, RecordError> {
        if self.applied.stamps.is_empty() {
            // A real vehicle tells no truth: it applies Command k over [t_k+1, t_k+2).
            self.applied.values.clone_from(&self.command.values);
            self.applied.stamps = self.command.stamps.iter().map(|t| t.saturating_add(period_ns)).collect();
        }
        let held = self.disturbance;
        let groups: Vec<Group> = self
            .sensors
            .into_iter()
            .map(|(group, _)| group)
            .chain([self.applied, self.truth, self.estimate, self.deviation])
            .chain([self.setpoint, self.stick, self.command])
            .collect();
        let mut axis: Vec<u64> =
            groups.iter().chain([&held]).flat_map(|g| g.stamps.iter().copied()).collect();
        axis.sort_unstable();
        axis.dedup();
        let mut record = Record::new(origin, axis.iter().map(|ns| *ns as f64 / 1e9).collect())?;
        for group in groups.iter().chain([&held]).filter(|g| !g.stamps.is_empty()) {
            for (signal, mut values) in group.signals.iter().zip(group.columns(&axis)) {
                if group.prefix == held.prefix {
                    hold(&mut values, 0.0);
                }
                record.push(format!("{}{}", group.prefix, signal.name), &signal.unit, values)?;
            }
        }
        Ok(record)
    }
}

/// Replaces every gap by the value before it, `start` before the first.
fn hold(values: &mut [f64], start: f64) {
    let mut last = start;
    for value in values {
        if value.is_nan() {
            *value = last;
        } else {
            last = *value;
        }
    }
}

/// The unit of a derivative.
fn per_second(unit: &str) -> String {
    let text = if unit.is_empty() { "1/s".to_string() } else { format!("{unit}/s") };
    text.parse::<Unit>().map_or(text, |u| u.si_symbol())
}

/// Reads a log of a bench into one record.
///
/// # Errors
/// [`BenchRecordError`].
pub fn bench_record(log: &Log) -> Result<Record, BenchRecordError> {
    let origin = log.path().display().to_string();
    let info = log.info().ok_or_else(|| BenchRecordError::NotABench { path: origin.clone() })?;
    let mut groups = Groups::new(info);
    for message in log.bench_messages()? {
        groups.take(&message?);
    }
    Ok(groups.into_record(origin, info.period_ns)?)
}
