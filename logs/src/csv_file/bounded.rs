//! A reader that stops where one line would take all memory.

use std::cell::Cell;
use std::io::{Error, Read, Result};

/// How many bytes may still be read for the line that is being read.
pub(super) struct Allowance {
    each: usize,
    left: Cell<usize>,
}

impl Allowance {
    /// So many bytes for each line.
    pub fn new(each: usize) -> Self {
        Self { each, left: Cell::new(each) }
    }

    /// A new line begins.
    pub fn renew(&self) {
        self.left.set(self.each);
    }

    /// Whether a line was longer than allowed.
    pub fn is_used_up(&self) -> bool {
        self.left.get() == 0
    }
}

/// Passes bytes on as long as there is an allowance.
pub(super) struct Bounded<'a, R> {
    inner: R,
    allowance: &'a Allowance,
}

impl<'a, R: Read> Bounded<'a, R> {
    pub fn new(inner: R, allowance: &'a Allowance) -> Self {
        Self { inner, allowance }
    }
}

impl<R: Read> Read for Bounded<'_, R> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        let left = self.allowance.left.get();
        if left == 0 {
            return Err(Error::other("a line is longer than allowed"));
        }
        let most = buffer.len().min(left);
        let count = self.inner.read(&mut buffer[..most])?;
        self.allowance.left.set(left - count);
        Ok(count)
    }
}
