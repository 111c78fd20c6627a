//! Synchronises the log to disk in a separate thread, so that a slow disk does not stall the recorder's loop.

use std::fs::File;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// Time between two syncs: the largest loss after a power failure.
const SYNC_PERIOD: Duration = Duration::from_secs(1);

/// Orders to the thread.
enum Order {
    /// Sync this file from now on.
    Follow(File),
    /// The file is complete.
    Close,
}

/// Thread that syncs the current file once per second, and a closed one at once.
pub(super) struct Syncer {
    orders: Option<Sender<Order>>,
    failures: Receiver<std::io::Error>,
    thread: Option<JoinHandle<()>>,
}

impl Syncer {
    /// Starts the thread.
    ///
    /// # Errors
    /// The system allows no further thread.
    pub(super) fn start() -> std::io::Result<Self> {
        let (orders, receiver) = channel();
        let (sender, failures) = channel();
        let body = move || sync_until_told(&receiver, &sender);
        let thread = std::thread::Builder::new().name("log-sync".into()).spawn(body)?;
        Ok(Self { orders: Some(orders), failures, thread: Some(thread) })
    }

    /// Syncs `file` from now on.
    pub(super) fn follow(&self, file: File) {
        self.tell(Order::Follow(file));
    }

    /// Syncs the file a last time.
    pub(super) fn close(&self) {
        self.tell(Order::Close);
    }

    /// Error since the last call, if any.
    pub(super) fn failure(&self) -> Option<std::io::Error> {
        self.failures.try_iter().last()
    }

    fn tell(&self, order: Order) {
        if let Some(orders) = &self.orders {
            // The thread ends only with this end of the channel.
            let _ = orders.send(order);
        }
    }
}

impl Drop for Syncer {
    fn drop(&mut self) {
        drop(self.orders.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn sync_until_told(orders: &Receiver<Order>, failures: &Sender<std::io::Error>) {
    let mut file: Option<File> = None;
    loop {
        let order = orders.recv_timeout(SYNC_PERIOD);
        if let Some(Err(error)) = file.as_ref().map(File::sync_data) {
            let _ = failures.send(error);
            // The kernel reports a lost page once; the recorder continues in another file.
            file = None;
        }
        match order {
            Ok(Order::Follow(next)) => file = Some(next),
            Ok(Order::Close) => file = None,
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::os::fd::OwnedFd;
    use std::time::Instant;

    use super::*;

    #[test]
    fn a_file_is_synced_until_it_is_closed_and_a_failure_is_told_once() {
        let syncer = Syncer::start().unwrap();
        let folder = tempfile::tempdir().unwrap();
        syncer.follow(File::create(folder.path().join("log")).unwrap());
        syncer.close();
        // A pipe has no disk: the system refuses to sync it.
        let (_reader, writer) = std::io::pipe().unwrap();
        syncer.follow(OwnedFd::from(writer).into());
        syncer.close();
        let until = Instant::now() + Duration::from_secs(20);
        let failure = loop {
            match syncer.failure() {
                Some(failure) => break failure,
                None if Instant::now() < until => std::thread::yield_now(),
                None => panic!("no failure was told"),
            }
        };
        assert_eq!(failure.kind(), std::io::ErrorKind::InvalidInput, "{failure}");
        drop(syncer);
    }
}
