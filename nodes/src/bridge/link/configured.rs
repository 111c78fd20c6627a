//! Links from the launch file.

use std::time::Duration;

use whirlstand_bridge::peer::Pin;

use super::{Address, Link};
use crate::error::NodeError;

/// The link with the address in `bridge.TABLE.KEY`, which accepts only the peer in `bridge.TABLE.peer`.
///
/// # Errors
/// [`NodeError::Config`] for an invalid address, and for a pin on a link without other senders.
pub fn configured(
    table: &str,
    key: &str,
    text: &str,
    pin: Option<Pin>,
    silence: Duration,
) -> Result<Link, NodeError> {
    let wrong = |key: &str, value: String, reason: String| NodeError::Config {
        field: format!("bridge.{table}.{key}"),
        value,
        reason,
    };
    let address: Address =
        text.parse().map_err(|e: super::AddressError| wrong(key, text.into(), e.to_string()))?;
    if let Some(pin) = pin.filter(|_| !address.is_open()) {
        let reason =
            format!("it says who may come to udpin:// or tcpin://, and {address} is neither: leave it out");
        return Err(wrong("peer", pin.to_string(), reason));
    }
    Ok(Link::with_peer(address, pin, silence))
}
