//! Notes of a bridge to its user.

use std::collections::VecDeque;

/// Largest number of waiting notes; after it the oldest is discarded.
const WAITING: usize = 64;

/// A note to the user.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Note {
    /// True for a warning.
    pub warn: bool,
    /// Text of the note, one sentence.
    pub text: String,
}

/// Notes in the order of their creation.
#[derive(Debug, Clone, Default)]
pub struct Notes(VecDeque<Note>);

impl Notes {
    /// Adds an informational note.
    pub fn info(&mut self, text: impl Into<String>) {
        self.push(false, text.into());
    }

    /// Adds a warning.
    pub fn warn(&mut self, text: impl Into<String>) {
        self.push(true, text.into());
    }

    /// Removes and returns the oldest note.
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
