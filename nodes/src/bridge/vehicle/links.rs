//! Links of a bridge to a vehicle.

use std::sync::Mutex;
use std::time::{Duration, Instant};

use whirlstand_bridge::config::{BridgeConfig, BridgeKind, PilotSource};
use whirlstand_bridge::vehicle::{Port, Vehicle};

use super::super::link::{BUFFER, Decoder, Link, LinkEvent, configured, wait_for_bytes};
use super::shared_vehicle::{SharedVehicle, lock};
use crate::error::NodeError;
use crate::gate::Gate;

/// All links, owned by the receiving thread.
pub(in crate::bridge) struct VehicleLinks {
    pub links: Vec<(Port, Link)>,
    buffer: Vec<u8>,
}

impl VehicleLinks {
    /// The links of the options.
    ///
    /// # Errors
    /// An address cannot be read.
    pub fn new(config: &BridgeConfig) -> Result<Self, NodeError> {
        let options = &config.options;
        let mut links = Vec::new();
        // A heartbeat is sent once per second, and a single one may be lost without replacing the peer.
        let silence = Duration::from_secs_f64(options.safety.link_timeout_s);
        let mut add = |port, table: &str, key: &str, text: &str, pin| {
            configured(table, key, text, pin, silence).map(|link| links.push((port, link)))
        };
        match (config.kind, &options.mavlink, &options.crsf) {
            (BridgeKind::Mavlink, Some(own), _) => {
                add(Port::Link, "mavlink", "link", &own.link, own.peer)?;
                if let Some(link) = &own.output_link {
                    add(Port::Output, "mavlink", "output_link", link, None)?;
                }
                if let Some(link) = &own.forward {
                    add(Port::Ground, "mavlink", "forward", link, None)?;
                }
            }
            (BridgeKind::Crsf, _, Some(own)) => add(Port::Link, "crsf", "link", &own.link, None)?,
            _ => {}
        }
        if let Some(pilot) = &options.pilot {
            match (pilot.source, &pilot.link) {
                (PilotSource::Sbus | PilotSource::Crsf, Some(link)) => {
                    add(Port::Pilot, "pilot", "link", link, None)?;
                }
                (PilotSource::Sbus | PilotSource::Crsf, None) => {
                    return Err(NodeError::Config {
                        field: "bridge.pilot.link".into(),
                        value: "nothing".into(),
                        reason: "the receiver needs its serial port".into(),
                    });
                }
                (PilotSource::Mavlink | PilotSource::Gamepad, _) => {}
            }
        }
        Ok(Self { links, buffer: vec![0; BUFFER] })
    }

    /// Text on which part of the vehicle is awaited before the first step, and on which link.
    pub fn awaited(&self) -> String {
        let link = self.links.iter().find(|(port, _)| *port == Port::Link);
        let place = link.map_or(String::new(), |(_, link)| format!(" on {}", link.address().place()));
        format!("the vehicle's attitude{place}")
    }

    /// The vehicle with its sending links, shared by both threads.
    pub fn share(&self, vehicle: Vehicle, gate: Gate, origin: Instant) -> SharedVehicle {
        let senders = self.links.iter().map(|(port, link)| (*port, link.sender())).collect();
        SharedVehicle::new(vehicle, gate, senders, origin)
    }

    /// Waits for bytes, for at most `limit`, or until a closed link must be retried.
    pub fn wait(&self, limit: Duration) {
        let now = Instant::now();
        let retry = self.links.iter().filter_map(|(_, link)| link.retry_at());
        let left = retry.fold(limit, |left, at| left.min(at.saturating_duration_since(now)));
        // Both outcomes lead to another poll.
        wait_for_bytes(self.links.iter().filter_map(|(_, link)| link.fd()), now + left, Duration::ZERO);
    }

    /// Opens closed links, and receives waiting bytes, up to a limit. Returns whether a new attitude arrived.
    pub fn turn(&mut self, shared: &Mutex<SharedVehicle>) -> bool {
        let mut fresh = false;
        let now = Instant::now();
        for (port, link) in &mut self.links {
            let port = *port;
            match link.maintain(now) {
                Some(LinkEvent::Up) => {
                    tracing::info!("{} is open", name(port));
                    lock(shared).vehicle.connected(port);
                }
                Some(LinkEvent::Down(why)) => closed(shared, port, &why),
                Some(LinkEvent::Replaced(why)) => {
                    tracing::warn!("{}: {why}", name(port));
                    lock(shared).vehicle.peer_changed(port);
                }
                None => {}
            }
            let mut protocol = Protocol { shared, port, fresh: false };
            if let Err(LinkEvent::Down(why)) = link.drain(&mut self.buffer, now, &mut protocol) {
                closed(shared, port, &why);
            }
            fresh |= protocol.fresh;
            while let Some((warn, text)) = link.take_note() {
                if warn {
                    tracing::warn!("{}: {text}", name(port));
                } else {
                    tracing::info!("{}: {text}", name(port));
                }
            }
        }
        fresh
    }

    /// Number of datagrams and clients refused because of their sender.
    pub fn refused(&self) -> u64 {
        self.links.iter().map(|(_, link)| link.refused().sum()).sum()
    }
}

/// Decoder of the vehicle's protocol on one of its ports.
struct Protocol<'a> {
    shared: &'a Mutex<SharedVehicle>,
    port: Port,
    /// True when a new attitude arrived.
    fresh: bool,
}

impl Decoder for Protocol<'_> {
    fn recognises(&mut self, datagram: &[u8]) -> bool {
        let mut shared = lock(self.shared);
        let now = shared.now();
        shared.vehicle.recognises(self.port, datagram, now)
    }

    fn peer_changed(&mut self) {
        lock(self.shared).vehicle.peer_changed(self.port);
    }

    fn decode(&mut self, bytes: &[u8], is_datagram: bool) -> bool {
        let mut shared = lock(self.shared);
        let now = shared.now();
        let received = shared.vehicle.receive(self.port, bytes, is_datagram, now);
        shared.flush();
        self.fresh |= received.attitude;
        received.valid
    }
}

/// Handles a link that was closed, or cannot be opened.
fn closed(shared: &Mutex<SharedVehicle>, port: Port, why: &str) {
    tracing::warn!("{}: {why}", name(port));
    lock(shared).vehicle.closed(port);
}

fn name(port: Port) -> &'static str {
    match port {
        Port::Link => "the vehicle's link",
        Port::Output => "the line of the channels",
        Port::Pilot => "the pilot's line",
        Port::Ground => "the ground station's link",
    }
}
