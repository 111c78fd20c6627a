//! Messages of a bridge to its user.

use std::collections::VecDeque;

/// Notes that wait at most; a bridge that nobody asks forgets the oldest.
const WAITING: usize = 64;

/// One message to the user.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Note {
    /// The user should look at it.
    pub warn: bool,
    /// Text of the message, one sentence.
    pub text: String,
}

/// Notes in the order in which they came.
#[derive(Debug, Clone, Default)]
pub struct Notes(VecDeque<Note>);

impl Notes {
    /// Tells something.
    pub fn info(&mut self, text: impl Into<String>) {
        self.push(false, text.into());
    }

    /// Tells something that the user should look at.
    pub fn warn(&mut self, text: impl Into<String>) {
        self.push(true, text.into());
    }

    /// The oldest note.
    pub fn take(&mut self) -> Option<Note> {
        self.0.pop_front()
    }

    fn push(&mut self, warn: bool, text: String) {
        if self.0.len() == WAITING {
            self.0.pop_front();
        }
        self.0.push_back(Note { warn, text });
    }
}
