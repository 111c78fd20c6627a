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

    /// Sends all waiting bytes, and then those of a ground station for which there is room.
    pub fn flush(&mut self) {
        let now = self.now();
        for (port, sender) in &self.senders {
            let bytes = self.vehicle.output(*port);
            if !bytes.is_empty() {
                let (length, has_left) = (bytes.len(), sender.send(bytes));
                bytes.clear();
                self.vehicle.handed_on(*port, length, has_left, now);
            }
        }
        let link = self.senders.iter().find(|(port, _)| *port == Port::Link);
        while let Some((_, sender)) = link.filter(|(_, sender)| sender.has_room())
            && let Some(frame) = self.vehicle.next_forwarded(now)
        {
            sender.send(&frame);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bridge::link::{Link, LinkEvent};
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
    use whirlstand_bridge::config::{BridgeConfig, BridgeKind};
    use whirlstand_bridge::turning::{inputs_of, own_motion_of};
    use whirlstand_bridge::vehicle::Bench;

    #[test]
    fn an_output_to_a_closed_line_is_not_logged_as_sent() {
        let plant = whirlstand_vehicle::Vehicle::builtin("quadrotor").unwrap();
        let options = serde_json::from_str(
            r#"{"safety": {"arm": "start"}, "crsf": {"link": "serial:///dev/x:420000"}}"#,
        );
        let config = BridgeConfig { kind: BridgeKind::Crsf, options: options.unwrap() };
        let bench = Bench {
            inputs: inputs_of(&plant),
            own: own_motion_of(&plant),
            rate_hz: 100.0,
            wants_odometry: false,
            signing: None,
        };
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let path = ptsname(&master, Vec::new()).unwrap().into_string().unwrap();
        let mut link = Link::new(format!("serial://{path}:420000").parse().unwrap());
        let gate = Gate::new(crate::signals::input_limits(&plant).unwrap(), 1);
        let senders = vec![(Port::Link, link.sender())];
        let mut shared =
            SharedVehicle::new(Vehicle::new(&config, bench).unwrap(), gate, senders, Instant::now());
        let mut sent = |at| {
            shared.vehicle.poll(at);
            shared.flush();
            (shared.vehicle.sent(at), shared.dropped())
        };
        let (closed, dropped) = sent(Duration::from_secs(1));
        assert!(closed.channels.iter().chain(&closed.u[..2]).all(|v| v.is_nan()), "{closed:?}");
        assert_eq!((closed.messages, dropped), (0, 1));
        assert_eq!(link.maintain(Instant::now()), Some(LinkEvent::Up));
        let (open, dropped) = sent(Duration::from_secs(2));
        assert!(open.channels.iter().chain(&open.u[..2]).all(|v| v.is_finite()), "{open:?}");
        assert_eq!((open.messages, dropped), (1, 1));
    }
}
