//! A feed from a running bench. It polls at a steady rate instead of being woken, so that no node of the loop
//! spends time on it.

use std::time::{Duration, Instant};

use whirlstand_bus::{Bus, OpenError, RecvError};

use crate::collector::{Collector, FRAME};
use crate::ears::Ears;
use crate::foxglove::FoxgloveFeed;
use crate::hub::Hub;

/// Time between two polls of the queues: 1024 messages are 10 ms at 100,000 steps/s, and 0.5 s at 2 kHz.
const LOOK: Duration = Duration::from_millis(10);

/// A feed from the bus. Like the bus, it stays on the thread that opened it.
pub struct BusFeed {
    collector: Collector,
    ears: Ears,
    hub: Hub,
    foxglove: Option<FoxgloveFeed>,
    frame_due: Instant,
    _bus: Bus,
}

impl BusFeed {
    /// Subscribes to a bench, for the viewers of a page and optionally for those with Foxglove.
    ///
    /// # Errors
    /// A port cannot be opened.
    pub fn open(
        bus: Bus,
        collector: Collector,
        hub: Hub,
        foxglove: Option<FoxgloveFeed>,
    ) -> Result<Self, OpenError> {
        let ears = Ears::open(&bus)?;
        Ok(Self { collector, ears, hub, foxglove, frame_due: Instant::now() + FRAME, _bus: bus })
    }

    /// Takes the waiting messages, sends a frame when one is due, and returns the time of the next call.
    ///
    /// # Errors
    /// The transport fails.
    pub fn turn(&mut self, now: Instant) -> Result<Instant, RecvError> {
        let Self { ears, collector, foxglove, .. } = self;
        ears.drain(|heard| {
            collector.hear(heard, now);
            foxglove.iter().for_each(|feed| feed.hear(heard));
        })?;
        if now >= self.frame_due {
            self.show(now, false);
            self.frame_due = now + FRAME;
        }
        Ok(now + LOOK)
    }

    /// Whether the plant has reported the end of its run.
    pub fn plant_has_stopped(&self) -> bool {
        self.collector.plant_has_stopped()
    }

    /// Whether all of these nodes have sent their `Health`.
    pub fn has_heard(&self, nodes: &[String]) -> bool {
        self.collector.has_heard(nodes)
    }

    fn show(&mut self, now: Instant, all_has_come: bool) {
        let frame = self.collector.frame(now, self.ears.lost(), all_has_come);
        self.hub.publish(&frame, frame.anew);
    }

    /// Sends the last messages and leaves the bench. The returned collector can continue with another feed.
    pub fn leave(mut self) -> Collector {
        let now = Instant::now();
        // Messages that the transport could not hand over are lost with the bench.
        let _ = self.turn(now);
        self.show(now, true);
        self.collector
    }
}
