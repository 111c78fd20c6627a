//! The recorder: writes every topic into an MCAP file.
//!
//! It polls its queues at a steady pace instead of being woken by every message: it costs the loop no system
//! call, and a lockstep plant waits when it falls behind (see [`whirlstand_msgs::Progress`]).
//!
//! Each file holds a part of one uninterrupted run. A recorder that finds an existing `log.mcap` was
//! restarted and writes `log.2.mcap`, then `log.3.mcap`; so does a recorder when the step number goes back,
//! which means that the plant was restarted, when its file has reached its size or length, and after it could
//! not write for a time. It begins no more runs than the plant can have starts: further runs are refused and
//! counted.

mod log_files;
mod sink;
mod sync;
mod topic;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use whirlstand_bus::{Bus, Publisher};
use whirlstand_logs::{Channel, Panels};
use whirlstand_msgs::{Health, Message, NodeState, Progress};

use crate::clock::Turn;
use crate::config::{NodeConfig, Role};
use crate::error::NodeError;
use crate::peers::Peers;
use crate::setup::Setup;
use log_files::LogFiles;
use sink::Sink;
pub use topic::QUEUE_DEPTH;
use topic::Topics;

/// Time between two polls of the queues. At 100,000 steps/s a queue takes 10 ms to fill.
pub const POLL_PERIOD: Duration = Duration::from_millis(1);

/// Time between two polls in realtime, where messages are few and the loop must not be disturbed.
pub const POLL_PERIOD_REALTIME: Duration = Duration::from_millis(5);

/// Longest wait for the last messages of a run after the end was requested.
const LAST_MESSAGES: Duration = Duration::from_secs(2);

/// The recorder as a state machine.
pub struct Recorder {
    sink: Sink,
    topics: Topics,
    /// Channel of health messages; `None` while no file can be written.
    health: Option<Channel<Health>>,
    progress: Publisher<Progress>,
    peers: Peers,
    awaits: Vec<Role>,
    /// Step and count last reported to the plant.
    reported: Option<(u64, u64)>,
    refused: u64,
    /// Number of the plant's runs so far, and its maximum.
    runs: u32,
    most_runs: u32,
    /// True when a refused run was reported.
    refused_run: bool,
    stopping: Option<Instant>,
    ended: bool,
    period_ns: u64,
}

impl Recorder {
    /// Creates the log and opens the ports.
    ///
    /// # Errors
    /// The log cannot be created, or a port cannot be opened.
    pub fn open(bus: &Bus, config: &NodeConfig, setup: &Setup) -> Result<Self, NodeError> {
        let recorder = config.recorder.as_ref().ok_or_else(|| NodeError::Config {
            field: "recorder".into(),
            value: "nothing".into(),
            reason: "a recorder needs to know where to write".into(),
        })?;
        let files = LogFiles::new(config, recorder, setup);
        let panels = Panels::new(files.info(), switched(config, setup));
        let mut sink = Sink::open(files, panels)?;
        let listens_to: Vec<Role> = [Role::Plant, Role::Estimator, Role::Controller]
            .into_iter()
            .filter(|&r| r == Role::Plant || config.peers.contains(&r))
            .collect();
        Ok(Self {
            topics: Topics::open(bus, &mut sink)?,
            health: sink.channel(),
            progress: bus.publisher()?,
            peers: Peers::open(bus, Role::Recorder, listens_to.clone())?,
            awaits: listens_to,
            sink,
            reported: None,
            refused: 0,
            runs: 1,
            most_runs: recorder.most_runs,
            refused_run: false,
            stopping: None,
            ended: false,
            period_ns: config.period_ns,
        })
    }

    /// Writes the waiting messages.
    ///
    /// # Errors
    /// The transport fails; at the end, when the last part of the log could not be written.
    pub fn turn(&mut self, now: Instant) -> Result<Turn, NodeError> {
        if self.ended {
            return Ok(Turn::Ended);
        }
        if self.sink.is_file_due(now) && self.sink.begin_file() {
            self.move_to_file();
        }
        let taken = self.taken();
        // Truth first: its progress bounds the number of waiting messages of the other topics.
        for _ in 0..QUEUE_DEPTH {
            let Some(truth) = self.topics.truth.receive(&mut self.refused)? else { break };
            if self.topics.truth.step().is_some_and(|last| truth.head.step < last) {
                if self.runs >= self.most_runs {
                    self.refuse_run(truth.head.step);
                    continue;
                }
                self.begin_run();
            }
            self.topics.truth.write(&mut self.sink, &truth);
        }
        let reached = self.topics.truth.step();
        self.topics.drain_followers(&mut self.sink, &mut self.refused)?;
        while let Some(health) = self.peers.receive()? {
            self.peers.update(&health);
            self.sink.write(self.health.as_ref(), &health);
        }
        self.sink.flush_if_due(now);
        let worked = self.taken() != taken;
        self.tell(reached, self.sink.written())?;
        self.count();
        self.peers.turn(now)?;
        if let Some(until) = self.stopping {
            // One more poll receives messages that arrived during this one; a publisher that continues does
            // not prevent the log from being finished.
            if now >= until || !worked && self.has_all_of_the_run() {
                return self.finish();
            }
        }
        Ok(if worked { Turn::Worked } else { Turn::Idle })
    }

    /// Requests the end: messages on their way are written first.
    pub fn stop(&mut self, now: Instant) {
        self.stopping.get_or_insert(now + LAST_MESSAGES);
    }

    /// Number of messages missing in the log.
    pub fn lost(&self) -> u64 {
        self.topics.lost() + self.sink.missed()
    }

    /// Number of messages in the log, all files of this recorder together.
    pub fn written(&self) -> u64 {
        self.sink.written()
    }

    /// Number of messages received.
    fn taken(&self) -> u64 {
        self.sink.written() + self.sink.missed()
    }

    /// The health report of the recorder.
    pub fn health(&mut self) -> &Health {
        self.count();
        &self.peers.report
    }

    /// Files written so far and not removed.
    pub fn paths(&self) -> &[PathBuf] {
        self.sink.files().paths()
    }

    fn finish(&mut self) -> Result<Turn, NodeError> {
        self.peers.set_state(NodeState::Stopping);
        self.peers.publish(Instant::now())?;
        self.sink.write(self.health.as_ref(), &self.peers.report);
        self.ended = true;
        self.sink.finish()?;
        Ok(Turn::Ended)
    }

    /// True when the plant has reported its last step, and every topic has reached it.
    fn has_all_of_the_run(&self) -> bool {
        let Some(plant) = self.peers.health(Role::Plant) else { return false };
        let reached = |last: Option<u64>| last.is_some_and(|l| l >= plant.step);
        let awaits = |role| self.awaits.contains(&role);
        plant.state == Some(NodeState::Stopping)
            && reached(self.topics.imu.step())
            && reached(self.topics.truth.step())
            && (!awaits(Role::Estimator) || reached(self.topics.estimate.step()))
            && (!awaits(Role::Controller)
                || reached(self.topics.command.step()) && reached(self.topics.setpoint.step()))
    }

    /// Begins a new run after a restart of the plant.
    fn begin_run(&mut self) {
        self.runs += 1;
        self.topics.begin_run();
        self.sink.begin_run();
        if self.sink.begin_file() {
            tracing::warn!(path = %self.sink.files().current().display(), "the plant started a new run: next log file");
            self.move_to_file();
        }
    }

    fn move_to_file(&mut self) {
        self.topics.move_to(&mut self.sink);
        self.health = self.sink.channel();
    }

    /// Refuses a message of a run that the plant cannot have begun.
    fn refuse_run(&mut self, step: u64) {
        if !std::mem::replace(&mut self.refused_run, true) {
            tracing::warn!(
                step,
                starts = self.most_runs,
                "Truth restarts more often than the plant did: something else publishes it, and it is not recorded"
            );
        }
        self.refused = self.refused.saturating_add(1);
    }

    fn tell(&mut self, reached: Option<u64>, written: u64) -> Result<(), NodeError> {
        let step = reached.unwrap_or(0);
        // A report without written messages is useful too: it announces the recorder.
        let written = if reached.is_some() { written } else { 0 };
        if self.reported.is_some_and(|reported| reported.0 == step) {
            return Ok(());
        }
        self.reported = Some((step, written));
        let mut progress = Progress { written, lost: self.lost(), ..Progress::zeroed() };
        progress.head.step = step;
        progress.head.stamp_ns = step * self.period_ns;
        Ok(self.progress.send(&progress)?)
    }

    fn count(&mut self) {
        let (written, lost) = (self.sink.written(), self.lost());
        let report = &mut self.peers.report;
        report.head.step = self.topics.truth.step().unwrap_or(0);
        // Messages counted and then lost with their file are among the lost ones; a decreasing count would
        // indicate a restart.
        report.steps = report.steps.max(written);
        report.lost = lost;
        report.rejected = self.refused;
    }
}

/// Effects that can be switched in flight, by number from 1: those of the vehicle file first.
fn switched(config: &NodeConfig, setup: &Setup) -> BTreeMap<u32, String> {
    let all = setup.vehicle.effects.iter().chain(&config.effects);
    let numbered = (1..).zip(all).filter(|(_, effect)| !effect.window().is_always());
    numbered.map(|(number, effect)| (number, effect.told())).collect()
}
