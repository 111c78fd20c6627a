//! A recorded run, message by message, as the columns that figures and plots are made of.

use std::path::Path;

use whirlstand_logs::bench_log::wanted;
use whirlstand_logs::{BenchInfo, BenchMessage, Log, ReadError, SensorField};
use whirlstand_msgs::{
    Command, Disturbance, Estimate, Health, LATENCY_BUCKETS, Message, Setpoint, Truth, flags,
};
use whirlstand_vehicle::{Vehicle, VehicleError};

/// Why a run cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The log cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The log is of another program.
    #[error(
        "{path} is not a log of a bench: it has no metadata called whirlstand; use compare for foreign logs"
    )]
    NotABench {
        /// The log.
        path: String,
    },
    /// The vehicle file in the log is missing or cannot be used.
    #[error("{path} holds no vehicle file, so its signals have no names")]
    NoVehicle {
        /// The log.
        path: String,
    },
    /// The vehicle file in the log cannot be used.
    #[error("the vehicle file in {path} cannot be used: {source}")]
    Vehicle {
        /// The log.
        path: String,
        /// Why.
        source: Box<VehicleError>,
    },
}

/// Signals over a common time.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Columns {
    /// Bench time, s, ascending.
    pub t: Vec<f64>,
    /// One vector a signal, each as long as `t`.
    pub signals: Vec<Vec<f64>>,
}

impl Columns {
    fn new(signals: usize) -> Self {
        Self { t: Vec::new(), signals: vec![Vec::new(); signals] }
    }

    /// Appends a row. A row that is not later than the last one replaces what came after it: a node that was
    /// started again counts from its start.
    fn push(&mut self, t: f64, values: impl IntoIterator<Item = f64>) {
        if self.t.last().is_some_and(|last| *last >= t) {
            let keep = self.t.partition_point(|v| *v < t);
            self.t.truncate(keep);
            self.signals.iter_mut().for_each(|s| s.truncate(keep));
        }
        self.t.push(t);
        let mut values = values.into_iter();
        for signal in &mut self.signals {
            signal.push(values.next().unwrap_or(f64::NAN));
        }
    }

    /// True without a row.
    pub fn is_empty(&self) -> bool {
        self.t.is_empty()
    }
}

/// Health of one node as it was reported, one entry a report.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeHealth {
    /// Name of the node.
    pub node: String,
    /// Reports in the order of the log.
    pub reports: Vec<Health>,
}

/// A recorded run.
#[derive(Debug, Clone)]
pub struct Run {
    /// Name of the variant.
    pub name: String,
    /// Path of the log.
    pub log: String,
    /// Description of the bench from the log.
    pub info: BenchInfo,
    /// The vehicle.
    pub vehicle: Vehicle,
    /// Launch file, vehicle file and what else is inside the log: name and text.
    pub attachments: Vec<(String, String)>,
    /// True states, then applied inputs, SI, then flags.
    pub truth: Columns,
    /// Estimated states and their standard deviations, SI, then NIS, its degrees of freedom and flags.
    pub estimate: Columns,
    /// Setpoints of the states, NaN where a state is not tracked, then stick inputs, SI.
    pub setpoint: Columns,
    /// Commanded inputs, SI, then flags.
    pub command: Columns,
    /// Measured outputs in the vehicle's order, SI, each over its own time and without NaN.
    pub measured: Vec<Columns>,
    /// Disturbances of the derivatives of the states, SI, at every change.
    pub disturbance: Columns,
    /// Health of the nodes.
    pub health: Vec<NodeHealth>,
}

const NS: f64 = 1e-9;

impl Run {
    /// Reads the log of a run (file or folder) as variant `name`. Without `vehicle`, the vehicle file inside the
    /// log is used.
    ///
    /// # Errors
    /// [`RunError`].
    pub fn open(path: impl AsRef<Path>, name: &str, vehicle: Option<&Vehicle>) -> Result<Self, RunError> {
        let log = Log::open(path)?;
        let path = log.path().display().to_string();
        let info = log.info().ok_or_else(|| RunError::NotABench { path: path.clone() })?.clone();
        let vehicle = match (vehicle, log.vehicle_text()) {
            (Some(vehicle), _) => vehicle.clone(),
            (None, None) => return Err(RunError::NoVehicle { path }),
            (None, Some(text)) => Vehicle::parse(text, &info.vehicle).map_err(|source| {
                RunError::Vehicle { path: path.clone(), source: Box::new(source.into()) }
            })?,
        };
        let attachments = log
            .attached()
            .iter()
            .filter_map(|a| Some((a.name.clone(), String::from_utf8(a.data.clone()).ok()?)))
            .collect();
        let mut run = Self::empty(name, info, vehicle);
        run.log = path;
        run.attachments = attachments;
        for message in log.bench_messages()? {
            run.take(message?);
        }
        Ok(run)
    }

    /// A run without a message.
    pub(crate) fn empty(name: &str, info: BenchInfo, vehicle: Vehicle) -> Self {
        let (n, m) = (vehicle.states.len(), vehicle.inputs.len());
        Self {
            name: name.into(),
            log: String::new(),
            info,
            attachments: Vec::new(),
            truth: Columns::new(n + m + 1),
            estimate: Columns::new(2 * n + 3),
            setpoint: Columns::new(n + m),
            command: Columns::new(m + 1),
            measured: vec![Columns::new(1); vehicle.outputs.len()],
            disturbance: Columns::new(n),
            health: Vec::new(),
            vehicle,
        }
    }

    fn take(&mut self, message: BenchMessage) {
        match message {
            BenchMessage::Truth(m) => self.take_truth(&m),
            BenchMessage::Estimate(m) => self.take_estimate(&m),
            BenchMessage::Setpoint(m) => self.take_setpoint(&m),
            BenchMessage::Command(m) if m.flags & flags::WITHHELD != 0 => {}
            BenchMessage::Command(m) => self.take_command(&m),
            BenchMessage::Imu(m) => self.take_measured(&m),
            BenchMessage::Odometry(m) => self.take_measured(&m),
            BenchMessage::Outputs(m) => self.take_measured(&m),
            BenchMessage::Disturbance(m) => self.take_disturbance(&m),
            BenchMessage::Health(m) => self.take_health(m),
        }
    }

    fn take_truth(&mut self, m: &Truth) {
        let (n, inputs) = self.sizes();
        let row = m.x.iter().take(n).chain(m.u.iter().take(inputs)).copied();
        self.truth.push(m.head.stamp_ns as f64 * NS, row.chain([f64::from(m.flags)]));
    }

    pub(crate) fn take_estimate(&mut self, m: &Estimate) {
        let n = self.sizes().0;
        let row = m.x.iter().take(n).chain(m.std.iter().take(n)).copied();
        let rest = [m.nis, f64::from(m.dof), f64::from(m.flags)];
        self.estimate.push(m.head.stamp_ns as f64 * NS, row.chain(rest));
    }

    fn take_setpoint(&mut self, m: &Setpoint) {
        let (n, inputs) = self.sizes();
        let row = wanted(m).into_iter().take(n).chain(m.stick.iter().take(inputs).copied());
        self.setpoint.push(m.head.stamp_ns as f64 * NS, row);
    }

    fn take_command(&mut self, m: &Command) {
        let row = m.u.iter().take(self.sizes().1).copied();
        self.command.push(m.head.stamp_ns as f64 * NS, row.chain([f64::from(m.flags)]));
    }

    /// Takes what a sensor measured afresh.
    fn take_measured<M: Message>(&mut self, message: &M) {
        let t = message.head().stamp_ns as f64 * NS;
        for (i, (output, column)) in self.vehicle.outputs.iter().zip(&mut self.measured).enumerate() {
            let field = SensorField::of(&output.name, i).filter(|field| field.topic == M::TOPIC);
            if let Some(value) = field.map(|field| field.read(message)).filter(|value| !value.is_nan()) {
                column.push(t, [value]);
            }
        }
    }

    fn take_disturbance(&mut self, m: &Disturbance) {
        let row = m.dx.iter().take(self.sizes().0).copied();
        self.disturbance.push(m.head.stamp_ns as f64 * NS, row);
    }

    fn take_health(&mut self, m: Health) {
        let name = m.node_name();
        match self.health.iter_mut().find(|h| h.node == name) {
            Some(node) => node.reports.push(m),
            None => self.health.push(NodeHealth { node: name.into(), reports: vec![m] }),
        }
    }

    /// Numbers of states and inputs.
    fn sizes(&self) -> (usize, usize) {
        (self.vehicle.states.len(), self.vehicle.inputs.len())
    }

    /// Period of the loop, s.
    pub fn period_s(&self) -> f64 {
        self.info.period_ns as f64 * NS
    }

    /// Bench time of the last step, s.
    pub fn end_s(&self) -> f64 {
        let last = |c: &Columns| c.t.last().copied().unwrap_or(0.0);
        last(&self.truth).max(last(&self.estimate)).max(last(&self.command))
    }

    /// Output `i` of the states in `columns` (and of the applied inputs, where the vehicle has a direct term).
    pub fn output_of(&self, columns: &Columns, i: usize) -> Vec<f64> {
        let (c, d) = (self.vehicle.c.row(i), self.vehicle.d.row(i));
        let n = self.vehicle.states.len();
        let direct = std::ptr::eq(columns, &self.truth);
        (0..columns.t.len())
            .map(|k| {
                let states =
                    c.iter().zip(&columns.signals).filter(|(c, _)| **c != 0.0).map(|(c, x)| c * x[k]);
                let inputs =
                    d.iter().zip(columns.signals.iter().skip(n)).filter(|(d, _)| direct && **d != 0.0);
                states.sum::<f64>() + inputs.map(|(d, u)| d * u[k]).sum::<f64>()
            })
            .collect()
    }

    /// Wanted value of output `i` at every setpoint message; NaN where one of its states is not tracked.
    pub fn wanted(&self, i: usize) -> Vec<f64> {
        self.output_of(&self.setpoint, i)
    }

    /// The source, the times and the values of output `i` from the best signal in the log: truth, else estimate, else
    /// sensor.
    pub fn best(&self, i: usize) -> (&'static str, &[f64], Vec<f64>) {
        if !self.truth.is_empty() {
            ("truth", &self.truth.t, self.output_of(&self.truth, i))
        } else if !self.estimate.is_empty() {
            ("estimate", &self.estimate.t, self.output_of(&self.estimate, i))
        } else {
            ("measured", &self.measured[i].t, self.measured[i].signals[0].clone())
        }
    }

    /// Times during which a flag of [`Truth`] was set, s, and the number of steps.
    pub fn flagged(&self, flag: u32) -> (Vec<(f64, f64)>, u64) {
        let Some(column) = self.truth.signals.last() else { return (Vec::new(), 0) };
        let (mut spans, mut steps): (Vec<(f64, f64)>, u64) = (Vec::new(), 0);
        let period = self.period_s();
        for (t, _) in self.truth.t.iter().zip(column).filter(|(_, f)| **f as u32 & flag != 0) {
            steps += 1;
            match spans.last_mut() {
                Some((_, until)) if t - *until < 0.5 * period => *until = t + period,
                _ => spans.push((*t, t + period)),
            }
        }
        (spans, steps)
    }

    /// Number of steps in failsafe at the end of the run, without a break.
    pub fn failsafe_at_end(&self) -> u64 {
        let Some(column) = self.truth.signals.last() else { return 0 };
        column.iter().rev().take_while(|f| **f as u32 & flags::FAILSAFE != 0).count() as u64
    }

    /// True when the plant was in failsafe at least once.
    pub fn saw_failsafe(&self) -> bool {
        self.flagged(flags::FAILSAFE).1 > 0
    }
}

impl NodeHealth {
    /// The last report of each process of the node: a report with another process number, or with fewer steps than the
    /// one before, belongs to the next process.
    pub fn lives(&self) -> Vec<&Health> {
        let ends = self.reports.windows(2).filter(|w| w[1].pid != w[0].pid || w[1].steps < w[0].steps);
        ends.map(|w| &w[0]).chain(self.reports.last()).collect()
    }

    /// Latency histogram of all processes of the node together.
    pub fn histogram(&self) -> [u64; LATENCY_BUCKETS] {
        let mut sum = [0; LATENCY_BUCKETS];
        for life in self.lives() {
            for (s, c) in sum.iter_mut().zip(&life.latency) {
                *s += u64::from(*c);
            }
        }
        sum
    }
}
