//! Forged messages in the name of nodes, from programs that are not members of the bench.

use std::io;
use std::net::SocketAddr;

use whirlstand_bridge::config::BridgeKind;
use whirlstand_bus::{
    Authority, Bus, BusConfig, Member, OpenError, Protection, Publisher, Transport, Writes, ZenohConfig,
};
use whirlstand_msgs::{Command, Health, Message, NodeState, Truth};
use whirlstand_nodes::config::Role;

use super::again::Again;
use super::ongoing::Ongoing;
use super::strangers::{forged_outputs, garbage, send, udp_ports};
use crate::error::Failure;
use crate::file::Plan;
use crate::keys::{OBSERVER, configuration};

/// A value that no bench produces by itself; it marks forged messages.
pub(in crate::soak) const FORGED: f64 = 777.125;

/// The path by which a stranger reaches the bench.
pub(in crate::soak) enum Forge {
    /// Over Zenoh: the addresses of the bench's nodes.
    Zenoh { bench: String },
    /// Over UDP: a bridge's ports, and the protocol of the bridge.
    Udp { ports: Vec<SocketAddr>, kind: BridgeKind },
}

impl Forge {
    /// Finds the path for a stranger.
    ///
    /// # Errors
    /// When there is none: over shared memory, only processes of this user can publish at all.
    pub fn prepare(plan: &Plan) -> Result<Self, Failure> {
        let ports = udp_ports(plan.config.bridge.as_ref());
        match &plan.config.bridge {
            Some(bridge) if !ports.is_empty() => Ok(Self::Udp { ports, kind: bridge.kind }),
            _ if plan.config.transport == Transport::Zenoh => {
                Ok(Self::Zenoh { bench: plan.config.bench.clone() })
            }
            _ => Err(Failure::Mend(
                "--fault forge: over iceoryx2 a stranger cannot reach the bench (only this user can access its \
                 shared memory): --transport zenoh, or a launch file with a bridge on a UDP port, is expected"
                    .into(),
            )),
        }
    }

    pub fn begin(&self) -> io::Result<Box<dyn Ongoing>> {
        Ok(match self {
            Self::Udp { ports, kind } => {
                let datagrams = [forged_outputs(*kind), garbage()].concat();
                Box::new(send(ports.clone(), datagrams)?)
            }
            Self::Zenoh { bench } => {
                let configs = strangers(bench)?;
                Box::new(Again::start(move || {
                    let mut forgers: Vec<_> = configs.iter().filter_map(|c| Forger::join(c).ok()).collect();
                    move || forgers.iter_mut().map(Forger::forge).sum()
                })?)
            }
        })
    }
}

/// Bus configurations of two strangers that know the addresses of the nodes but have no key of the bench: one has
/// no key, the other a key of another authority.
fn strangers(bench: &str) -> io::Result<Vec<BusConfig>> {
    let path = configuration(bench, OBSERVER).map_err(io::Error::other)?;
    let known: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(path)?)?;
    let endpoints = known["connect"]["endpoints"].as_array().into_iter().flatten();
    let endpoints: Vec<String> = endpoints.filter_map(|e| Some(e.as_str()?.to_string())).collect();
    let stranger = |connect: Vec<String>, protection| {
        let mut config = BusConfig::new(bench, Role::Plant.name(), Transport::Zenoh);
        config.zenoh = ZenohConfig { connect, protection, ..ZenohConfig::default() };
        config
    };
    let identity = Authority::new("a stranger")
        .and_then(|authority| authority.issue(Role::Plant.name(), &["127.0.0.1".into()]))
        .map_err(io::Error::other)?;
    let anything = Member { name: Role::Plant.name().into(), writes: Writes::AllBut(Vec::new()) };
    let foreign = Protection { identity, members: vec![anything] };
    let plain = endpoints.iter().map(|e| e.replace("tls/", "tcp/")).collect();
    Ok(vec![stranger(plain, None), stranger(endpoints, Some(foreign))])
}

/// A stranger that publishes on topics of the bench's nodes.
struct Forger {
    command: Publisher<Command>,
    truth: Publisher<Truth>,
    health: Publisher<Health>,
    _bus: Bus,
}

impl Forger {
    fn join(config: &BusConfig) -> Result<Self, OpenError> {
        let bus = Bus::open(config)?;
        Ok(Self {
            command: bus.publisher()?,
            truth: bus.publisher()?,
            health: bus.publisher_as(Role::Plant.name())?,
            _bus: bus,
        })
    }

    /// Publishes a command to the plant, a truth of step 0 on, and a health in the plant's name. Returns how many
    /// could be sent.
    fn forge(&mut self) -> u64 {
        let mut command = Command { count: 2, ..Message::zeroed() };
        command.u = [FORGED; 8];
        let mut truth = Truth { states: 4, inputs: 2, ..Message::zeroed() };
        truth.x = [FORGED; 16];
        let mut health = Health { pid: 1, deadline_misses: u64::MAX / 2, ..Message::zeroed() };
        health.state = NodeState::Running as u32;
        health.set_node_name(Role::Plant.name());
        let sent = [
            self.command.send(&command).is_ok(),
            self.truth.send(&truth).is_ok(),
            self.health.send(&health).is_ok(),
        ];
        sent.into_iter().map(u64::from).sum()
    }
}
