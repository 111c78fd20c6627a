//! Errors of reading an MCAP log.

use std::path::PathBuf;

/// Why an MCAP log cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// A file cannot be opened or read.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The file is not MCAP.
    #[error("{path} is not an MCAP file: it does not begin with the MCAP magic")]
    NotMcap {
        /// The file.
        path: PathBuf,
    },
    /// Messages of another version of the program, or of another program.
    #[error(
        "{topic} contains {found}, expected {expected} of message version {}; read a log of another version with the program version that wrote it",
        whirlstand_msgs::VERSION
    )]
    Schema {
        /// The topic.
        topic: String,
        /// Type in the log, and its difference.
        found: String,
        /// Type in this program.
        expected: &'static str,
    },
    /// A message is not as long as its type.
    #[error("{topic}: a message has {found} bytes, but {expected} has {length} bytes")]
    Length {
        /// The topic.
        topic: String,
        /// Length of the message, bytes.
        found: usize,
        /// Type in this program.
        expected: &'static str,
        /// Length of the type, bytes.
        length: usize,
    },
    /// The description of the bench in the log is invalid.
    #[error("{path}: the description of the bench is corrupt: {reason}")]
    BenchInfo {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The folder contains no log.
    #[error("{path} is a folder without a log.mcap")]
    NoLog {
        /// The folder.
        path: PathBuf,
    },
}
