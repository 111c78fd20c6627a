//! How the numbers of a message are handed on, one by one, and how many of them there may be.

/// Arrays longer than this are not signals.
pub(super) const MOST_ELEMENTS: usize = 256;

/// Nesting deeper than this is damage.
pub(super) const MOST_NESTING: usize = 32;

/// Receives the numbers of a message: path within the message, value.
pub(super) type Visit<'a> = dyn FnMut(&str, f64) + 'a;

/// The path to where a decoder is in a message.
pub(super) struct PathStack {
    /// Field names and element numbers, from the outermost in.
    pub(super) text: String,
}

impl PathStack {
    pub(super) fn new() -> Self {
        Self { text: String::new() }
    }

    /// Runs `inside` one field deeper.
    pub(super) fn field<R>(&mut self, name: &str, inside: impl FnOnce(&mut Self) -> R) -> R {
        let length = self.text.len();
        if length > 0 {
            self.text.push('.');
        }
        self.text.push_str(name);
        let result = inside(self);
        self.text.truncate(length);
        result
    }

    /// Runs `inside` at an element.
    pub(super) fn element<R>(&mut self, index: usize, inside: impl FnOnce(&mut Self) -> R) -> R {
        use std::fmt::Write;
        let length = self.text.len();
        // Writing into a String cannot fail.
        let _ = write!(self.text, "[{index}]");
        let result = inside(self);
        self.text.truncate(length);
        result
    }
}
