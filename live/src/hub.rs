//! Sends every frame to all viewers without waiting. A viewer that does not read misses frames and is told so.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde_json::Value;
use tokio::sync::broadcast::{Receiver, Sender, channel};

/// Most frames that a viewer may be behind: 12 s.
const BEHIND: usize = 256;

/// Frames that a new viewer receives first: the last 60 s.
const KEPT: usize = 1200;

/// Most bytes of these frames.
const KEPT_BYTES: usize = 32 << 20;

/// A frame as text, or the end of the stream.
#[derive(Debug, Clone)]
pub(crate) enum Sent {
    Frame(Arc<str>),
    End,
}

#[derive(Debug, Default)]
struct Kept {
    greeting: Option<Arc<str>>,
    frames: VecDeque<Arc<str>>,
    bytes: usize,
    ended: bool,
}

/// Distributes frames to the viewers.
#[derive(Debug, Clone)]
pub struct Hub {
    sender: Sender<Sent>,
    kept: Arc<Mutex<Kept>>,
}

impl Default for Hub {
    fn default() -> Self {
        Self { sender: channel(BEHIND).0, kept: Arc::default() }
    }
}

impl Hub {
    /// Sets the greeting that every viewer receives first, and discards the kept frames.
    pub(crate) fn greet(&self, greeting: &Value) {
        let text: Arc<str> = greeting.to_string().into();
        let mut kept = self.kept();
        *kept = Kept { greeting: Some(text.clone()), ended: kept.ended, ..Kept::default() };
        let _ = self.sender.send(Sent::Frame(text));
    }

    /// Sends a frame, and keeps it for later viewers.
    pub(crate) fn publish(&self, frame: &impl serde::Serialize, anew: bool) {
        // Frames are plain data that JSON always accepts.
        let Ok(text) = serde_json::to_string(frame) else { return };
        let text: Arc<str> = text.into();
        let mut kept = self.kept();
        if anew {
            kept.frames.clear();
            kept.bytes = 0;
        }
        kept.bytes += text.len();
        kept.frames.push_back(text.clone());
        while kept.frames.len() > KEPT || kept.bytes > KEPT_BYTES {
            let Some(oldest) = kept.frames.pop_front() else { break };
            kept.bytes -= oldest.len();
        }
        // An error means that there is no viewer.
        let _ = self.sender.send(Sent::Frame(text));
    }

    /// Tells the viewers that nothing more will come, and why.
    pub fn end(&self, why: &str) {
        let mut kept = self.kept();
        if std::mem::replace(&mut kept.ended, true) {
            return;
        }
        let text: Arc<str> = serde_json::json!({ "over": why }).to_string().into();
        kept.frames.push_back(text.clone());
        let _ = self.sender.send(Sent::Frame(text));
        let _ = self.sender.send(Sent::End);
    }

    /// The frames that a new viewer needs, a receiver of the following frames, and whether the stream has
    /// ended.
    pub(crate) fn join(&self) -> (VecDeque<Arc<str>>, Receiver<Sent>, bool) {
        let kept = self.kept();
        let told = kept.greeting.iter().chain(&kept.frames).cloned().collect();
        (told, self.sender.subscribe(), kept.ended)
    }

    /// Number of connected viewers.
    pub fn viewers(&self) -> usize {
        self.sender.receiver_count()
    }

    fn kept(&self) -> MutexGuard<'_, Kept> {
        // After a panic in another thread the data are still a valid list of frames.
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::sync::broadcast::error::TryRecvError;

    #[test]
    fn a_viewer_that_does_not_read_costs_a_bounded_queue_and_learns_what_it_missed() {
        let hub = Hub::default();
        hub.greet(&serde_json::json!({ "scene": 1 }));
        let (told, mut stalled, _) = hub.join();
        assert_eq!(told.len(), 1);
        (0..5000).for_each(|i| hub.publish(&i, false));
        assert!(matches!(stalled.try_recv(), Err(TryRecvError::Lagged(n)) if n == 5000 - BEHIND as u64));
        assert!(matches!(stalled.try_recv(), Ok(Sent::Frame(text)) if *text == *"4744"));
        let (told, _late, ended) = hub.join();
        assert_eq!((told.len(), &*told[1], ended), (1 + KEPT, "3800", false));
        hub.publish(&0, true);
        hub.end("over");
        let (told, _, ended) = hub.join();
        assert_eq!((told.len(), &*told[2], ended), (3, r#"{"over":"over"}"#, true));
    }
}
