//! Reports readiness, the last action of a node before it runs.

use std::sync::atomic::{AtomicBool, Ordering};

use whirlstand_bus::Bus;

use crate::config::{Mode, NodeConfig, Role};
use crate::error::NodeError;
use crate::os::{apply_realtime, notify_ready, wake_when_due};

static READY: AtomicBool = AtomicBool::new(false);

/// True when this process is a node that has become ready. Later errors are not due to the user's input.
pub fn is_ready() -> bool {
    READY.load(Ordering::Relaxed)
}

/// Sets the node's priority and notifies the launcher of its readiness; to be called after the ports are
/// open, because threads of the transport must not run at the node's priority. `more` are locators besides
/// those of `bus`.
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
