//! Progress reports and early termination of a search.

use std::fmt;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;

/// Progress of a search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stage<'a> {
    /// Description of the current stage.
    pub what: &'a str,
    /// Detailed progress as text; empty where there is none.
    pub detail: &'a str,
    /// Share of the stage that is done, 0 to 1, where known.
    pub share: Option<f64>,
}

/// Callback that receives the progress.
type Listener = Arc<dyn Fn(Stage<'_>) + Send + Sync>;

/// A progress listener, and a condition that ends the search: a switch or a deadline. The default has
/// neither.
#[derive(Clone, Default)]
pub struct Watch {
    stop: Arc<AtomicBool>,
    deadline: Option<Instant>,
    listener: Option<Listener>,
}

impl Watch {
    /// The search ends with its results so far as soon as `stop` is true; the listener receives the progress.
    pub fn new(stop: Arc<AtomicBool>, listener: impl Fn(Stage<'_>) + Send + Sync + 'static) -> Self {
        Self { stop, deadline: None, listener: Some(Arc::new(listener)) }
    }

    /// The same watch, with a deadline as well.
    pub fn until(self, deadline: Instant) -> Self {
        Self { deadline: Some(deadline), ..self }
    }

    /// True when the search must end.
    pub fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed) || self.deadline.is_some_and(|at| Instant::now() >= at)
    }

    /// Reports the next stage to the listener.
    pub fn tell(&self, what: &str) {
        self.hear(what, "", None);
    }

    /// Reports the next stage to the listener, with its number of steps.
    pub fn count(&self, what: String, steps: usize) -> Counter<'_> {
        self.hear(&what, "", Some(0.0));
        Counter { watch: self, what, steps, done: AtomicUsize::new(0) }
    }

    /// Reports the progress with `detail` as text; the result says whether to continue.
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

/// Counts the steps of a stage; usable from any thread.
#[derive(Debug)]
pub struct Counter<'w> {
    /// Watch that receives the progress.
    pub watch: &'w Watch,
    what: String,
    steps: usize,
    done: AtomicUsize,
}

impl Counter<'_> {
    /// Counts one completed step.
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
