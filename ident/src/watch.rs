//! Who waits for a search: is told what it is doing, and may end it with what is known by then.

use std::fmt;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;

/// What a search is doing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stage<'a> {
    /// In words.
    pub what: &'a str,
    /// How far it has come, in words; empty where there is nothing to say.
    pub detail: &'a str,
    /// How much of it is done, 0 to 1, where that is known.
    pub share: Option<f64>,
}

/// Hears what a search is doing.
type Listener = Arc<dyn Fn(Stage<'_>) + Send + Sync>;

/// A listener, and what ends the search: a switch, or a time. The default hears nothing and never ends it.
#[derive(Clone, Default)]
pub struct Watch {
    stop: Arc<AtomicBool>,
    deadline: Option<Instant>,
    listener: Option<Listener>,
}

impl Watch {
    /// `stop` ends the search with what is known as soon as it is true; the listener is told each step of it.
    pub fn new(stop: Arc<AtomicBool>, listener: impl Fn(Stage<'_>) + Send + Sync + 'static) -> Self {
        Self { stop, deadline: None, listener: Some(Arc::new(listener)) }
    }

    /// The same, which ends the search at a time as well.
    pub fn until(self, deadline: Instant) -> Self {
        Self { deadline: Some(deadline), ..self }
    }

    /// True once the search is to end.
    pub fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed) || self.deadline.is_some_and(|at| Instant::now() >= at)
    }

    /// Tells the listener what comes next.
    pub fn tell(&self, what: &str) {
        self.hear(what, "", None);
    }

    /// Tells the listener what comes next, in so many steps.
    pub fn count(&self, what: String, steps: usize) -> Counter<'_> {
        self.hear(&what, "", Some(0.0));
        Counter { watch: self, what, steps, done: AtomicUsize::new(0) }
    }

    /// Tells the listener how far a search has come, as `detail` has it, and whether it is to go on.
    pub fn step(&self, what: &str, detail: impl FnOnce() -> String, share: Option<f64>) -> ControlFlow<()> {
        if self.listener.is_some() {
            self.hear(what, &detail(), share);
        }
        if self.is_stopped() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    fn hear(&self, what: &str, detail: &str, share: Option<f64>) {
        if let Some(listener) = &self.listener {
            listener(Stage { what, detail, share });
        }
    }
}

/// Counts the steps of a stage, from any thread.
#[derive(Debug)]
pub struct Counter<'w> {
    /// Whom it tells.
    pub watch: &'w Watch,
    what: String,
    steps: usize,
    done: AtomicUsize,
}

impl Counter<'_> {
    /// One step is done.
    pub fn step(&self) {
        let done = self.done.fetch_add(1, Ordering::Relaxed) + 1;
        self.watch.hear(&self.what, "", Some(done as f64 / self.steps.max(1) as f64));
    }
}

impl fmt::Debug for Watch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Watch").field("stopped", &self.is_stopped()).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_switch_or_a_time_ends_the_search() {
        let stop = Arc::new(AtomicBool::new(false));
        let watch = Watch::new(Arc::clone(&stop), |_| ());
        let later = watch.clone().until(Instant::now() + Duration::from_secs(3600));
        let past = watch.clone().until(Instant::now());
        assert_eq!([&watch, &later, &past].map(Watch::is_stopped), [false, false, true]);
        stop.store(true, Ordering::Relaxed);
        assert!(watch.is_stopped() && later.is_stopped());
    }
}
