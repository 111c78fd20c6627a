//! What of the vehicle the two threads of its bridge share.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use whirlstand_bridge::vehicle::{Port, Vehicle};

use super::super::link::LinkSender;
use super::duplicate_filter::DuplicateFilter;
use crate::gate::Gate;

/// The vehicle, the gate in front of it, and the way out.
pub(in crate::bridge) struct SharedVehicle {
    pub vehicle: Vehicle,
    pub gate: Gate,
    /// The step whose command counts; `None` before step 0.
    pub awaited: Option<u64>,
    /// When that step was published.
    pub published: Instant,
    /// How long the command of that step took.
    pub latency: Option<Duration>,
    /// Messages that one of the two threads has received.
    pub(super) received: DuplicateFilter,
    senders: Vec<(Port, LinkSender)>,
    origin: Instant,
}

impl SharedVehicle {
    /// A vehicle of which no step was published; `origin` is the zero of its time.
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

    /// Time as the vehicle's state machine counts it.
    pub fn now(&self) -> Duration {
        self.origin.elapsed()
    }

    /// Sends what waits to be sent.
    pub fn flush(&mut self) {
        for (port, sender) in &self.senders {
            let bytes = self.vehicle.output(*port);
            if !bytes.is_empty() {
                sender.send(bytes);
                bytes.clear();
            }
        }
    }

    /// Messages to hardware that could not go out.
    pub fn dropped(&self) -> u64 {
        self.senders.iter().filter(|(port, _)| *port != Port::Ground).map(|(_, s)| s.dropped()).sum()
    }
}

/// The vehicle behind its lock; a thread that panicked has ended the process.
pub(in crate::bridge) fn lock(shared: &Mutex<SharedVehicle>) -> MutexGuard<'_, SharedVehicle> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}
