//! A thread that repeats an action.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::{Builder, JoinHandle, sleep};
use std::time::Duration;

use super::ongoing::Ongoing;

/// Time between two repetitions.
const PAUSE: Duration = Duration::from_millis(2);

/// A thread that repeats an action until it is dropped.
pub(super) struct Again {
    stop: Arc<AtomicBool>,
    done: Arc<AtomicU64>,
    thread: Option<JoinHandle<()>>,
}

impl Again {
    /// Calls `begin` in a new thread, and then calls the function that it returned every [`PAUSE`]. That
    /// function returns how much it did.
    pub fn start<F>(begin: impl FnOnce() -> F + Send + 'static) -> io::Result<Self>
    where
        F: FnMut() -> u64,
    {
        let (stop, done) = (Arc::<AtomicBool>::default(), Arc::<AtomicU64>::default());
        let (ends, counts) = (Arc::clone(&stop), Arc::clone(&done));
        let thread = Builder::new().name("fault".into()).spawn(move || {
            let mut turn = begin();
            while !ends.load(Ordering::Relaxed) {
                counts.fetch_add(turn(), Ordering::Relaxed);
                sleep(PAUSE);
            }
        })?;
        Ok(Self { stop, done, thread: Some(thread) })
    }
}

impl Ongoing for Again {
    fn dealt(&self) -> u64 {
        self.done.load(Ordering::Relaxed)
    }
}

impl Drop for Again {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
