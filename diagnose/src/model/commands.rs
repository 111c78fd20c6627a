//! Future commands as a prediction knows them.

/// The commands assumed between the last measurement that a prediction uses and the time that it predicts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Commands {
    /// The recorded commands.
    Recorded,
    /// Future commands are unknown: the last one is held.
    Held,
}

impl Commands {
    /// The step whose command is applied at step `at` of a prediction begun at step `begun`, in a record that
    /// begins at step `first`.
    pub fn step(self, at: usize, begun: usize, first: usize) -> usize {
        match self {
            Self::Recorded => at,
            Self::Held => at.min(begun.saturating_sub(1).max(first)),
        }
    }
}
