//! Counts messages that never arrived, from gaps in their sequence numbers.

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
                self.lost += seq.saturating_sub(*next);
                *next = seq.wrapping_add(1);
            }
            None => self.expected.push((publisher, seq.wrapping_add(1))),
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
}
