//! What can go wrong on the bus, one error type an operation.

use std::path::PathBuf;

use whirlstand_msgs::DecodeError;

/// Why a bench, a publisher or a subscriber could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// A name cannot be part of a file name or a key expression.
    #[error("the {what} name \"{name}\" cannot be used: {reason}")]
    Name {
        /// `bench`, `node` or `topic`.
        what: &'static str,
        /// The name.
        name: String,
        /// What is wrong with it.
        reason: String,
    },
    /// Somebody on the bench uses the topic with another version of the message.
    #[error(
        "topic \"{topic}\" of bench \"{bench}\" is in use with schema {found}, this program has {expected:#018x} for {type_name}: \
         all nodes of a bench must run the same message version"
    )]
    Schema {
        /// Bench.
        bench: String,
        /// Topic.
        topic: String,
        /// Message type in this program.
        type_name: &'static str,
        /// Schema hash in this program.
        expected: u64,
        /// Schema hash in use, or what else was found in its place.
        found: String,
    },
    /// The subscriber's queue has an impossible length.
    #[error("a subscriber's queue holds 1 to {max} messages, {depth} were asked for on topic \"{topic}\"")]
    Depth {
        /// Topic.
        topic: String,
        /// Wanted length.
        depth: usize,
        /// Greatest length.
        max: usize,
    },
    /// A file of the bench, or Zenoh's configuration file, cannot be used.
    #[error("{path}: {source}", path = path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the operating system says.
        source: std::io::Error,
    },
    /// Zenoh's configuration is not understood.
    #[error("Zenoh configuration{}: {reason}", path.as_ref().map(|p| format!(" {}", p.display())).unwrap_or_default())]
    ZenohConfig {
        /// The configuration file, if there is one.
        path: Option<PathBuf>,
        /// What is wrong with it.
        reason: String,
    },
    /// The process would read and write TLS on two threads.
    #[error(
        "bench \"{bench}\" speaks TLS, which Zenoh 1.10 can do without damage to its memory on one thread only: start this \
         program with {name}='{value}' in its environment", name = crate::ONE_THREAD.0, value = crate::ONE_THREAD.1
    )]
    TwoThreads {
        /// Bench.
        bench: String,
    },
    /// Somebody else launches the bench.
    #[error(
        "the bench \"{bench}\" is already run by {holder}: give this run another name with --bench, or wait for that one's end"
    )]
    Taken {
        /// Bench.
        bench: String,
        /// Who launches it.
        holder: String,
    },
    /// Shared memory has no room for the bench.
    #[error(
        "shared memory is full: {what} of bench \"{bench}\" needs {needed}, /dev/shm has {free} free of {total}. \
         See what fills it with `ls -l /dev/shm` (`whirlstand clean` removes what killed benches left), or make it larger: \
         `mount -o remount,size=256M /dev/shm`, in a container `--shm-size=256m`",
        needed = mebibytes(*needed), free = mebibytes(*free), total = mebibytes(*total)
    )]
    Full {
        /// What was to be made.
        what: String,
        /// Bench.
        bench: String,
        /// Bytes that it takes, with the margin that stays free.
        needed: u64,
        /// Bytes that are free.
        free: u64,
        /// Bytes of the whole.
        total: u64,
    },
    /// The transport refused.
    #[error("cannot {action} on bench \"{bench}\" over {transport}: {reason}")]
    Transport {
        /// What was tried.
        action: String,
        /// Bench.
        bench: String,
        /// Transport.
        transport: crate::Transport,
        /// What the transport says.
        reason: String,
    },
}

/// An amount of memory as text.
fn mebibytes(bytes: u64) -> String {
    format!("{:.1} MiB", bytes as f64 / f64::from(1 << 20))
}

/// Why a message was not sent.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("cannot publish on topic \"{topic}\": {reason}")]
pub struct SendError {
    /// Topic.
    pub topic: String,
    /// What the transport says.
    pub reason: String,
}

/// Why nothing could be received.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RecvError {
    /// A message of another version, or a damaged one, arrived. It is dropped; receiving can go on.
    #[error("topic \"{topic}\": {source}")]
    Refused {
        /// Topic.
        topic: String,
        /// What is wrong with the message.
        source: Refusal,
    },
    /// The transport failed.
    #[error("cannot receive on topic \"{topic}\": {reason}")]
    Transport {
        /// Topic.
        topic: String,
        /// What the transport says.
        reason: String,
    },
}

/// Why a message that arrived is not handed over.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// It has another version, or is damaged.
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// It speaks for a node that did not send it.
    #[error("a message that says it is from \"{said}\" came from \"{from}\"")]
    Speaker {
        /// Whom the message names.
        said: String,
        /// Who sent it.
        from: String,
    },
}

/// Why the remains of a bench could not be removed.
#[derive(Debug, thiserror::Error)]
pub enum ResidueError {
    /// The bench's name is impossible.
    #[error(transparent)]
    Name(OpenError),
    /// A file could not be listed or removed.
    #[error("cannot remove {path}: {source}", path = path.display())]
    File {
        /// The file or folder.
        path: PathBuf,
        /// What the operating system says.
        source: std::io::Error,
    },
    /// iceoryx2 could not list the nodes.
    #[error("cannot list the nodes of bench \"{bench}\": {reason}")]
    List {
        /// Bench.
        bench: String,
        /// What iceoryx2 says.
        reason: String,
    },
}

/// Remains that stop a node from joining.
impl From<ResidueError> for OpenError {
    fn from(error: ResidueError) -> Self {
        match error {
            ResidueError::Name(error) => error,
            ResidueError::File { path, source } => Self::File { path, source },
            ResidueError::List { bench, reason } => Self::Transport {
                action: "list the nodes".into(),
                bench,
                transport: crate::Transport::Iceoryx2,
                reason,
            },
        }
    }
}
