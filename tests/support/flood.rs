//! A sender of unsolicited datagrams at a given rate.

use std::net::UdpSocket;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// Datagrams between two pauses.
const BATCH: usize = 20;

/// A flood of 10,000 datagrams a second, from one socket to each of some ports in turn, until it is dropped.
pub struct Flood {
    stop: Arc<AtomicBool>,
    sent: Arc<AtomicU64>,
    thread: Option<JoinHandle<()>>,
}

impl Flood {
    pub fn start(ports: &[u16], datagrams: Vec<Vec<u8>>) -> Self {
        let (stop, sent) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
        let (ends, counts, ports) = (stop.clone(), sent.clone(), ports.to_vec());
        let thread = std::thread::spawn(move || {
            let socket = UdpSocket::bind("127.0.0.1:0").expect("a free port");
            let pairs = || datagrams.iter().flat_map(|d| ports.iter().map(move |port| (d, *port)));
            let mut next = std::iter::repeat_with(pairs).flatten();
            while !ends.load(Ordering::Relaxed) {
                for (datagram, port) in next.by_ref().take(BATCH) {
                    // No process has the port before and after the bench.
                    let _ = socket.send_to(datagram, ("127.0.0.1", port));
                    counts.fetch_add(1, Ordering::Relaxed);
                }
                std::thread::sleep(Duration::from_millis(2));
            }
        });
        Self { stop, sent, thread: Some(thread) }
    }

    /// Number of datagrams sent so far.
    pub fn sent(&self) -> u64 {
        self.sent.load(Ordering::Relaxed)
    }
}

impl Drop for Flood {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Malformed datagrams: single bytes, beginnings of frames, and arbitrary bytes.
pub fn garbage() -> Vec<Vec<u8>> {
    let mut state = 1u32;
    let mut byte = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    let noise = (0..40).map(|n| (0..n * 3).map(|_| byte()).collect());
    [vec![0xFD], vec![0xFE], vec![0], vec![0xFD; 40], vec![0xFD, 255, 0, 0, 1]]
        .into_iter()
        .chain(noise)
        .collect()
}
