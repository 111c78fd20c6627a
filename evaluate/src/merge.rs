//! Sorts the messages of a log by their time.
//!
//! A recorder writes the waiting messages of one topic, then those of the next. In the file, the setpoint of a
//! step may therefore come a thousand steps after its truth.

use std::collections::VecDeque;

use whirlstand_logs::BenchMessage;
use whirlstand_msgs::Message;

/// Number of sorted topics; messages with the same time are in the order of the topics.
pub(crate) const TOPICS: usize = 7;

/// Most messages of a topic that wait for another one. A recorder's queues hold 1024.
const MOST_WAITING: usize = 4_096;

/// Topics of which each step leaves a message in the log, where the bench has them: index and name.
pub(crate) const LOOP: [(usize, &str); 4] = [(1, "truth"), (2, "estimate"), (3, "command"), (4, "imu")];

/// Index of a message's topic among the sorted ones, and its time, ns. `None` for health and disturbances, which
/// are not sorted.
pub(crate) fn place(message: &BenchMessage) -> Option<(usize, u64)> {
    fn at<M: Message>(place: usize, message: &M) -> Option<(usize, u64)> {
        Some((place, message.head().stamp_ns))
    }
    match message {
        BenchMessage::Setpoint(m) => at(0, m),
        BenchMessage::Truth(m) => at(1, m),
        BenchMessage::Estimate(m) => at(2, m),
        BenchMessage::Command(m) => at(3, m),
        BenchMessage::Imu(m) => at(4, m),
        BenchMessage::Odometry(m) => at(5, m),
        BenchMessage::Outputs(m) => at(6, m),
        BenchMessage::Disturbance(_)
        | BenchMessage::Sent(_)
        | BenchMessage::Reported(_)
        | BenchMessage::Autopilot(_)
        | BenchMessage::Finding(_)
        | BenchMessage::Adjustment(_)
        | BenchMessage::Health(_) => None,
    }
}

/// Puts messages in order. Of two messages of one topic and one time the later one holds.
pub(crate) struct Merge {
    waiting: [VecDeque<(u64, BenchMessage)>; TOPICS],
    /// Messages of each topic that are still to come.
    coming: [u64; TOPICS],
}

impl Merge {
    /// `coming` is the number of messages of each topic in the log.
    pub fn new(coming: [u64; TOPICS]) -> Self {
        Self { waiting: Default::default(), coming }
    }

    /// Takes in the next message of the file. `None` stands for a message that is not valid and only reduces
    /// the count.
    pub fn push(&mut self, topic: usize, ns: u64, message: Option<BenchMessage>) {
        self.coming[topic] = self.coming[topic].saturating_sub(1);
        let Some(message) = message else { return };
        let waiting = &mut self.waiting[topic];
        match waiting.back_mut() {
            Some(last) if last.0 == ns => last.1 = message,
            _ => waiting.push_back((ns, message)),
        }
    }

    /// The earliest message, once no earlier one can come.
    pub fn pop(&mut self) -> Option<BenchMessage> {
        let first = |topic: usize| self.waiting[topic].front().map(|(ns, _)| (*ns, topic));
        let (_, topic) = (0..TOPICS).filter_map(first).min()?;
        // Another message of the same time may follow the last one that waits.
        let known = |t: usize| self.coming[t] == 0 || self.waiting[t].len() > usize::from(t == topic);
        let full = || self.waiting.iter().any(|queue| queue.len() >= MOST_WAITING);
        if !(0..TOPICS).all(known) && !full() {
            return None;
        }
        self.waiting[topic].pop_front().map(|(_, message)| message)
    }

    /// The next setpoint.
    pub fn next_setpoint(&self) -> Option<&BenchMessage> {
        self.waiting[0].front().map(|(_, message)| message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_msgs::{Head, Setpoint, Truth};

    fn setpoint(ns: u64) -> BenchMessage {
        BenchMessage::Setpoint(Setpoint {
            head: Head { seq: ns, step: ns, stamp_ns: ns },
            ..Setpoint::zeroed()
        })
    }

    fn truth(ns: u64) -> BenchMessage {
        BenchMessage::Truth(Truth { head: Head { seq: ns, step: ns, stamp_ns: ns }, ..Truth::zeroed() })
    }

    fn order(file: &[BenchMessage]) -> Vec<(usize, u64)> {
        let mut coming = [0; TOPICS];
        file.iter().for_each(|m| coming[place(m).unwrap().0] += 1);
        let mut merge = Merge::new(coming);
        let mut order = Vec::new();
        for message in file {
            let (topic, ns) = place(message).unwrap();
            merge.push(topic, ns, Some(*message));
            while let Some(message) = merge.pop() {
                order.push(place(&message).unwrap());
            }
        }
        order
    }

    #[test]
    fn topics_apart_in_the_file_come_in_the_order_of_time() {
        let file: Vec<_> = (0..1000).map(truth).chain((0..1000).map(setpoint)).collect();
        let expected: Vec<_> = (0..1000).flat_map(|ns| [(0, ns), (1, ns)]).collect();
        assert_eq!(order(&file), expected);
        // What is said twice of one time counts once.
        assert_eq!(order(&[truth(0), truth(1), truth(1), setpoint(0)]), [(0, 0), (1, 0), (1, 1)]);
    }

    #[test]
    fn a_topic_that_stays_away_holds_up_only_so_many() {
        let file: Vec<_> = (0..10_000).map(truth).chain([setpoint(10_000)]).collect();
        let mut merge = Merge::new([1, 10_000, 0, 0, 0, 0, 0]);
        let mut most = 0;
        for message in &file[..10_000] {
            let (topic, ns) = place(message).unwrap();
            merge.push(topic, ns, Some(*message));
            while merge.pop().is_some() {}
            most = most.max(merge.waiting[topic].len());
        }
        assert_eq!(most, MOST_WAITING - 1);
    }
}
