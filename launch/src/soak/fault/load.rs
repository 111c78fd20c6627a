//! Processor load from outside the bench.

use std::hint::spin_loop;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{Builder, JoinHandle, available_parallelism};

use super::ongoing::Ongoing;

/// A busy thread for every processor.
pub(super) struct Busy {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Busy {
    pub fn begin() -> io::Result<Self> {
        let mut busy = Self { stop: Arc::default(), threads: Vec::new() };
        for _ in 0..available_parallelism()?.get() {
            let stop = Arc::clone(&busy.stop);
            let thread = Builder::new().name("load".into()).spawn(move || {
                while !stop.load(Ordering::Relaxed) {
                    spin_loop();
                }
            })?;
            busy.threads.push(thread);
        }
        Ok(busy)
    }
}

impl Ongoing for Busy {
    fn dealt(&self) -> u64 {
        self.threads.len() as u64
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}
