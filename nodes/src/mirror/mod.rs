//! The mirror: monitors the flight beside the loop and reports when the vehicle differs from its file.
//!
//! It compares the flight with the vehicle model of law and filter, with the disturbances that the launch
//! file declares: other effects of the launch file are what it has to find. It polls its queues at a steady
//! pace, like the recorder, so that it costs the loop nothing, and only nodes that request it react to it
//! (`on_finding = "failsafe"`).

mod check;
mod declared;
mod inputs;
mod laws;
mod message;

use std::time::Instant;

use whirlstand_bus::{Bus, Publisher, Subscriber};
use whirlstand_logs::finding_text::finding_text;
use whirlstand_mirror::{Mirror as Watcher, Options, Sample};
use whirlstand_msgs::{
    Adjustment, AdjustmentKind, AdjustmentVerdict, Finding, Head, Health, Imu, MAX_OUTPUTS, Message,
    NodeState, Odometry, Outputs, Progress,
};
use whirlstand_vehicle::Engine;

use crate::clock::Turn;
use crate::companion::Companion;
use crate::config::{NodeConfig, OnFinding, Role};
use crate::error::NodeError;
use crate::peers::Peers;
use crate::ports::receive;
use crate::setup::Setup;
use crate::signals::{Measurement, OutputMap};
use declared::declared;
use inputs::{Acting, Inputs};
use laws::Laws;
use message::message;

/// Queue length of each topic.
pub const QUEUE_DEPTH: usize = 1024;

/// Topic on which it reports its progress.
pub const PACE_TOPIC: &str = "mirrored";

/// Number of steps between two progress reports.
const PACE: u64 = 16;

/// The mirror as a state machine.
pub struct Mirror {
    watcher: Watcher,
    outputs_of: Vec<String>,
    map: OutputMap,
    imus: Subscriber<Imu>,
    odometry: Companion<Odometry>,
    outputs: Companion<Outputs>,
    adjusted: Subscriber<Adjustment>,
    inputs: Inputs,
    findings: Publisher<Finding>,
    laws: Option<Laws>,
    progress: Publisher<Progress>,
    peers: Peers,
    period_ns: u64,
    /// A measurement that waits for its companion messages, and the number of turns so far.
    pending: Option<(Imu, u32)>,
    step: Option<u64>,
    steps: u64,
    refused: u64,
    stopping: bool,
}

/// Number of turns for which a measurement waits for its inputs and the other sensors before it is left out.
const PATIENCE: u32 = 40;

impl Mirror {
    /// Prepares the predictor and opens the ports.
    ///
    /// # Errors
    /// [`NodeError`] for a vehicle that cannot be mirrored, or ports that cannot be opened.
    pub fn open(bus: &Bus, config: &NodeConfig, setup: &Setup) -> Result<Self, NodeError> {
        let Some(options) = config.mirror else {
            return Err(NodeError::Config {
                field: "mirror".into(),
                value: "nothing".into(),
                reason: "a mirror flies where the launch file has [mirror]".into(),
            });
        };
        let changes_laws = options.on_finding == OnFinding::Law;
        let real = config.bridge.as_ref().is_some_and(|b| b.kind.is_vehicle());
        let vehicle = declared(setup, config)?;
        let period_s = Setup::period_s(config);
        let options = Options::new(config.plant.engine.into(), real, period_s);
        let watcher = Watcher::new(&vehicle, period_s, &options).map_err(|e| setup.refuse("a mirror", &e))?;
        Ok(Self {
            outputs_of: vehicle.outputs.iter().map(|o| o.name.clone()).collect(),
            watcher,
            map: setup.map.clone(),
            imus: bus.subscriber(QUEUE_DEPTH)?,
            odometry: Companion::open(bus, setup.map.has_odometry(), QUEUE_DEPTH)?,
            outputs: Companion::open(bus, setup.map.has_outputs(), QUEUE_DEPTH)?,
            adjusted: bus.subscriber(QUEUE_DEPTH)?,
            inputs: Inputs::open(bus, setup.limits, real, QUEUE_DEPTH)?,
            findings: bus.publisher()?,
            laws: changes_laws.then(|| Laws::new(config, setup)),
            progress: bus.publisher_on(PACE_TOPIC)?,
            peers: Peers::open(bus, Role::Mirror, vec![Role::Plant])?,
            period_ns: config.period_ns,
            pending: None,
            step: None,
            steps: 0,
            refused: 0,
            stopping: false,
        })
    }

    /// Processes waiting messages.
    ///
    /// # Errors
    /// The transport fails.
    pub fn turn(&mut self, now: Instant) -> Result<Turn, NodeError> {
        let mut worked = false;
        self.take_adjustments()?;
        for _ in 0..QUEUE_DEPTH {
            let Some((imu, turns)) = self.next()? else { break };
            if self.laws.as_ref().is_some_and(|laws| laws.is_late(imu.head.step)) {
                self.pending = Some((imu, turns));
                break;
            }
            if !self.take(&imu)? && turns < PATIENCE && !self.stopping {
                self.pending = Some((imu, turns + 1));
                break;
            }
            worked = true;
        }
        self.count();
        self.peers.turn(now)?;
        if self.stopping {
            self.tell(self.step.unwrap_or(0))?;
            self.peers.set_state(NodeState::Stopping);
            self.peers.publish(now)?;
            return Ok(Turn::Ended);
        }
        Ok(if worked { Turn::Worked } else { Turn::Idle })
    }

    /// Requests the end.
    pub fn stop(&mut self) {
        self.stopping = true;
    }

    /// The health report.
    pub fn health(&mut self) -> &Health {
        self.count();
        &self.peers.report
    }

    fn next(&mut self) -> Result<Option<(Imu, u32)>, NodeError> {
        if let Some(pending) = self.pending.take() {
            return Ok(Some(pending));
        }
        Ok(receive(&mut self.imus, &mut self.refused)?.map(|imu| (imu, 0)))
    }

    /// Processes a measurement; false when a companion message has not arrived yet.
    fn take(&mut self, imu: &Imu) -> Result<bool, NodeError> {
        let step = imu.head.step;
        match self.step {
            // A repeated measurement.
            Some(last) if step == last => return Ok(true),
            Some(last) if step < last => {
                tracing::warn!(step, "the plant started a new run: the mirror restarts");
                self.inputs.restart();
                self.watcher.restart();
                if let Some(laws) = &mut self.laws {
                    laws.restart();
                }
            }
            _ => {}
        }
        self.odometry.take(step, &mut self.refused)?;
        self.outputs.take(step, &mut self.refused)?;
        let u = match self.inputs.acting(imu, &mut self.refused)? {
            Acting::Known(u) => u,
            Acting::Coming => return Ok(false),
            Acting::Lost => {
                // The inputs are unknown, so that no prediction is possible: it restarts.
                self.watcher.restart();
                self.done(step)?;
                return Ok(true);
            }
        };
        if !(self.odometry.has_reached(step) && self.outputs.has_reached(step)) {
            self.inputs.take_back();
            return Ok(false);
        }
        let measurement =
            Measurement { imu: *imu, odometry: self.odometry.at(step), outputs: self.outputs.at(step) };
        let count = self.outputs_of.len();
        let (mut y, mut fresh) = ([0.0; MAX_OUTPUTS], [false; MAX_OUTPUTS]);
        let clean = self.map.read(&measurement, &mut y[..count], &mut fresh[..count]);
        self.refused += u64::from(!clean);
        let fresh = fresh[..count].iter().enumerate().fold(0, |bits, (i, f)| bits | u64::from(*f) << i);
        let inputs = self.inputs.count();
        let found = self.watcher.observe(&Sample { step, y: &y[..count], fresh, u: &u[..inputs] });
        if let Some(found) = found {
            let mut finding = message(&found, self.watcher.vehicle(), self.period_ns);
            finding.head = Head { seq: 0, ..imu.head };
            if let Some(laws) = &mut self.laws {
                laws.hear(&finding);
            }
            self.say(&finding)?;
        }
        if let Some(laws) = &mut self.laws
            && let Some(law) = laws.turn(imu.head)?
        {
            self.say(&law)?;
        }
        self.done(step)?;
        Ok(true)
    }

    fn say(&mut self, finding: &Finding) -> Result<(), NodeError> {
        let units = self.watcher.vehicle().shown_units();
        let names: Vec<&str> = self.outputs_of.iter().map(String::as_str).collect();
        tracing::warn!("{}", finding_text(finding, &names, &units).unwrap_or_default());
        Ok(self.findings.send(finding)?)
    }

    fn done(&mut self, step: u64) -> Result<(), NodeError> {
        self.step = Some(step);
        self.steps += 1;
        if step.is_multiple_of(PACE) { self.tell(step) } else { Ok(()) }
    }

    /// Reports the progress, so that a plant in lockstep waits for it.
    fn tell(&mut self, step: u64) -> Result<(), NodeError> {
        let mut progress = Progress { written: self.steps, ..Progress::zeroed() };
        (progress.head.step, progress.head.stamp_ns) = (step, step * self.period_ns);
        Ok(self.progress.send(&progress)?)
    }

    /// Receives requested changes that the predictor may know: the engine. Gusts and effects are what it has
    /// to find.
    fn take_adjustments(&mut self) -> Result<(), NodeError> {
        while let Some(m) = receive(&mut self.adjusted, &mut self.refused)? {
            if m.what == AdjustmentKind::Engine as u32 && m.verdict == AdjustmentVerdict::Done as u32 {
                let engines = [Engine::Off, Engine::On, Engine::Flying];
                if let Some(engine) = engines.get(m.value as usize) {
                    self.watcher.set_engine(*engine);
                }
            }
        }
        Ok(())
    }

    fn count(&mut self) {
        let lost = [self.imus.lost(), self.odometry.lost(), self.outputs.lost(), self.inputs.lost()];
        let report = &mut self.peers.report;
        report.head.step = self.step.unwrap_or(0);
        report.steps = self.steps;
        report.lost = lost.into_iter().fold(0, u64::saturating_add);
        report.rejected = self.refused;
    }
}
