//! Key expressions of topics over Zenoh.

/// Zenoh's key expression of a topic.
pub fn key_expression(bench: &str, topic: &str) -> String {
    format!("whirlstand/{bench}/{topic}")
}

/// Zenoh's key expression for messages of the node `name` on `topic`: a separate key, so that access control
/// can bind it to the node.
pub fn spoken_key(bench: &str, topic: &str, name: &str) -> String {
    format!("{}/{name}", key_expression(bench, topic))
}
