//! Detects whether this process replaces one that died.

/// Environment variable in which the launcher gives the number of a node's restarts.
pub const RESTARTS: &str = "WHIRLSTAND_RESTARTS";

/// True when the launcher has restarted this node.
pub fn was_restarted() -> bool {
    std::env::var(RESTARTS).is_ok_and(|count| count.parse::<u32>().is_ok_and(|count| count > 0))
}
