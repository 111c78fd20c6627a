//! A visitor for the numbers of a message, and limits on their number.

/// Most elements of an array that are signals; longer arrays are not signals.
pub(super) const MOST_ELEMENTS: usize = 256;

/// Deepest nesting of fields; a deeper one means damage.
pub(super) const MOST_NESTING: usize = 32;

/// Receives the numbers of a message: path within the message, value.
pub(super) type Visit<'a> = dyn FnMut(&str, f64) + 'a;

/// The path of the field that a decoder is reading.
pub(super) struct PathStack {
    /// Field names and element numbers, the outermost first.
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
