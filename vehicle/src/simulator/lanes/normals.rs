//! Normal deviates of several streams side by side.

use crate::normals::{BLOCK, Normals};

/// The same numbers as each stream gives alone.
#[derive(Debug, Clone)]
pub struct NormalLanes<const K: usize> {
    streams: Vec<Normals>,
    block: Vec<[f64; K]>,
    next: usize,
}

impl<const K: usize> NormalLanes<K> {
    /// What K streams have left.
    pub fn new(streams: Vec<Normals>) -> Self {
        Self { streams, block: vec![[0.0; K]; BLOCK], next: BLOCK }
    }

    /// The next number of every stream.
    #[inline(always)]
    pub fn next(&mut self) -> &[f64; K] {
        if self.next == BLOCK {
            self.refill();
        }
        self.next += 1;
        &self.block[self.next - 1]
    }

    fn refill(&mut self) {
        for (l, stream) in self.streams.iter_mut().enumerate() {
            self.block.iter_mut().for_each(|row| row[l] = stream.next());
        }
        self.next = 0;
    }
}
