//! One node of a running bench: its process, its phase and its next deadline.

use std::io;
use std::path::Path;
use std::time::{Duration, Instant};

use rustix::process::Signal;
use whirlstand_msgs::Health;
use whirlstand_nodes::os::RESTARTS;

use crate::error::FINAL;

use super::console::{LineQuota, RecentLines};
use super::notify::{Notice, NotifySocket};
use super::process::{Process, ending};
use super::{NodeFailure, NodeSpec, Readiness};

/// Phase of a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Phase {
    /// Not started yet, or waiting to be restarted.
    Waiting,
    /// Started but not ready; it counts as failed after this time.
    Starting(Option<Instant>),
    /// Ready.
    Running,
    /// Asked to end; it is killed at this time.
    Stopping(Instant),
    /// Ended, and not to be restarted.
    Ended,
}

/// How a process ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct End {
    /// How the process ended, as text.
    pub how: String,
    /// True for exit code 0.
    pub well: bool,
    /// True for exit code 2: the user can correct the failure.
    pub mendable: bool,
    /// True for exit codes 2 and 3: a restart does not help.
    pub last: bool,
    /// True when the process ended before it was ready.
    pub before_ready: bool,
}

/// A node of a running bench.
#[derive(Debug)]
pub(crate) struct Node {
    pub spec: NodeSpec,
    pub phase: Phase,
    pub process: Option<Process>,
    pub restarts: u32,
    /// Addresses on which peers reach the node.
    pub locators: Vec<String>,
    /// Number of the present process, or of the last one.
    latest_pid: u32,
    /// When the present process became ready.
    pub ready_since: Option<Instant>,
    recent_lines: RecentLines,
    line_quota: LineQuota,
    /// Reason why the supervisor killed the process.
    blame: Option<String>,
}

impl Node {
    pub fn new(spec: NodeSpec) -> Self {
        Self {
            spec,
            phase: Phase::Waiting,
            process: None,
            restarts: 0,
            locators: Vec::new(),
            latest_pid: 0,
            ready_since: None,
            recent_lines: RecentLines::default(),
            line_quota: LineQuota::new(Instant::now()),
            blame: None,
        }
    }

    /// Starts the process; `connect` are the addresses of its peers.
    pub fn start(&mut self, folder: &Path, connect: &[String], now: Instant) -> io::Result<u32> {
        let mut line = self.spec.command.clone();
        if !connect.is_empty() {
            let own = line.env.iter_mut().find(|(name, _)| name == CONNECT);
            let all = own.as_ref().into_iter().flat_map(|(_, v)| v.split(',')).filter(|e| !e.is_empty());
            let mut all: Vec<String> = all.map(str::to_string).collect();
            all.extend(connect.iter().cloned());
            line.env.retain(|(name, _)| name != CONNECT);
            line.env.push((CONNECT.into(), all.join(",")));
        }
        line.env.push((RESTARTS.into(), self.restarts.to_string()));
        self.locators.clear();
        self.ready_since = None;
        self.blame = None;
        let socket = NotifySocket::bind(folder, &format!("{}.{}", self.spec.name, self.restarts))?;
        let process = Process::start(&line, socket)?;
        let pid = process.pid();
        self.latest_pid = pid;
        self.process = Some(process);
        self.phase = match self.spec.readiness {
            Readiness::Notify(limit) => Phase::Starting(Some(now + limit)),
            Readiness::Start => Phase::Starting(None),
        };
        Ok(pid)
    }

    /// Whether a process of this node is alive.
    pub fn is_alive(&self) -> bool {
        self.process.is_some()
    }

    /// The process number, 0 without a process.
    pub fn pid(&self) -> u32 {
        self.process.as_ref().map_or(0, Process::pid)
    }

    /// Whether a report in this node's name is its own: from its present process or, once that has ended, from its
    /// last one. A foreign program may report from any process that it starts.
    pub fn is_own(&self, health: &Health) -> bool {
        !self.spec.publishes_health || health.pid == self.latest_pid
    }

    /// Reads the messages of the node on its notify socket.
    pub fn notices(&mut self) -> Vec<Notice> {
        let notices = self.process.as_ref().map_or_else(Vec::new, |p| p.notify.drain());
        for notice in &notices {
            match notice {
                Notice::Locator(locator) if !self.locators.contains(locator) => {
                    self.locators.push(locator.clone());
                    // For a node that reports new addresses without end, the latest ones are kept.
                    if self.locators.len() > MOST_LOCATORS {
                        self.locators.remove(0);
                    }
                }
                _ => {}
            }
        }
        notices
    }

    /// The lines that the node wrote since the last call, within the limit for showing; the last lines are
    /// kept. `ended` is true when its process has ended.
    pub fn lines(&mut self, now: Instant, ended: bool) -> Vec<String> {
        let Some(process) = &mut self.process else { return Vec::new() };
        let mut lines = process.stderr.drain(now);
        lines.extend(process.stdout.drain(now));
        lines.iter().for_each(|line| self.recent_lines.push(line.clone()));
        self.line_quota.shown(lines, now, ended)
    }

    /// How the process ended, if it has ended. [`Node::release`] must follow, after its last lines are read.
    pub fn reap(&mut self) -> Option<End> {
        let status = self.process.as_mut()?.status()?;
        let how = self.blame.take().unwrap_or_else(|| ending(status));
        let before_ready = matches!(self.phase, Phase::Starting(_));
        let mendable = status.code() == Some(2);
        let last = mendable || status.code() == Some(i32::from(FINAL));
        Some(End { how, well: status.success(), mendable, last, before_ready })
    }

    /// Releases a process that has ended, and kills the processes that it started and left behind.
    pub fn release(&mut self) {
        self.process = None;
    }

    /// Asks the process to end, and continues it if it is stopped.
    pub fn ask_to_end(&mut self, now: Instant) {
        match &self.process {
            Some(process) if !matches!(self.phase, Phase::Stopping(_)) => {
                process.signal(Signal::TERM);
                process.signal(Signal::CONT);
                self.phase = Phase::Stopping(now + self.spec.stop_timeout);
            }
            Some(_) => {}
            None => self.phase = Phase::Ended,
        }
    }

    /// Kills the process. The reason `blame` is then reported as its end.
    pub fn kill(&mut self, blame: String) {
        if let Some(process) = &self.process {
            process.signal(Signal::KILL);
            self.blame = Some(blame);
        }
    }

    /// Whether the process has been killed and only needs to be reaped.
    pub fn is_condemned(&self) -> bool {
        self.blame.is_some()
    }

    /// The failure that ends the run.
    pub fn failure(&self, how: String, mendable: bool) -> NodeFailure {
        NodeFailure { node: self.spec.name.clone(), how, last_lines: self.recent_lines.lines(), mendable }
    }

    /// Time at which this node is killed unless an event comes first.
    pub fn deadline(&self) -> Option<Instant> {
        match self.phase {
            Phase::Starting(limit) => limit,
            Phase::Stopping(limit) => Some(limit),
            _ => None,
        }
    }
}

/// Most addresses of one node that are passed on to others.
const MOST_LOCATORS: usize = 32;

/// Environment variable with the addresses of a node's peers, separated by commas.
pub(crate) const CONNECT: &str = "WHIRLSTAND_ZENOH_CONNECT";

/// A time as text.
pub(crate) fn duration_text(time: Duration) -> String {
    format!("{} s", (time.as_secs_f64() * 1e3).round() / 1e3)
}
