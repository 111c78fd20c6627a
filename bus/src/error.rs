//! Errors of the bus, one type per operation.

use std::path::PathBuf;

use whirlstand_msgs::DecodeError;

/// Reason why a bench, a publisher or a subscriber could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// A name cannot be part of a file name or a key expression.
    #[error("the {what} name \"{name}\" cannot be used: {reason}")]
    Name {
        /// Kind of name: `bench`, `node` or `topic`.
        what: &'static str,
        /// The name.
        name: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The topic is in use with another version of the message.
    #[error(
        "topic \"{topic}\" of bench \"{bench}\" is in use with schema {found}, this program has {expected:#018x} for {type_name}: \
         all nodes of a bench must run the same message version"
    )]
    Schema {
        /// Name of the bench.
        bench: String,
        /// Name of the topic.
        topic: String,
        /// Message type in this program.
        type_name: &'static str,
        /// Schema hash in this program.
        expected: u64,
        /// Schema hash in use, or a description of another conflict.
        found: String,
    },
    /// The subscriber's queue has an impossible length.
    #[error("a subscriber's queue holds 1 to {max} messages, {depth} were asked for on topic \"{topic}\"")]
    Depth {
        /// Name of the topic.
        topic: String,
        /// Requested length.
        depth: usize,
        /// Largest length.
        max: usize,
    },
    /// A file of the bench, or Zenoh's configuration file, cannot be used.
    #[error("{path}: {source}", path = path.display())]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// Zenoh's configuration is invalid.
    #[error("Zenoh configuration{}: {reason}", path.as_ref().map(|p| format!(" {}", p.display())).unwrap_or_default())]
    ZenohConfig {
        /// The configuration file, if there is one.
        path: Option<PathBuf>,
        /// What is wrong with it.
        reason: String,
    },
    /// The process would access TLS from two threads.
    #[error(
        "bench \"{bench}\" speaks TLS, which Zenoh 1.10 can do without damage to its memory on one thread only: start this \
         program with {name}='{value}' in its environment", name = crate::ONE_THREAD.0, value = crate::ONE_THREAD.1
    )]
    TwoThreads {
        /// Name of the bench.
        bench: String,
    },
    /// Another process launches the bench.
    #[error(
        "the bench \"{bench}\" is already run by {holder}: give this run another name with --bench, or wait for that one's end"
    )]
    Taken {
        /// Name of the bench.
        bench: String,
        /// The other launcher.
        holder: String,
    },
    /// Shared memory is too small for the bench.
    #[error(
        "shared memory is full: {what} of bench \"{bench}\" needs {needed}, /dev/shm has {free} free of {total}. \
         See what fills it with `ls -l /dev/shm` (`whirlstand clean` removes what killed benches left), or make it larger: \
         `mount -o remount,size=256M /dev/shm`, in a container `--shm-size=256m`",
        needed = mebibytes(*needed), free = mebibytes(*free), total = mebibytes(*total)
    )]
    Full {
        /// Object that was to be created.
        what: String,
        /// Name of the bench.
        bench: String,
        /// Bytes needed, including the margin that stays free.
        needed: u64,
        /// Free bytes.
        free: u64,
        /// Total bytes.
        total: u64,
    },
    /// The transport failed.
    #[error("cannot {action} on bench \"{bench}\" over {transport}: {reason}")]
    Transport {
        /// Attempted action.
        action: String,
        /// Name of the bench.
        bench: String,
        /// Transport that failed.
        transport: crate::Transport,
        /// Error of the transport.
        reason: String,
    },
}

/// An amount of memory as text.
fn mebibytes(bytes: u64) -> String {
    format!("{:.1} MiB", bytes as f64 / f64::from(1 << 20))
}

/// Reason why a message was not sent.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("cannot publish on topic \"{topic}\": {reason}")]
pub struct SendError {
    /// Name of the topic.
    pub topic: String,
    /// Error of the transport.
    pub reason: String,
}

/// Reason why receiving failed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RecvError {
    /// A message of another version, or a damaged one, arrived. It is dropped; receiving can continue.
    #[error("topic \"{topic}\": {source}")]
    Refused {
        /// Name of the topic.
        topic: String,
        /// Reason for the refusal.
        source: Refusal,
    },
    /// The transport failed.
    #[error("cannot receive on topic \"{topic}\": {reason}")]
    Transport {
        /// Name of the topic.
        topic: String,
        /// Error of the transport.
        reason: String,
    },
}

/// Reason why a received message is not delivered.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// It has another version, or is damaged.
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// The message claims to be from another node than its sender.
    #[error("a message that says it is from \"{said}\" came from \"{from}\"")]
    Speaker {
        /// Node named in the message.
        said: String,
        /// Node that sent the message.
        from: String,
    },
}

/// Reason why leftover files of a bench could not be removed.
#[derive(Debug, thiserror::Error)]
pub enum ResidueError {
    /// The name of the bench is invalid.
    #[error(transparent)]
    Name(OpenError),
    /// A file could not be listed or removed.
    #[error("cannot remove {path}: {source}", path = path.display())]
    File {
        /// Path of the file or folder.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// iceoryx2 could not list the nodes.
    #[error("cannot list the nodes of bench \"{bench}\": {reason}")]
    List {
        /// Name of the bench.
        bench: String,
        /// Error of iceoryx2.
        reason: String,
    },
}

/// Leftover files that prevent a node from joining.
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
