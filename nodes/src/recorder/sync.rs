//! Puts the log on the disk itself, beside the recorder's own loop: a disk that takes its time stalls nobody.

use std::fs::File;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// Time between two syncs: what a loss of power may cost.
const SYNC_PERIOD: Duration = Duration::from_secs(1);

/// What the thread is told.
enum Order {
    /// The file that is being written from now on.
    Follow(File),
    /// No more is written into the file.
    Close,
}

/// A thread that syncs the file at hand once a second, and one that is closed at once.
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

    /// Syncs the file once more, and not again.
    pub(super) fn close(&self) {
        self.tell(Order::Close);
    }

    /// What went wrong since the last time that this was asked.
    pub(super) fn failure(&self) -> Option<std::io::Error> {
        self.failures.try_iter().last()
    }

    fn tell(&self, order: Order) {
        if let Some(orders) = &self.orders {
            // The thread ends with this end of the channel only.
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
            // The kernel tells a lost page once; the recorder goes on in another file.
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
