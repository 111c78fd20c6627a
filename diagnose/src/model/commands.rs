//! What a prediction knows of the commands that lie ahead of it.

/// The commands between the last measurement that a prediction knows and the moment that it is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Commands {
    /// As they were recorded.
    Recorded,
    /// Nobody knows them yet: the last one before is held.
    Held,
}

impl Commands {
    /// The step whose command acts at step `at` of a prediction that begins at step `begun`, in a record that begins at `first`.
    pub fn step(self, at: usize, begun: usize, first: usize) -> usize {
        match self {
            Self::Recorded => at,
            Self::Held => at.min(begun.saturating_sub(1).max(first)),
        }
    }
}
