//! Normal deviates of several streams side by side.

use crate::normals::{BLOCK, Normals};

/// Normal deviates identical to those of each stream alone.
#[derive(Debug, Clone)]
pub struct NormalLanes<const K: usize> {
    streams: Vec<Normals>,
    block: Vec<[f64; K]>,
    next: usize,
}

impl<const K: usize> NormalLanes<K> {
    /// The remaining deviates of K streams.
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
