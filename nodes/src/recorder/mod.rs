//! The recorder: every topic into an MCAP file.
//!
//! It looks at its queues at a steady pace instead of being woken by every message: nobody in the loop pays a
//! system call for it, and a lockstep plant waits when it falls behind (see [`whirlstand_msgs::Progress`]).
//!
//! Each file holds one uninterrupted run. A recorder that finds `log.mcap` in place was restarted and writes
//! `log.2.mcap`, then `log.3.mcap`; so does a recorder that sees the steps go back, which means that the plant
//! was restarted. It begins no more files than the plant can have starts: whatever else goes back is refused and counted.

mod log_files;
mod topic;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use whirlstand_bus::{Bus, Publisher};
use whirlstand_logs::{Channel, LogWriter};
use whirlstand_msgs::{Health, Message, NodeState, Progress};

use crate::clock::Turn;
use crate::config::{NodeConfig, Role};
use crate::error::NodeError;
use crate::peers::Peers;
use crate::setup::Setup;
use log_files::LogFiles;
pub use topic::QUEUE_DEPTH;
use topic::Topics;

/// Time between two polls of the queues. At 100,000 steps/s a queue takes 10 ms to fill.
pub const POLL_PERIOD: Duration = Duration::from_millis(1);

/// Time between two polls in realtime, where messages are few and the loop must not be disturbed.
pub const POLL_PERIOD_REALTIME: Duration = Duration::from_millis(5);

/// How long the last messages of a run may be on their way after the end was asked for.
const LAST_MESSAGES: Duration = Duration::from_secs(2);

/// The recorder as a state machine.
pub struct Recorder {
    files: LogFiles,
    log: Option<LogWriter>,
    topics: Topics,
    health: Channel<Health>,
    progress: Publisher<Progress>,
    peers: Peers,
    awaits: Vec<Role>,
    /// Step and count that were last reported to the plant.
    reported: Option<(u64, u64)>,
    written_before: u64,
    refused: u64,
    /// Whether a run that the plant cannot have begun was told of.
    refused_run: bool,
    stopping: Option<Instant>,
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
        let mut files = LogFiles::new(config, recorder, setup);
        let mut log = files.next()?;
        let listens_to: Vec<Role> = [Role::Plant, Role::Estimator, Role::Controller]
            .into_iter()
            .filter(|&r| r == Role::Plant || config.peers.contains(&r))
            .collect();
        Ok(Self {
            topics: Topics::open(bus, &mut log)?,
            health: log.channel()?,
            progress: bus.publisher()?,
            peers: Peers::open(bus, Role::Recorder, listens_to.clone())?,
            awaits: listens_to,
            files,
            log: Some(log),
            reported: None,
            written_before: 0,
            refused: 0,
            refused_run: false,
            stopping: None,
            period_ns: config.period_ns,
        })
    }

    /// Writes the messages that wait.
    ///
    /// # Errors
    /// The log cannot be written, or the transport fails.
    pub fn turn(&mut self, now: Instant) -> Result<Turn, NodeError> {
        let Some(mut log) = self.log.take() else { return Ok(Turn::Ended) };
        let before = log.messages();
        // Truth first: what it has reached bounds how much of the other topics can be waiting.
        for _ in 0..QUEUE_DEPTH {
            let Some(truth) = self.topics.truth.receive(&mut self.refused)? else { break };
            if self.topics.truth.step().is_some_and(|last| truth.head.step < last) {
                if self.files.are_all() {
                    self.refuse_run(truth.head.step);
                    continue;
                }
                log = self.begin_file(log)?;
            }
            self.topics.truth.write(&mut log, &truth)?;
        }
        let reached = self.topics.truth.step();
        self.topics.drain_followers(&mut log, &mut self.refused)?;
        while let Some(health) = self.peers.receive()? {
            self.peers.update(&health);
            log.write(&self.health, &health)?;
        }
        log.flush_if_due(now)?;
        let worked = log.messages() != before;
        self.tell(reached, self.written_before + log.messages())?;
        self.count(log.messages());
        self.peers.turn(now)?;
        self.log = Some(log);
        if let Some(until) = self.stopping {
            // One more look takes what came while this one was under way; whoever goes on publishing does not keep the
            // log from being finished.
            if now >= until || !worked && self.has_all_of_the_run() {
                return self.finish();
            }
        }
        Ok(if worked { Turn::Worked } else { Turn::Idle })
    }

    /// Asks for the end: what is still on its way is written first.
    pub fn stop(&mut self, now: Instant) {
        self.stopping.get_or_insert(now + LAST_MESSAGES);
    }

    /// Number of messages that never reached the log.
    pub fn lost(&self) -> u64 {
        self.topics.lost()
    }

    /// Number of messages in the log, all files of this recorder together.
    pub fn written(&self) -> u64 {
        self.written_before + self.log.as_ref().map_or(0, LogWriter::messages)
    }

    /// The health report of the recorder.
    pub fn health(&mut self) -> &Health {
        let written = self.log.as_ref().map_or(0, LogWriter::messages);
        self.count(written);
        &self.peers.report
    }

    /// The files written so far.
    pub fn paths(&self) -> &[PathBuf] {
        self.files.paths()
    }

    fn finish(&mut self) -> Result<Turn, NodeError> {
        self.peers.set_state(NodeState::Stopping);
        self.peers.publish(Instant::now())?;
        if let Some(mut log) = self.log.take() {
            log.write(&self.health, &self.peers.report)?;
            self.written_before += log.finish()?.messages;
        }
        Ok(Turn::Ended)
    }

    /// Whether the plant has said which step was the last, and every topic has reached it.
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

    fn begin_file(&mut self, log: LogWriter) -> Result<LogWriter, NodeError> {
        self.written_before += log.finish()?.messages;
        let mut log = self.files.next()?;
        tracing::warn!(path = %self.files.current().display(), "the plant began a new run: next log file");
        self.topics.move_to(&mut log)?;
        self.health = log.channel()?;
        Ok(log)
    }

    /// Leaves out a message that would begin a run which the plant cannot have begun.
    fn refuse_run(&mut self, step: u64) {
        if !std::mem::replace(&mut self.refused_run, true) {
            tracing::warn!(
                step,
                files = self.files.paths().len(),
                "Truth goes back more often than the plant was started: somebody else publishes it, and it is left out"
            );
        }
        self.refused = self.refused.saturating_add(1);
    }

    fn tell(&mut self, reached: Option<u64>, written: u64) -> Result<(), NodeError> {
        let step = reached.unwrap_or(0);
        // Nothing written is news as well: it says that a recorder is there.
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

    fn count(&mut self, written: u64) {
        let lost = self.lost();
        let report = &mut self.peers.report;
        report.head.step = self.topics.truth.step().unwrap_or(0);
        report.steps = self.written_before + written;
        report.lost = lost;
        report.rejected = self.refused;
    }
}
