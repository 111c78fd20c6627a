//! The links of a bridge to a vehicle.

use std::sync::Mutex;
use std::time::{Duration, Instant};

use whirlstand_bridge::config::{BridgeConfig, BridgeKind, PilotSource};
use whirlstand_bridge::vehicle::{Port, Vehicle};

use super::super::link::{Address, Link, LinkEvent, Received, wait_for_bytes};
use super::shared_vehicle::{SharedVehicle, lock};
use crate::error::NodeError;
use crate::gate::Gate;

/// Longest datagram, and most of a stream taken at once.
const BUFFER: usize = 4096;

/// Pieces taken from one link before the others and the steps have their turn: a flood must not hold them up.
const AT_ONCE: usize = 64;

/// The links, on the thread that receives.
pub(in crate::bridge) struct VehicleLinks {
    pub links: Vec<(Port, Link)>,
    buffer: Vec<u8>,
}

impl VehicleLinks {
    /// The links that the options ask for.
    ///
    /// # Errors
    /// An address cannot be read.
    pub fn new(config: &BridgeConfig) -> Result<Self, NodeError> {
        let options = &config.options;
        let mut links = Vec::new();
        let mut add = |port, key: &str, text: &str| match text.parse::<Address>() {
            Ok(address) => {
                links.push((port, Link::new(address)));
                Ok(())
            }
            Err(e) => Err(NodeError::Config {
                field: format!("bridge.{key}"),
                value: text.into(),
                reason: e.to_string(),
            }),
        };
        match (config.kind, &options.mavlink, &options.crsf) {
            (BridgeKind::Mavlink, Some(own), _) => {
                add(Port::Link, "mavlink.link", &own.link)?;
                if let Some(link) = &own.output_link {
                    add(Port::Output, "mavlink.output_link", link)?;
                }
                if let Some(link) = &own.forward {
                    add(Port::Ground, "mavlink.forward", link)?;
                }
            }
            (BridgeKind::Crsf, _, Some(own)) => add(Port::Link, "crsf.link", &own.link)?,
            _ => {}
        }
        if let Some(pilot) = &options.pilot {
            match (pilot.source, &pilot.link) {
                (PilotSource::Sbus | PilotSource::Crsf, Some(link)) => add(Port::Pilot, "pilot.link", link)?,
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

    /// The vehicle as both threads share it, with the ways out over these links.
    pub fn share(&self, vehicle: Vehicle, gate: Gate, origin: Instant) -> SharedVehicle {
        let senders = self.links.iter().map(|(port, link)| (*port, link.sender())).collect();
        SharedVehicle::new(vehicle, gate, senders, origin)
    }

    /// Waits for bytes, for at most `limit`, or until a link that is down is to be tried again.
    pub fn wait(&self, limit: Duration) {
        let now = Instant::now();
        let retry = self.links.iter().filter_map(|(_, link)| link.retry_at());
        let left = retry.fold(limit, |left, at| left.min(at.saturating_duration_since(now)));
        // Both outcomes mean the same: look again.
        wait_for_bytes(self.links.iter().filter_map(|(_, link)| link.fd()), now + left, Duration::ZERO);
    }

    /// Opens what is down, and takes in what came. Returns whether a new attitude came.
    pub fn turn(&mut self, shared: &Mutex<SharedVehicle>) -> bool {
        let mut fresh = false;
        for (port, link) in &mut self.links {
            if let Some(event) = link.maintain(Instant::now()) {
                log_event(*port, &event);
                if event == LinkEvent::Up {
                    lock(shared).vehicle.connected(*port);
                }
            }
            for _ in 0..AT_ONCE {
                let (bytes, end) = match link.receive(&mut self.buffer) {
                    Ok(Received::Nothing) => break,
                    Ok(Received::Stream(length)) => (&self.buffer[..length], false),
                    Ok(Received::Datagram(length)) => (&self.buffer[..length], true),
                    Err(event) => {
                        log_event(*port, &event);
                        break;
                    }
                };
                let mut shared = lock(shared);
                let now = shared.now();
                fresh |= shared.vehicle.receive(*port, bytes, end, now);
                shared.flush();
            }
        }
        fresh
    }
}

fn log_event(port: Port, event: &LinkEvent) {
    let what = match port {
        Port::Link => "the vehicle's link",
        Port::Output => "the line of the channels",
        Port::Pilot => "the pilot's line",
        Port::Ground => "the ground station's link",
    };
    match event {
        LinkEvent::Up => tracing::info!("{what} is open"),
        LinkEvent::Down(why) => tracing::warn!("{what}: {why}"),
    }
}
