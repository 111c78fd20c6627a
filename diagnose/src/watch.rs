//! Who waits for a diagnosis: is told what it is doing, and may end it with what is known by then.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Hears what a diagnosis is doing.
type Listener = Arc<dyn Fn(&str) + Send + Sync>;

/// A listener, and a switch that ends the search. The default hears nothing and never ends it.
#[derive(Clone, Default)]
pub struct Watch {
    stop: Arc<AtomicBool>,
    listener: Option<Listener>,
}

impl Watch {
    /// `stop` ends the search with what is known as soon as it is true; the listener is told each step of it.
    pub fn new(stop: Arc<AtomicBool>, listener: impl Fn(&str) + Send + Sync + 'static) -> Self {
        Self { stop, listener: Some(Arc::new(listener)) }
    }

    /// True once the search is to end.
    pub fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Tells the listener what comes next.
    pub(crate) fn tell(&self, what: &str) {
        if let Some(listener) = &self.listener {
            listener(what);
        }
    }
}

impl fmt::Debug for Watch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Watch").field("stopped", &self.is_stopped()).finish_non_exhaustive()
    }
}
