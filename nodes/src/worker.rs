//! A worker thread beside the loop. Submitting work neither allocates nor takes a lock, so that a step may do
//! it.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, Thread};

use crossbeam_queue::ArrayQueue;

struct Shared<T> {
    queue: ArrayQueue<T>,
    is_closed: AtomicBool,
}

/// A thread that processes items in order, until this is dropped.
pub(crate) struct Worker<T> {
    shared: Arc<Shared<T>>,
    thread: Thread,
}

impl<T: Send + 'static> Worker<T> {
    /// Starts the thread, with a queue of `depth` items; before the node takes its priority, which the thread
    /// must not have.
    ///
    /// # Errors
    /// The error of the operating system.
    pub fn start(
        name: &str,
        depth: usize,
        mut work: impl FnMut(T) + Send + 'static,
    ) -> std::io::Result<Self> {
        let shared = Arc::new(Shared { queue: ArrayQueue::new(depth), is_closed: AtomicBool::new(false) });
        let at_work = shared.clone();
        let turn = move || {
            // Items submitted before the end are processed. A wake-up between the check and `park` is not
            // lost.
            while let Some(next) = at_work.next() {
                work(next);
            }
        };
        let thread = thread::Builder::new().name(name.into()).spawn(turn)?.thread().clone();
        Ok(Self { shared, thread })
    }

    /// Submits an item; returned when the queue is full.
    pub fn hand(&self, something: T) -> Result<(), T> {
        let handed = self.shared.queue.push(something);
        self.thread.unpark();
        handed
    }
}

impl<T> Shared<T> {
    /// The next item, when it has arrived; `None` at the end.
    fn next(&self) -> Option<T> {
        loop {
            let is_closed = self.is_closed.load(Ordering::Acquire);
            match self.queue.pop() {
                Some(next) => return Some(next),
                None if is_closed => return None,
                None => thread::park(),
            }
        }
    }
}

impl<T> Drop for Worker<T> {
    fn drop(&mut self) {
        self.shared.is_closed.store(true, Ordering::Release);
        self.thread.unpark();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::channel;

    #[test]
    fn everything_is_done_in_order_and_what_does_not_fit_comes_back() {
        let (done, heard) = channel();
        let (go_on, held) = channel::<()>();
        let worker = Worker::start("test", 2, move |n: u32| {
            done.send(n).unwrap();
            held.recv().unwrap();
        })
        .unwrap();
        worker.hand(0).unwrap();
        assert_eq!(heard.recv(), Ok(0), "it works on this, and two more fit");
        assert_eq!([worker.hand(1), worker.hand(2), worker.hand(3)], [Ok(()), Ok(()), Err(3)]);
        drop(worker);
        (0..3).for_each(|_| go_on.send(()).unwrap());
        assert_eq!(heard.iter().collect::<Vec<_>>(), [1, 2], "and then it ends");
    }
}
