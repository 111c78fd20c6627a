//! Error of the configuration in the `[bridge]` table.

/// An error in a `[bridge]` table.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("bridge.{}: {message}", path.join("."))]
pub struct ConfigError {
    /// Keys from `bridge` on; elements of lists are numbered from 0.
    pub path: Vec<String>,
    /// Message for the user: what is wrong, what was expected, what to do.
    pub message: String,
}

impl ConfigError {
    /// An error at a path.
    pub fn new(path: &[&str], message: impl Into<String>) -> Self {
        Self { path: path.iter().map(ToString::to_string).collect(), message: message.into() }
    }
}
