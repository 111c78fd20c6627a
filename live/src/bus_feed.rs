//! Hears a running bench: at a steady pace instead of being woken, so that nobody in the loop pays for it.

use std::time::{Duration, Instant};

use whirlstand_bus::{Bus, OpenError, RecvError};

use crate::collector::{Collector, FRAME};
use crate::heard::Ears;
use crate::hub::Hub;

/// Time between two looks at the queues: 1024 messages are 10 ms at 100,000 steps/s, and 0.5 s at 2 kHz.
const LOOK: Duration = Duration::from_millis(10);

/// A feed from the bus. Like the bus it stays on the thread that opened it.
pub struct BusFeed {
    collector: Collector,
    ears: Ears,
    hub: Hub,
    frame_due: Instant,
    _bus: Bus,
}

impl BusFeed {
    /// Listens to a bench.
    ///
    /// # Errors
    /// A port cannot be opened.
    pub fn open(bus: Bus, collector: Collector, hub: Hub) -> Result<Self, OpenError> {
        let ears = Ears::open(&bus)?;
        Ok(Self { collector, ears, hub, frame_due: Instant::now() + FRAME, _bus: bus })
    }

    /// Takes what waits, hands on a frame when it is due, and says when to look next.
    ///
    /// # Errors
    /// The transport fails.
    pub fn turn(&mut self, now: Instant) -> Result<Instant, RecvError> {
        let Self { ears, collector, .. } = self;
        ears.drain(|heard| collector.hear(heard, now))?;
        if now >= self.frame_due {
            let frame = self.collector.frame(now, self.ears.lost(), false);
            self.hub.publish(&frame, frame.anew);
            self.frame_due = now + FRAME;
        }
        Ok(now + LOOK)
    }

    /// Hands on what came last, and leaves the bench; what was collected goes on elsewhere.
    pub fn leave(mut self) -> Collector {
        let now = Instant::now();
        // What the transport could not hand over is lost with the bench.
        let _ = self.turn(now);
        let frame = self.collector.frame(now, self.ears.lost(), true);
        self.hub.publish(&frame, frame.anew);
        self.collector
    }
}
