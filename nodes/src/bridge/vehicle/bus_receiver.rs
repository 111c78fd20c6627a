//! Receives messages from the bus on each of the bridge's two threads.
//!
//! The thread of the measurements polls for the answer to the measurement that it has just published, which
//! saves a fast controller the wake-up of another thread; the thread of the commands sleeps on the bus and
//! takes later messages. Both receive every message, and the first one processes it.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use whirlstand_bus::{Bus, Subscriber};
use whirlstand_msgs::{Command, Estimate, MAX_STATES};

use super::duplicate_filter::{DEPTH, Reader};
use super::shared_vehicle::{SharedVehicle, lock};
use crate::error::NodeError;
use crate::gate::Fault;
use crate::ports::receive;

/// Counters of unused messages, updated by the thread of the commands, which receives all.
#[derive(Debug, Default)]
pub(super) struct Counts {
    pub lost: AtomicU64,
    pub refused: AtomicU64,
}

/// Subscriptions of one thread.
pub(super) struct BusReceiver {
    reader: Reader,
    commands: Subscriber<Command>,
    estimates: Subscriber<Estimate>,
}

impl BusReceiver {
    /// Opens the subscriptions.
    pub(super) fn open(bus: &Bus, reader: Reader) -> Result<Self, NodeError> {
        Ok(Self { reader, commands: bus.subscriber(DEPTH)?, estimates: bus.subscriber(DEPTH)? })
    }

    /// Receives all waiting messages.
    ///
    /// # Errors
    /// The transport fails.
    pub(super) fn receive_all(
        &mut self,
        shared: &Mutex<SharedVehicle>,
        counts: &Counts,
    ) -> Result<(), NodeError> {
        let mut refused = 0;
        while let Some(estimate) = receive(&mut self.estimates, &mut refused)? {
            let mut shared = lock(shared);
            if shared.received.is_new(self.reader, "estimate", &estimate.head) {
                let states = (estimate.count as usize).min(MAX_STATES);
                let now = shared.now();
                shared.vehicle.estimate(&estimate.x[..states], estimate.nis, estimate.dof, now);
            }
        }
        while let Some(command) = receive(&mut self.commands, &mut refused)? {
            let mut shared = lock(shared);
            if shared.received.is_new(self.reader, "command", &command.head) {
                apply(&mut shared, &command);
            }
        }
        if self.reader == Reader::Commands {
            counts.lost.store(self.commands.lost().saturating_add(self.estimates.lost()), Ordering::Relaxed);
            counts.refused.fetch_add(refused, Ordering::Relaxed);
        }
        Ok(())
    }
}

fn apply(shared: &mut SharedVehicle, command: &Command) {
    let Some(awaited) = shared.awaited else { return };
    let now = shared.now();
    match shared.gate.offer(command, awaited) {
        Ok(()) | Err(Fault::OutOfRange) => {
            if let Some(accepted) = shared.gate.accepted() {
                let count = command.count as usize;
                shared.vehicle.command(&accepted.u[..count], now);
                shared.flush();
                // The answer to step 0 includes the start of the whole bench, so that its latency does not
                // count.
                shared.latency = (awaited > 0).then(|| shared.published.elapsed());
            }
        }
        // The command is refused, and the controller is no longer trusted.
        Err(Fault::NotFinite) => {
            shared.vehicle.command(&[f64::NAN], now);
            shared.flush();
        }
        Err(Fault::WrongCount | Fault::Stale | Fault::Early | Fault::Repeated | Fault::Withheld) => {}
    }
}
