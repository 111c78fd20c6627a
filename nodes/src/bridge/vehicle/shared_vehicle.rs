//! The vehicle as shared by the two threads of its bridge.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use whirlstand_bridge::vehicle::{Port, Vehicle};

use super::super::link::LinkSender;
use super::duplicate_filter::DuplicateFilter;
use crate::gate::Gate;

/// The vehicle, the command gate, and the sending links.
pub(in crate::bridge) struct SharedVehicle {
    pub vehicle: Vehicle,
    pub gate: Gate,
    /// Step whose command is awaited; `None` before step 0.
    pub awaited: Option<u64>,
    /// Time at which that step was published.
    pub published: Instant,
    /// Time until the command of that step arrived.
    pub latency: Option<Duration>,
    /// Messages received by only one of the two threads.
    pub(super) received: DuplicateFilter,
    senders: Vec<(Port, LinkSender)>,
    origin: Instant,
}

impl SharedVehicle {
    /// A vehicle without a published step; `origin` is the zero of its time.
    pub(super) fn new(
        vehicle: Vehicle,
        gate: Gate,
        senders: Vec<(Port, LinkSender)>,
        origin: Instant,
    ) -> Self {
        Self {
            vehicle,
            gate,
            awaited: None,
            published: origin,
            latency: None,
            received: DuplicateFilter::default(),
            senders,
            origin,
        }
    }

    /// Time of the vehicle's state machine.
    pub fn now(&self) -> Duration {
        self.origin.elapsed()
    }

    /// Sends all waiting bytes.
    pub fn flush(&mut self) {
        for (port, sender) in &self.senders {
            let bytes = self.vehicle.output(*port);
            if !bytes.is_empty() {
                sender.send(bytes);
                bytes.clear();
            }
        }
    }

    /// Number of messages to hardware that could not be sent.
    pub fn dropped(&self) -> u64 {
        self.senders.iter().filter(|(port, _)| *port != Port::Ground).map(|(_, s)| s.dropped()).sum()
    }
}

/// The vehicle behind its lock; a thread that panicked has ended the process.
pub(in crate::bridge) fn lock(shared: &Mutex<SharedVehicle>) -> MutexGuard<'_, SharedVehicle> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}
