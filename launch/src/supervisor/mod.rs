//! The supervisor: starts the nodes of a bench, waits for their readiness, restarts failed ones, and ends them in
//! order.
//!
//! Each of its actions responds to an event: a line on a pipe, a datagram on a notify socket, the end of a
//! process, a signal, a `Health` message, or a deadline that was set beforehand.

mod bench;
mod console;
mod guard;
mod health;
mod node;
mod notify;
mod process;
mod signals;
mod threaded;

#[cfg(test)]
mod tests;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use whirlstand_bus::{Bus, OpenError};

pub(crate) use bench::supervise;
pub(crate) use guard::{Guard, keep_guard};
pub(crate) use health::{Counts, HealthTable};
pub(crate) use process::CommandLine;
pub(crate) use signals::Signals;
pub(crate) use threaded::{ThreadEnd, supervise_thread};

/// How the launcher learns that a node is ready.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Readiness {
    /// By `READY=1` on its notify socket, within this time.
    Notify(Duration),
    /// By its start.
    Start,
}

/// Order in which nodes are asked to end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum StopStage {
    /// The plant: it brings its inputs to neutral.
    First,
    /// Everything between plant and recorder.
    Second,
    /// The recorder, so that the log contains all messages of the others.
    Last,
}

/// Description of one node: what to start, and how to supervise it.
#[derive(Debug, Clone)]
pub(crate) struct NodeSpec {
    /// Name in messages, in `Health` and in the launch file.
    pub name: String,
    /// The process.
    pub command: CommandLine,
    /// How the node becomes ready.
    pub readiness: Readiness,
    /// Most restarts after a failure.
    pub max_restarts: u32,
    /// Longest silence of a node that publishes `Health`.
    pub hang_timeout: Duration,
    /// Whether the node is a built-in one that publishes `Health` from its start.
    pub publishes_health: bool,
    /// Time from SIGTERM to SIGKILL.
    pub stop_timeout: Duration,
    /// Stage in which the node is asked to end.
    pub stop_stage: StopStage,
    /// Whether its end with exit code 0 ends the run.
    pub ends_run: bool,
    /// Whether the loop needs the node: an early end is then a failure, even with exit code 0.
    pub needed: bool,
}

/// Why and how a run ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Ending {
    /// The plant flew all its steps.
    Complete,
    /// A signal requested the end.
    Interrupted(i32),
    /// A node failed for good.
    Failed(NodeFailure),
}

/// A node that failed for good.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct NodeFailure {
    /// The node.
    pub node: String,
    /// How the node ended, such as "ended with exit code 1".
    pub how: String,
    /// Its last console lines.
    pub last_lines: Vec<String>,
    /// Whether the user can correct the failure: exit code 2, or the node could not be started.
    pub mendable: bool,
}

/// The result of a run, as the supervisor observed it.
#[derive(Debug, Clone)]
pub(crate) struct Outcome {
    pub ending: Ending,
    /// Restarts by node, in the order of the nodes; nodes without any are left out.
    pub restarts: Vec<(String, u32)>,
    /// Nodes that had to be killed at the end because they did not answer SIGTERM.
    pub killed_at_end: Vec<String>,
    pub health: HealthTable,
    /// Wall-clock time from the first start to the last end.
    pub wall: Duration,
}

/// Something that happened to a node.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Event {
    /// The node's process has started.
    Started { node: String, pid: u32 },
    /// The node is ready.
    Ready { node: String, pid: u32 },
    /// The node reported its status.
    Status { node: String, text: String },
    /// The node was restarted, with the reason.
    Restarted { node: String, how: String, attempt: u32, allowed: u32 },
    /// The node was killed because it did not end when asked.
    KilledAtEnd { node: String, after: Duration },
    /// The run begins to end.
    Ending(Ending),
}

/// An observer of a run, such as the progress line or the soak test.
pub(crate) trait Observer {
    /// A node wrote a line.
    fn line(&mut self, node: &str, line: &str);
    /// Something happened to a node.
    fn event(&mut self, event: &Event);
    /// Called at least every [`TICK`], and after every event.
    fn tick(&mut self, now: Instant, health: &HealthTable) -> Continuation;
    /// The launcher has joined the bench; no node runs yet.
    ///
    /// # Errors
    /// When the observer cannot join it too.
    fn opened(&mut self, _bus: &Bus) -> Result<(), OpenError> {
        Ok(())
    }
    /// The nodes have ended, and the observer must leave the bench.
    fn closed(&mut self) {}
}

/// Whether an observer lets the run go on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Continuation {
    /// The run goes on.
    GoOn,
    /// The run ends in order, as if the plant had flown all its steps.
    End,
}

/// Longest time between two reads of `Health` and between two calls of [`Observer::tick`].
pub(crate) const TICK: Duration = Duration::from_millis(50);

/// Source of `Health` messages, and the launcher's link to the bench.
pub(crate) trait HealthSource {
    /// The next received message.
    fn next(&mut self) -> Option<whirlstand_msgs::Health>;
    /// Addresses on which nodes can reach the launcher.
    fn locators(&self) -> Vec<String>;
    /// Publishes the addresses on which the bench can be reached from now on.
    fn reachable(&mut self, locators: &[String]);
    /// Reports that a node died, so that its resources on the bench can be released.
    fn node_died(&mut self);
}

/// Specification that is common to all nodes of a run.
#[derive(Debug, Clone)]
pub(crate) struct BenchSpec {
    /// The nodes, in the order in which they are started.
    pub nodes: Vec<NodeSpec>,
    /// Whether each node is started only when the one before is ready, and is given the addresses of those
    /// before (Zenoh).
    pub exchange_locators: bool,
    /// Names of nodes that are started elsewhere.
    pub external: Vec<String>,
    /// Folder for notify sockets.
    pub folder: PathBuf,
}
