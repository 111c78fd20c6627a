//! A bench's log as a [`Record`]: step k of the loop is one point in time, and signals have the vehicle's names.
//!
//! | signal | from |
//! |---|---|
//! | outputs (`roll`, `roll_rate`, `lateral_speed`, ...) | `Imu`, `Odometry` and `Outputs`; NaN at steps where the sensor gave no fresh value |
//! | inputs (`u_roll`, ...) | `Truth`: what the plant applied from this step on; of a real vehicle `Sent`: what acted while the controller was in charge, NaN while it was not, or the output did not leave; without both, the `Command` of the step before |
//! | `truth.NAME` | states of `Truth` |
//! | `estimate.NAME`, `estimate.std.NAME` | states of `Estimate` and their standard deviation |
//! | `setpoint.NAME` | states of `Setpoint` that are tracked; NaN at steps where they are not |
//! | `setpoint.stick.NAME` | stick of `Setpoint` |
//! | `command.NAME` | inputs of `Command`, at the step that it answers |
//! | `sent.in_charge` | `Sent`: 0 nobody, 1 the pilot, 2 the controller, 3 nobody after a failsafe; behind a bridge alone |
//! | `disturbance.NAME` | `Disturbance`, held from message to message |

use whirlstand_msgs::units::Unit;
use whirlstand_msgs::{Imu, MAX_INPUTS, Message, Odometry, Outputs, charge, flags};

use crate::bench_info::{BenchInfo, SignalInfo};
use crate::bench_log::{BenchMessage, SensorField, wanted};
use crate::log::Log;
use crate::read_error::ReadError;
use crate::record::{Record, RecordError};

/// Name of the signal that states who was in charge of a vehicle behind a bridge.
pub const IN_CHARGE: &str = "sent.in_charge";

/// The reason why a log cannot be made a record.
#[derive(Debug, thiserror::Error)]
pub enum BenchRecordError {
    /// The log cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The log is of another program.
    #[error("{path} is not a bench log: it has no metadata named whirlstand")]
    NotABench {
        /// The log.
        path: String,
    },
    /// The signals do not fit together.
    #[error(transparent)]
    Record(#[from] RecordError),
}

/// Columns that the messages of one topic fill together.
struct Group {
    prefix: &'static str,
    signals: Vec<SignalInfo>,
    /// Whether any of the columns is requested; otherwise no value is stored.
    kept: bool,
    stamps: Vec<u64>,
    /// Values row by row, one per signal.
    values: Vec<f64>,
}

impl Group {
    fn new(prefix: &'static str, signals: &[SignalInfo], asked: &dyn Fn(&str) -> bool) -> Self {
        let kept = signals.iter().any(|signal| asked(&format!("{prefix}{}", signal.name)));
        Self { prefix, signals: signals.to_vec(), kept, stamps: Vec::new(), values: Vec::new() }
    }

    fn push(&mut self, stamp_ns: u64, values: &[f64]) {
        if !self.kept {
            return;
        }
        let used = values.iter().copied().chain(std::iter::repeat(f64::NAN)).take(self.signals.len());
        self.values.extend(used);
        self.stamps.push(stamp_ns);
    }

    /// The column of one signal over the common time axis. Of two rows with the same stamp the later one
    /// holds.
    fn column(&self, signal: usize, axis: &[u64]) -> Vec<f64> {
        let mut column = vec![f64::NAN; axis.len()];
        let mut at = 0;
        for (stamp, row) in self.stamps.iter().zip(self.values.chunks(self.signals.len().max(1))) {
            // Rows are in order except after a restart, so the search begins at the last one.
            if axis.get(at) != Some(stamp) {
                at = axis.partition_point(|t| t < stamp);
            }
            column[at] = row[signal];
            at += 1;
        }
        column
    }
}

/// Every time at which the log has a message, ns, ascending.
#[derive(Default)]
struct Axis(Vec<u64>);

impl Axis {
    fn take(&mut self, stamp_ns: u64) {
        match self.0.last() {
            Some(last) if *last >= stamp_ns => {
                // Topics follow each other in the file, so most of these times exist already.
                if let Err(at) = self.0.binary_search(&stamp_ns) {
                    self.0.insert(at, stamp_ns);
                }
            }
            _ => self.0.push(stamp_ns),
        }
    }
}

/// All column groups of a bench.
struct Groups {
    axis: Axis,
    any_truth: bool,
    sent: Group,
    in_charge: Group,
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
    fn new(info: &BenchInfo, asked: &dyn Fn(&str) -> bool) -> Self {
        let sensors = [Imu::TOPIC, Odometry::TOPIC, Outputs::TOPIC].map(|topic| {
            let (signals, fields): (Vec<_>, Vec<_>) = info
                .outputs
                .iter()
                .enumerate()
                .filter_map(|(i, o)| Some((o.clone(), SensorField::of(&o.name, i)?)))
                .filter(|(_, field)| field.topic == topic)
                .unzip();
            (Group::new("", &signals, asked), fields)
        });
        let rates: Vec<_> =
            info.states.iter().map(|s| SignalInfo::new(&s.name, per_second(&s.unit))).collect();
        let group = |prefix, signals: &[SignalInfo]| Group::new(prefix, signals, asked);
        let (applied, command) = (group("", &info.inputs), group("command.", &info.inputs));
        Self {
            axis: Axis::default(),
            any_truth: false,
            sent: Group::new("", &info.inputs, asked),
            in_charge: Group::new("", &[SignalInfo::new(IN_CHARGE, "")], asked),
            sensors: sensors.into(),
            truth: group("truth.", &info.states),
            estimate: group("estimate.", &info.states),
            deviation: group("estimate.std.", &info.states),
            setpoint: group("setpoint.", &info.states),
            stick: group("setpoint.stick.", &info.inputs),
            // Without truth, commands are used for the applied inputs.
            command: Group { kept: command.kept || applied.kept, ..command },
            applied,
            disturbance: group("disturbance.", &rates),
        }
    }

    fn take(&mut self, message: &BenchMessage) {
        // A requested change is not a sample.
        let samples = !matches!(message, BenchMessage::Adjustment(_));
        if let Some(stamp_ns) = message.bench_ns().filter(|_| samples) {
            self.axis.take(stamp_ns);
        }
        match message {
            BenchMessage::Imu(m) => self.sensor(0, m),
            BenchMessage::Odometry(m) => self.sensor(1, m),
            BenchMessage::Outputs(m) => self.sensor(2, m),
            BenchMessage::Truth(m) => {
                self.any_truth = true;
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
            BenchMessage::Sent(m) => {
                self.in_charge.push(m.head.stamp_ns, &[f64::from(m.in_charge)]);
                // Commands of another pilot or controller are not inputs of this controller.
                let ours = m.in_charge == charge::CONTROLLER;
                self.sent.push(m.head.stamp_ns, if ours { &m.u } else { &[f64::NAN; MAX_INPUTS] });
            }
            BenchMessage::Reported(_)
            | BenchMessage::Autopilot(_)
            | BenchMessage::Finding(_)
            | BenchMessage::Adjustment(_)
            | BenchMessage::Health(_) => {}
        }
    }

    fn sensor<M: Message>(&mut self, index: usize, message: &M) {
        let (group, fields) = &mut self.sensors[index];
        let values: Vec<f64> = fields.iter().map(|f| f.read(message)).collect();
        group.push(message.head().stamp_ns, &values);
    }

    fn into_record(
        mut self,
        origin: String,
        period_ns: u64,
        asked: &dyn Fn(&str) -> bool,
    ) -> Result<Record, RecordError> {
        if !self.any_truth && !self.sent.stamps.is_empty() {
            std::mem::swap(&mut self.applied, &mut self.sent);
        } else if !self.any_truth {
            // A real vehicle has no truth: it applies Command k over [t_k+1, t_k+2).
            self.applied.values.clone_from(&self.command.values);
            self.applied.stamps = self.command.stamps.iter().map(|t| t.saturating_add(period_ns)).collect();
            self.applied.stamps.iter().for_each(|stamp| self.axis.take(*stamp));
        }
        let axis = self.axis.0;
        let held = self.disturbance.prefix;
        let mut record = Record::new(origin, axis.iter().map(|ns| *ns as f64 / 1e9).collect())?;
        let sensors = self.sensors.into_iter().map(|(group, _)| group);
        let groups = sensors.chain([self.applied, self.truth, self.estimate, self.deviation]).chain([
            self.setpoint,
            self.stick,
            self.command,
            self.in_charge,
            self.disturbance,
        ]);
        for group in groups.filter(|group| !group.stamps.is_empty()) {
            for (i, signal) in group.signals.iter().enumerate() {
                let name = format!("{}{}", group.prefix, signal.name);
                if !asked(&name) {
                    continue;
                }
                let mut values = group.column(i, &axis);
                if group.prefix == held {
                    hold(&mut values, 0.0);
                }
                record.push(name, &signal.unit, values)?;
            }
        }
        Ok(record)
    }
}

/// Replaces every gap by the value before it, and by `start` before the first value.
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
    bench_record_of(log, &|_| true)
}

/// As [`bench_record`], but only with the signals whose names are `asked` for; the others take no memory. The
/// times are those of the whole log.
///
/// # Errors
/// [`BenchRecordError`].
pub fn bench_record_of(log: &Log, asked: &dyn Fn(&str) -> bool) -> Result<Record, BenchRecordError> {
    let origin = log.path().display().to_string();
    let info = log.info().ok_or_else(|| BenchRecordError::NotABench { path: origin.clone() })?;
    let mut groups = Groups::new(info, asked);
    for message in log.bench_messages()? {
        groups.take(&message?);
    }
    Ok(groups.into_record(origin, info.period_ns, asked)?)
}
