//! Topics that are about nodes and not about the loop: their time is that of the wall clock.

use whirlstand_msgs::{Health, Message, Progress};

/// Whether the messages of a topic, with or without its `/`, carry wall-clock time and come when they come: they are put
/// on the log's axis where bench time was when they came, have no rate, and differ from run to run. Several nodes share
/// such a topic, so that its sequence numbers show no loss.
pub(crate) fn carries_wall_clock(topic: &str) -> bool {
    [Health::TOPIC, Progress::TOPIC].contains(&topic.trim_start_matches('/'))
}
