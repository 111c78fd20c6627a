//! What the bridge hears on the bus, on each of its two threads.
//!
//! The thread of the measurements stays awake for the answer to the one that it has just published, which saves a fast
//! controller the wake-up of another thread; the thread of the commands sleeps on the bus and takes what comes later. Both
//! hear every message, and whoever is first takes it.

use std::collections::VecDeque;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use whirlstand_bus::{Bus, Subscriber};
use whirlstand_msgs::{Command, Estimate, Head, MAX_STATES};

use super::wires::{Core, lock};
use crate::error::NodeError;
use crate::gate::Fault;
use crate::ports::receive;

/// Queue for commands and estimates; one of each is awaited at a time.
const DEPTH: usize = 16;

/// Which thread listens.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Ear {
    /// That of the measurements.
    Measurements,
    /// That of the commands.
    Commands,
}

/// The messages that one of the two ears has heard and the other has not: at most what a queue can hold.
#[derive(Debug)]
pub(in crate::bridge) struct Heard(VecDeque<(Ear, &'static str, u64, u64)>);

impl Default for Heard {
    fn default() -> Self {
        Self(VecDeque::with_capacity(4 * DEPTH))
    }
}

impl Heard {
    /// Whether the other ear has not heard this message yet.
    fn is_news(&mut self, ear: Ear, topic: &'static str, head: &Head) -> bool {
        let same = |h: &(Ear, &str, u64, u64)| h.0 != ear && (h.1, h.2, h.3) == (topic, head.seq, head.step);
        if let Some(at) = self.0.iter().position(same) {
            self.0.remove(at);
            return false;
        }
        if self.0.len() == 4 * DEPTH {
            self.0.pop_front();
        }
        self.0.push_back((ear, topic, head.seq, head.step));
        true
    }
}

/// Counts of what was not taken, by the thread of the commands, which hears all.
#[derive(Debug, Default)]
pub(super) struct Counts {
    pub lost: AtomicU64,
    pub refused: AtomicU64,
}

/// The subscriptions of a thread.
pub(super) struct Ears {
    ear: Ear,
    commands: Subscriber<Command>,
    estimates: Subscriber<Estimate>,
}

impl Ears {
    /// Opens the subscriptions.
    pub(super) fn open(bus: &Bus, ear: Ear) -> Result<Self, NodeError> {
        Ok(Self { ear, commands: bus.subscriber(DEPTH)?, estimates: bus.subscriber(DEPTH)? })
    }

    /// Takes in all that has come.
    ///
    /// # Errors
    /// The transport fails.
    pub(super) fn listen(&mut self, core: &Mutex<Core>, counts: &Counts) -> Result<(), NodeError> {
        let mut refused = 0;
        while let Some(estimate) = receive(&mut self.estimates, &mut refused)? {
            let mut core = lock(core);
            if core.heard.is_news(self.ear, "estimate", &estimate.head) {
                let states = (estimate.count as usize).min(MAX_STATES);
                let now = core.now();
                core.vehicle.estimate(&estimate.x[..states], estimate.nis, estimate.dof, now);
            }
        }
        while let Some(command) = receive(&mut self.commands, &mut refused)? {
            let mut core = lock(core);
            if core.heard.is_news(self.ear, "command", &command.head) {
                obey(&mut core, &command);
            }
        }
        if self.ear == Ear::Commands {
            counts.lost.store(self.commands.lost() + self.estimates.lost(), Ordering::Relaxed);
            counts.refused.fetch_add(refused, Ordering::Relaxed);
        }
        Ok(())
    }
}

fn obey(core: &mut Core, command: &Command) {
    let Some(awaited) = core.awaited else { return };
    let now = core.now();
    match core.gate.offer(command, awaited) {
        Ok(()) | Err(Fault::OutOfRange) => {
            if let Some(accepted) = core.gate.accepted() {
                let count = command.count as usize;
                core.vehicle.command(&accepted.u[..count], now);
                core.flush();
                // The answer to step 0 waits for a whole bench to get ready.
                core.latency = (awaited > 0).then(|| core.published.elapsed());
            }
        }
        // It is refused, and the controller is no longer believed.
        Err(Fault::NotFinite) => {
            core.vehicle.command(&[f64::NAN], now);
            core.flush();
        }
        Err(Fault::WrongCount | Fault::Stale | Fault::Early | Fault::Repeated) => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_message_is_taken_once_whoever_hears_it_first() {
        let mut heard = Heard::default();
        let head = |seq, step| Head { seq, step, stamp_ns: 0 };
        let mut news = |ear, topic, seq, step| heard.is_news(ear, topic, &head(seq, step));
        use Ear::{Commands, Measurements};
        assert!(news(Measurements, "command", 0, 7));
        assert!(news(Measurements, "estimate", 0, 7), "another topic");
        assert!(!news(Commands, "command", 0, 7));
        assert!(news(Commands, "command", 1, 8));
        assert!(!news(Measurements, "command", 1, 8));
        // One that was sent twice is heard twice by each.
        assert!(news(Commands, "command", 1, 8) && news(Commands, "command", 1, 8));
        assert!(!news(Measurements, "command", 1, 8) && !news(Measurements, "command", 1, 8));
        assert!(news(Measurements, "command", 1, 8));
    }

    #[test]
    fn an_ear_that_slept_takes_nothing_again() {
        let mut heard = Heard::default();
        let head = |seq| Head { seq, step: seq, stamp_ns: 0 };
        for seq in 0..1000 {
            assert!(heard.is_news(Ear::Commands, "command", &head(seq)));
        }
        // Its queue holds the newest.
        for seq in 1000 - DEPTH as u64..1000 {
            assert!(!heard.is_news(Ear::Measurements, "command", &head(seq)));
        }
        assert!(heard.0.len() <= 4 * DEPTH);
    }
}
