//! Selection of the valid messages of a topic: a restarted node counts from its start again, and its messages
//! replace earlier ones with the same time.

/// A part of a topic's messages in which time increases.
#[derive(Debug, Clone, PartialEq)]
struct Segment {
    /// Index of the first message within the topic.
    from: u64,
    until: u64,
    first_ns: u64,
    /// Time from which a later segment has replaced the messages of this one.
    limit_ns: u64,
}

/// The valid messages of a topic.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Kept {
    segments: Vec<Segment>,
    messages: u64,
    last_ns: u64,
}

impl Kept {
    /// Takes in the time of the topic's next message. Returns whether it is earlier than the one before.
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

    /// Whether all messages before the last restart have been replaced.
    pub fn begins_again(&self) -> bool {
        self.segments.len() == 1
    }

    /// Number of messages of the topic, including replaced ones.
    pub fn messages(&self) -> u64 {
        self.messages
    }

    /// Time of the last valid message, ns; 0 without one.
    pub fn last_ns(&self) -> u64 {
        self.last_ns
    }

    /// Iterates over the messages once more, from the first one on.
    pub fn again(&self) -> Again<'_> {
        Again { segments: &self.segments, message: 0 }
    }
}

/// The messages of a topic in the second pass over the log.
#[derive(Debug, Clone)]
pub(crate) struct Again<'a> {
    segments: &'a [Segment],
    message: u64,
}

impl Again<'_> {
    /// Whether the next message, with time `ns`, is valid.
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
