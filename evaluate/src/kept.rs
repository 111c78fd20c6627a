//! Which messages of a topic count: a node that was started again counts from its start, and what it says replaces what
//! was said of the same time before.

/// A part of a topic's messages in which time does not go back.
#[derive(Debug, Clone, PartialEq)]
struct Segment {
    /// Numbers of its messages within the topic.
    from: u64,
    until: u64,
    first_ns: u64,
    /// Messages from this time on have been replaced by a later segment.
    limit_ns: u64,
}

/// Which messages of a topic count.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Kept {
    segments: Vec<Segment>,
    messages: u64,
    last_ns: u64,
}

impl Kept {
    /// Takes the time of the topic's next message. True when it goes back behind the one before.
    pub fn take(&mut self, ns: u64) -> bool {
        let back = !self.segments.is_empty() && ns < self.last_ns;
        if back {
            while self.segments.last().is_some_and(|segment| segment.first_ns >= ns) {
                self.segments.pop();
            }
            if let Some(last) = self.segments.last_mut() {
                last.limit_ns = last.limit_ns.min(ns);
            }
        }
        if back || self.segments.is_empty() {
            let at = self.messages;
            self.segments.push(Segment { from: at, until: at, first_ns: ns, limit_ns: u64::MAX });
        }
        self.messages += 1;
        self.last_ns = ns;
        if let Some(last) = self.segments.last_mut() {
            last.until = self.messages;
        }
        back
    }

    /// Whether nothing counts of what came before the last time that it went back.
    pub fn begins_again(&self) -> bool {
        self.segments.len() == 1
    }

    /// Number of messages of the topic, those that do not count among them.
    pub fn messages(&self) -> u64 {
        self.messages
    }

    /// Time of the last message that counts, ns; 0 without one.
    pub fn last_ns(&self) -> u64 {
        self.last_ns
    }

    /// Looks at the messages once more, from the first one on.
    pub fn again(&self) -> Again<'_> {
        Again { segments: &self.segments, message: 0 }
    }
}

/// The messages of a topic, met a second time.
#[derive(Debug, Clone)]
pub(crate) struct Again<'a> {
    segments: &'a [Segment],
    message: u64,
}

impl Again<'_> {
    /// Whether the next message, of time `ns`, counts.
    pub fn counts(&mut self, ns: u64) -> bool {
        let at = self.message;
        self.message += 1;
        while self.segments.first().is_some_and(|segment| segment.until <= at) {
            self.segments = &self.segments[1..];
        }
        self.segments.first().is_some_and(|segment| at >= segment.from && ns < segment.limit_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_came_after_the_time_of_a_restart_does_not_count() {
        for (times, counting) in [
            (vec![0, 1, 2, 3], vec![0, 1, 2, 3]),
            (vec![0, 1, 2, 3, 0, 1], vec![4, 5]),
            (vec![0, 1, 2, 3, 2, 3, 4], vec![0, 1, 4, 5, 6]),
            (vec![5, 6, 7, 1, 2, 8, 3, 4], vec![3, 4, 6, 7]),
            (vec![0, 4, 8, 6, 9, 2, 3], vec![0, 5, 6]),
            (vec![], vec![]),
        ] {
            let mut kept = Kept::default();
            let back = times.iter().filter(|ns| kept.take(**ns)).count();
            assert_eq!(back, times.windows(2).filter(|w| w[1] < w[0]).count());
            let mut again = kept.again();
            let found: Vec<usize> = (0..times.len()).filter(|i| again.counts(times[*i])).collect();
            assert_eq!(found, counting, "{times:?}");
            assert_eq!(kept.messages(), times.len() as u64);
        }
    }
}
