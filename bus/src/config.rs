//! Configuration with which a node joins a bench.

use std::path::PathBuf;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::OpenError;
use crate::protection::Protection;
use crate::transport::Transport;

/// Longest name of a bench, a node or a topic, bytes: file names of shared memory are built from it.
pub const MAX_NAME: usize = 48;

/// Configuration with which a node joins a bench.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BusConfig {
    /// Name of the bench: letters, digits, `_`, `-` and `.`, at most [`MAX_NAME`] bytes. Benches of different
    /// names never meet.
    pub bench: String,
    /// Name of this node, with the same letters; for people and tools that inspect the bench.
    pub node: String,
    /// Transport of the messages.
    pub transport: Transport,
    /// Settings of [`Transport::Zenoh`], ignored by the others.
    #[serde(default)]
    pub zenoh: ZenohConfig,
    /// Waiting strategy of [`crate::Bus::wait_until`].
    #[serde(default)]
    pub wait: WaitStrategy,
}

impl BusConfig {
    /// Configuration of a node of a bench, with defaults for everything else.
    pub fn new(bench: impl Into<String>, node: impl Into<String>, transport: Transport) -> Self {
        Self {
            bench: bench.into(),
            node: node.into(),
            transport,
            zenoh: ZenohConfig::default(),
            wait: WaitStrategy::default(),
        }
    }
}

/// Zenoh endpoints of a node.
///
/// A node is a Zenoh peer without scouting. Peers do not forward for each other, so every node must be
/// connected to every other with which it exchanges messages: give each node its own `listen` endpoint and
/// let it `connect` to those of the nodes before it.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ZenohConfig {
    /// Endpoints to listen on, such as `tcp/127.0.0.1:7447`; port 0 takes a free one, told by
    /// [`crate::Bus::locators`]. Empty: those of `config`, or else `tcp/127.0.0.1:0`.
    pub listen: Vec<String>,
    /// Endpoints to connect to, retried until they answer. Empty: those of `config`.
    pub connect: Vec<String>,
    /// Zenoh's own configuration file (JSON5), merged over Whirlstand's defaults: TLS, access control,
    /// scouting and all else that Zenoh knows.
    pub config: Option<PathBuf>,
    /// Mutual TLS and access control of the bench; without it the bench is open to everybody who reaches it. See
    /// [`crate::ONE_THREAD`] for what the process needs.
    pub protection: Option<Protection>,
}

/// Waiting strategy of a node: it polls, then yields between polls, then sleeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WaitStrategy {
    /// Yield before the first poll: right after its own message a node has nothing to receive, and the
    /// answering node may need this CPU.
    pub give_way: bool,
    /// Number of polls before the first yield, with a processor pause in between.
    pub spin: u32,
    /// Duration of polling with a processor yield in between.
    pub yield_for: Duration,
    /// Longest sleep before the next poll without a wake-up: foreign publishers wake nobody.
    pub sleep: Duration,
    /// Over Zenoh: how long a sender waits for a congested link. After that it drops messages, without
    /// waiting again until the link is free.
    pub congestion: Duration,
}

impl WaitStrategy {
    /// Strategy for lockstep: yields long enough to hardly ever sleep inside a step, and loses nothing to a
    /// network that is temporarily slow.
    pub fn lockstep() -> Self {
        Self {
            give_way: true,
            spin: 0,
            yield_for: Duration::from_millis(1),
            sleep: Duration::from_millis(1),
            congestion: Duration::from_millis(200),
        }
    }

    /// Strategy for real time: sleeps soon, so that a node of high priority does not starve the others.
    pub fn realtime() -> Self {
        Self {
            give_way: false,
            spin: 20,
            yield_for: Duration::from_micros(5),
            sleep: Duration::from_millis(1),
            congestion: Duration::from_millis(1),
        }
    }

    /// Strategy for real time on a CPU that the awaited node has too: gives way at once.
    pub fn taking_turns() -> Self {
        Self { give_way: true, spin: 0, ..Self::realtime() }
    }
}

impl Default for WaitStrategy {
    fn default() -> Self {
        Self::realtime()
    }
}

/// Checks that a name is valid for a bench.
///
/// # Errors
/// [`OpenError::Name`].
pub fn check_bench_name(name: &str) -> Result<(), OpenError> {
    check_name("bench", name)
}

/// Checks that a name can be part of a file name, a service name and a key expression.
pub(crate) fn check_name(what: &'static str, name: &str) -> Result<(), OpenError> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
    let reason = if name.is_empty() {
        "it is empty".into()
    } else if name.len() > MAX_NAME {
        format!("it is {} bytes long, at most {MAX_NAME} are allowed", name.len())
    } else if let Some(c) = name.chars().find(|c| !allowed(*c)) {
        format!("{c:?} is not a letter, a digit, '_', '-' or '.'")
    } else {
        return Ok(());
    };
    Err(OpenError::Name { what, name: name.into(), reason })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_would_leave_their_folder_or_key_are_refused() {
        for name in ["", "a/b", "a*", "a b", "ä", "a~b", &"x".repeat(MAX_NAME + 1)] {
            let error = check_name("bench", name).unwrap_err().to_string();
            assert!(error.contains("bench") && error.contains(name), "{error}");
        }
        check_name("bench", "quadrotor-smc.2_x").unwrap();
    }
}
