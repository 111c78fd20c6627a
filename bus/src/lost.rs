//! Counts messages that never arrived, from gaps in their sequence numbers.

/// Largest number of publishers per topic that are distinguished. A bench has a handful; foreign ids cost
/// their sender nothing, and must not take unbounded memory of a subscriber.
const MOST_PUBLISHERS: usize = 256;

/// Expected sequence numbers of each publisher of a topic.
#[derive(Debug, Default)]
pub(crate) struct LostCounter {
    /// Publisher and its next sequence number; few entries, so a list is fastest.
    expected: Vec<(u128, u64)>,
    lost: u64,
}

impl LostCounter {
    /// Records a message. The first one of a publisher does not count as a loss: the subscriber may have
    /// joined late. A number that goes back means that the publisher restarted.
    pub(crate) fn note(&mut self, publisher: u128, seq: u64) {
        match self.expected.iter_mut().find(|(id, _)| *id == publisher) {
            Some((_, next)) => {
                // A number from a network can be arbitrary: the count saturates instead of wrapping around.
                self.lost = self.lost.saturating_add(seq.saturating_sub(*next));
                *next = seq.wrapping_add(1);
            }
            None => {
                if self.expected.len() == MOST_PUBLISHERS {
                    // The publisher that was first heard longest ago.
                    self.expected.remove(0);
                }
                self.expected.push((publisher, seq.wrapping_add(1)));
            }
        }
    }

    /// Number of messages missed so far.
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
