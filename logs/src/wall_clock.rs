//! Topics about nodes instead of the loop, which carry wall-clock time.

use whirlstand_msgs::{Health, Message, Progress};

/// Whether the messages of a topic, with or without its `/`, carry wall-clock time and are published irregularly.
/// On the log's axis they have the bench time of their arrival; they have no rate, and differ from run to run.
/// Several nodes share such a topic, so that its sequence numbers show no loss.
pub(crate) fn carries_wall_clock(topic: &str) -> bool {
    [Health::TOPIC, Progress::TOPIC].contains(&topic.trim_start_matches('/'))
}
