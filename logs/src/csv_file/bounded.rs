//! Limits on the size of a CSV file, and a reader that stops when a line would exhaust memory.

use std::cell::Cell;
use std::io::{Error, Read, Result};

/// Most columns of a file. Logs of autopilots with every topic in one table have some thousands. A file with more
/// columns is no table of signals over time, and its names would take more memory than its numbers.
pub(super) const MOST_COLUMNS: usize = 10_000;

/// Most bytes of a line, including preceding comments: [`MOST_COLUMNS`] numbers of full precision take a twentieth
/// of it.
pub(super) const LONGEST_LINE: usize = 4 << 20;

/// Greatest magnitude of a number. No quantity of a flight comes near it in any unit, and squares and sums of such
/// numbers do not overflow. A greater number is the "no value" of a logger, such as the greatest single precision
/// number.
pub(super) const GREATEST: f64 = 1e30;

/// Number of bytes that may still be read for the present line.
pub(super) struct Allowance {
    each: usize,
    left: Cell<usize>,
}

impl Allowance {
    /// An allowance of `each` bytes per line.
    pub fn new(each: usize) -> Self {
        Self { each, left: Cell::new(each) }
    }

    /// Resets the allowance for a new line.
    pub fn renew(&self) {
        self.left.set(self.each);
    }

    /// Whether a line exceeded the allowance.
    pub fn is_used_up(&self) -> bool {
        self.left.get() == 0
    }
}

/// A reader that passes on bytes while the allowance lasts.
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
