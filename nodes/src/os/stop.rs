//! Orderly termination, requested by a signal or by the program itself.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::{SIGINT, SIGTERM};

/// Flag that is set once when the node shall end.
#[derive(Debug, Clone, Default)]
pub struct StopFlag(Arc<AtomicBool>);

impl StopFlag {
    /// A flag that `SIGTERM` sets. `SIGINT` sets it as well, unless a launcher runs this node: Ctrl-C at a
    /// terminal reaches every process of the bench at once, and the launcher stops them in order.
    ///
    /// # Errors
    /// The handlers cannot be installed.
    pub fn on_signals() -> std::io::Result<Self> {
        let flag = Self::default();
        signal_hook::flag::register(SIGTERM, Arc::clone(&flag.0))?;
        if std::env::var_os("NOTIFY_SOCKET").is_none() {
            signal_hook::flag::register(SIGINT, Arc::clone(&flag.0))?;
        } else {
            signal_hook::flag::register(SIGINT, Arc::default())?;
        }
        Ok(flag)
    }

    /// Requests the end.
    pub fn set(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// True when the end was requested.
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}
