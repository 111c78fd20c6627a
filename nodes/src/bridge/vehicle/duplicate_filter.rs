//! Filter for two threads that read the same topics: the first to receive a message processes it, the other
//! one skips it.

use std::collections::VecDeque;

use whirlstand_msgs::Head;

/// Queue length for commands and estimates; one of each is awaited at a time.
pub(super) const DEPTH: usize = 16;

/// Thread that reads the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Reader {
    /// Thread of the measurements.
    Measurements,
    /// Thread of the commands.
    Commands,
}

/// Messages that only one of the two threads has received so far: at most the length of a queue.
#[derive(Debug)]
pub(super) struct DuplicateFilter(VecDeque<(Reader, &'static str, u64, u64)>);

impl Default for DuplicateFilter {
    fn default() -> Self {
        Self(VecDeque::with_capacity(4 * DEPTH))
    }
}

impl DuplicateFilter {
    /// True when the other thread has not received this message yet.
    pub(super) fn is_new(&mut self, reader: Reader, topic: &'static str, head: &Head) -> bool {
        let same =
            |h: &(Reader, &str, u64, u64)| h.0 != reader && (h.1, h.2, h.3) == (topic, head.seq, head.step);
        if let Some(at) = self.0.iter().position(same) {
            self.0.remove(at);
            return false;
        }
        if self.0.len() == 4 * DEPTH {
            self.0.pop_front();
        }
        self.0.push_back((reader, topic, head.seq, head.step));
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_message_is_taken_once_whoever_reads_it_first() {
        let mut filter = DuplicateFilter::default();
        let head = |seq, step| Head { seq, step, stamp_ns: 0 };
        let mut news = |reader, topic, seq, step| filter.is_new(reader, topic, &head(seq, step));
        use Reader::{Commands, Measurements};
        assert!(news(Measurements, "command", 0, 7));
        assert!(news(Measurements, "estimate", 0, 7), "another topic");
        assert!(!news(Commands, "command", 0, 7));
        assert!(news(Commands, "command", 1, 8));
        assert!(!news(Measurements, "command", 1, 8));
        // A message sent twice is received twice by each thread.
        assert!(news(Commands, "command", 1, 8) && news(Commands, "command", 1, 8));
        assert!(!news(Measurements, "command", 1, 8) && !news(Measurements, "command", 1, 8));
        assert!(news(Measurements, "command", 1, 8));
    }

    #[test]
    fn a_thread_that_slept_takes_nothing_again() {
        let mut filter = DuplicateFilter::default();
        let head = |seq| Head { seq, step: seq, stamp_ns: 0 };
        for seq in 0..1000 {
            assert!(filter.is_new(Reader::Commands, "command", &head(seq)));
        }
        // Its queue holds the newest messages.
        for seq in 1000 - DEPTH as u64..1000 {
            assert!(!filter.is_new(Reader::Measurements, "command", &head(seq)));
        }
        assert!(filter.0.len() <= 4 * DEPTH);
    }
}
