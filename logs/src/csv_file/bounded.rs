//! Bounds of a table of signals, and a reader that stops where one line would take all memory.

use std::cell::Cell;
use std::io::{Error, Read, Result};

/// Most columns of a file. Logs of autopilots with every topic in one table have some thousands; what has more is no table
/// of signals over time, and names in that number cost more than the numbers.
pub(super) const MOST_COLUMNS: usize = 10_000;

/// Most bytes of a line, with the comments before it: [`MOST_COLUMNS`] numbers of full precision are a twentieth of it.
pub(super) const LONGEST_LINE: usize = 4 << 20;

/// Greatest size of a number. No quantity of a flight comes near it in any unit, and it leaves room to square and to add
/// without an overflow; what is greater is the "no value" of somebody's logger, such as the greatest single precision number.
pub(super) const GREATEST: f64 = 1e30;

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
