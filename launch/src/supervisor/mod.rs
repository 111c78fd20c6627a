//! The supervisor: starts the nodes of a bench, waits for their readiness, restarts what fails, ends them in order.
//!
//! Everything it does answers an event: a line on a pipe, a datagram on a notify socket, the end of a process,
//! a signal, a `Health` message, or a deadline that was stated beforehand.

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
    /// By having started.
    Start,
}

/// When a node is asked to end, one stage after the other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum StopStage {
    /// The plant: it brings its inputs to neutral.
    First,
    /// Everything between plant and recorder.
    Second,
    /// The recorder, so that the log holds all that the others said.
    Last,
}

/// What to start as one node, and how to look after it.
#[derive(Debug, Clone)]
pub(crate) struct NodeSpec {
    /// Name in messages, in `Health` and in the launch file.
    pub name: String,
    /// The process.
    pub command: CommandLine,
    /// How it becomes ready.
    pub readiness: Readiness,
    /// How often it is restarted when it fails.
    pub max_restarts: u32,
    /// Longest silence of a node that publishes `Health`.
    pub hang_timeout: Duration,
    /// The node is one of ours and publishes `Health` from the start.
    pub publishes_health: bool,
    /// Time from SIGTERM to SIGKILL.
    pub stop_timeout: Duration,
    /// When it is asked to end.
    pub stop_stage: StopStage,
    /// Its end with exit code 0 is the end of the run.
    pub ends_run: bool,
    /// Without it there is no loop: ending early, even with exit code 0, is a failure.
    pub needed: bool,
}

/// Why and how a run ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Ending {
    /// The plant flew all its steps.
    Complete,
    /// A signal asked for the end.
    Interrupted(i32),
    /// A node failed for good.
    Failed(NodeFailure),
}

/// A node that failed for good.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct NodeFailure {
    /// The node.
    pub node: String,
    /// What happened to it: "ended with exit code 1".
    pub how: String,
    /// What it said last.
    pub last_lines: Vec<String>,
    /// The node said that the user can mend it (exit code 2, or it could not be started).
    pub mendable: bool,
}

/// What a run was like, from outside.
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
    /// Its process runs.
    Started { node: String, pid: u32 },
    /// It is ready.
    Ready { node: String, pid: u32 },
    /// It told its status.
    Status { node: String, text: String },
    /// It was restarted because of what happened.
    Restarted { node: String, how: String, attempt: u32, allowed: u32 },
    /// It was killed because it did not end when asked.
    KilledAtEnd { node: String, after: Duration },
    /// The run begins to end.
    Ending(Ending),
}

/// Whoever watches a run: the progress line, or the soak test.
pub(crate) trait Observer {
    /// A line that a node wrote.
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
    /// The nodes have ended: whatever of the observer is in the bench leaves it.
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

/// Longest time between two looks at `Health` and between two calls of [`Observer::tick`].
pub(crate) const TICK: Duration = Duration::from_millis(50);

/// Where `Health` comes from.
pub(crate) trait HealthSource {
    /// The next message that has arrived.
    fn next(&mut self) -> Option<whirlstand_msgs::Health>;
    /// Addresses on which nodes can reach the launcher.
    fn locators(&self) -> Vec<String>;
    /// The bench can be reached on these addresses from now on.
    fn reachable(&mut self, locators: &[String]);
    /// A node died: whatever it held on the bench can be taken away.
    fn node_died(&mut self);
}

/// What is common to all nodes of a run.
#[derive(Debug, Clone)]
pub(crate) struct BenchSpec {
    /// The nodes, in the order in which they are started.
    pub nodes: Vec<NodeSpec>,
    /// Start each node only when the one before is ready, and tell it the addresses of those before (Zenoh).
    pub exchange_locators: bool,
    /// Nodes that were started elsewhere.
    pub external: Vec<String>,
    /// Folder for notify sockets.
    pub folder: PathBuf,
}
