//! A flood of messages: ten thousand a second.

use std::io;
use std::net::SocketAddr;

use whirlstand_bus::{Bus, BusConfig, OpenError, Publisher, Transport};
use whirlstand_msgs::{Disturbance, Message};
use whirlstand_nodes::plant::INJECT_TOPIC;

use super::again::Again;
use super::ongoing::Ongoing;
use super::strangers::{garbage, send, udp_ports};
use crate::file::Plan;
use crate::keys::{GUEST, configuration};

/// Messages in one burst.
const BURST: u64 = 20;

/// Destination of the flood.
pub(in crate::soak) enum Flood {
    /// Meaningless datagrams to the ports of a bridge.
    Udp(Vec<SocketAddr>),
    /// Disturbances of size zero to the plant, from a member of the bench that may publish them.
    Inject { bench: String, transport: Transport, states: u32 },
}

impl Flood {
    /// Chooses the destination. Where the bench has no bridge on a UDP port, the plan is changed so that the
    /// plant accepts disturbances.
    pub fn prepare(plan: &mut Plan) -> Self {
        let ports = udp_ports(plan.config.bridge.as_ref());
        if !ports.is_empty() {
            return Self::Udp(ports);
        }
        plan.config.plant.inject = true;
        Self::Inject {
            bench: plan.config.bench.clone(),
            transport: plan.config.transport,
            states: plan.vehicle.states.len() as u32,
        }
    }

    pub fn begin(&self) -> io::Result<Box<dyn Ongoing>> {
        Ok(match self {
            Self::Udp(ports) => Box::new(send(ports.clone(), garbage())?),
            Self::Inject { bench, transport, states } => {
                let mut config = BusConfig::new(bench, GUEST, *transport);
                if *transport == Transport::Zenoh {
                    config.zenoh.config = Some(configuration(bench, GUEST).map_err(io::Error::other)?);
                }
                let states = *states;
                Box::new(Again::start(move || {
                    let mut joined = join(&config).ok();
                    move || joined.as_mut().map_or(0, |(_, publisher)| burst(publisher, states))
                })?)
            }
        })
    }
}

fn join(config: &BusConfig) -> Result<(Bus, Publisher<Disturbance>), OpenError> {
    let bus = Bus::open(config)?;
    let publisher = bus.publisher_on(INJECT_TOPIC)?;
    Ok((bus, publisher))
}

/// Sends one burst of valid messages, and returns how many could be sent.
fn burst(publisher: &mut Publisher<Disturbance>, states: u32) -> u64 {
    let nothing = Disturbance { count: states, ..Message::zeroed() };
    (0..BURST).map(|_| u64::from(publisher.send(&nothing).is_ok())).sum()
}
