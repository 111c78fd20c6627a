//! Whether this process takes the place of one that died.

/// Environment variable in which the launcher says how often a node was started again.
pub const RESTARTS: &str = "WHIRLSTAND_RESTARTS";

/// Whether the launcher has started this node again.
pub fn was_restarted() -> bool {
    std::env::var(RESTARTS).is_ok_and(|count| count.parse::<u32>().is_ok_and(|count| count > 0))
}
