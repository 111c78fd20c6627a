//! Reports readiness: the last thing that a node does before it runs.

use std::sync::atomic::{AtomicBool, Ordering};

use whirlstand_bus::Bus;

use crate::config::{Mode, NodeConfig, Role};
use crate::error::NodeError;
use crate::os::{apply_realtime, notify_ready, wake_when_due};

static READY: AtomicBool = AtomicBool::new(false);

/// Whether this process is a node that has become ready. What goes wrong from then on is not what the user gave it.
pub fn is_ready() -> bool {
    READY.load(Ordering::Relaxed)
}

/// Takes the node's priority and tells the launcher that it is ready. After the ports are open, because threads of the transport must not run at the node's priority. `more` are
/// locators beside those of `bus`.
pub(crate) fn get_ready(
    role: Role,
    config: &NodeConfig,
    bus: &Bus,
    more: &[String],
) -> Result<(), NodeError> {
    if config.mode == Mode::Realtime {
        wake_when_due();
    }
    if let Some(options) = config.realtime.get(&role) {
        apply_realtime(options)?;
    }
    READY.store(true, Ordering::Relaxed);
    notify_ready(&[bus.locators(), more].concat())
        .map_err(|source| NodeError::System { action: "tell NOTIFY_SOCKET", source })
}
