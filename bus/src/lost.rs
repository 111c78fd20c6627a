//! Counts messages that never arrived, from gaps in their sequence numbers.

/// Publishers of one topic that are told apart. A bench has a handful; an id costs a stranger nothing, and must cost
/// a subscriber no memory without bound.
const MOST_PUBLISHERS: usize = 256;

/// What is expected next from each publisher of a topic.
#[derive(Debug, Default)]
pub(crate) struct LostCounter {
    /// Publisher and the sequence number that comes next; few, so a list is fastest.
    expected: Vec<(u128, u64)>,
    lost: u64,
}

impl LostCounter {
    /// Takes note of a message. The first one of a publisher misses nothing: the subscriber may have joined late.
    /// A number that goes back is a publisher that started anew.
    pub(crate) fn note(&mut self, publisher: u128, seq: u64) {
        match self.expected.iter_mut().find(|(id, _)| *id == publisher) {
            Some((_, next)) => {
                // A number from a network can be any: the count stays at its end instead of beginning anew.
                self.lost = self.lost.saturating_add(seq.saturating_sub(*next));
                *next = seq.wrapping_add(1);
            }
            None => {
                if self.expected.len() == MOST_PUBLISHERS {
                    // The one that was first heard longest ago.
                    self.expected.remove(0);
                }
                self.expected.push((publisher, seq.wrapping_add(1)));
            }
        }
    }

    /// Messages missed so far.
    pub(crate) fn lost(&self) -> u64 {
        self.lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_gaps_count() {
        let mut counter = LostCounter::default();
        for (publisher, seq) in [(1, 40), (1, 41), (2, 0), (1, 44), (2, 1), (1, 0), (1, 1), (2, 2)] {
            counter.note(publisher, seq);
        }
        assert_eq!(counter.lost(), 2);
        counter.note(3, u64::MAX);
        counter.note(3, 0);
        assert_eq!(counter.lost(), 2);
    }

    #[test]
    fn wild_numbers_neither_wrap_the_count_nor_fill_the_memory() {
        let mut counter = LostCounter::default();
        for _ in 0..3 {
            counter.note(1, 0);
            counter.note(1, u64::MAX);
        }
        assert_eq!(counter.lost(), u64::MAX);
        for publisher in 0..10_000 {
            counter.note(publisher, 0);
        }
        assert_eq!(counter.expected.len(), MOST_PUBLISHERS);
    }
}
