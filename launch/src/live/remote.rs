//! A bench on another host, described by its launch file, including the endpoints of its nodes.

use whirlstand_bus::{BusConfig, Protection, Transport};

use crate::error::Failure;
use crate::file::{Plan, Security};
use crate::keys::{BenchKeys, GUEST, OBSERVER};

/// How a bench on another host is joined.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Remote {
    /// Endpoints of its nodes.
    connect: Vec<String>,
    /// Names of its nodes that publish `Health`.
    pub nodes: Vec<String>,
    /// Protection of [`OBSERVER`] and of [`GUEST`], or the reason why it is missing.
    members: [(&'static str, Result<Option<Protection>, String>); 2],
}

impl Remote {
    /// How to join the bench of a plan from another host; `connect` are endpoints of nodes that are not in the
    /// plan.
    ///
    /// # Errors
    /// For a bench that cannot be reached from another host, and when the observer's key is not on this host.
    pub fn new(plan: &Plan, connect: &[String]) -> Result<Self, Failure> {
        if plan.config.transport != Transport::Zenoh {
            return Err(Failure::Mend(format!(
                "a bench over {} cannot be reached from another host: it needs transport = \"zenoh\"",
                plan.config.transport
            )));
        }
        if plan.security == Security::Secret {
            return Err(Failure::Mend(
                "a bench protected by its host's secret cannot be reached from another host: set [security] mode = \
                 \"tls\" with keys from `whirlstand keys new`, or mode = \"open\""
                    .into(),
            ));
        }
        let listening = plan.nodes.iter().flat_map(|node| &node.section.listen);
        let connect: Vec<_> = listening.chain(connect).cloned().collect();
        if connect.is_empty() {
            return Err(Failure::Mend(
                "the address of the bench is unknown: set `listen` for the nodes in the launch file ([nodes.plant] \
                 listen = [\"tls/192.0.2.1:7447\"] and so on), or --connect ENDPOINT for each of them"
                    .into(),
            ));
        }
        let keys = BenchKeys::new(plan)?;
        let of = |name| (name, keys.protection(name).map_err(|e| e.to_string()));
        // A viewer needs the observer's key in any case.
        keys.protection(OBSERVER)?;
        let nodes = plan.nodes.iter().filter(|n| n.role.is_some()).map(|n| n.name.clone()).collect();
        Ok(Self { connect, nodes, members: [of(OBSERVER), of(GUEST)] })
    }

    /// Adds endpoints and protection of `member` to its bus configuration.
    ///
    /// # Errors
    /// When its key is not on this host.
    pub fn fill(&self, member: &str, config: &mut BusConfig) -> Result<(), Failure> {
        config.zenoh.connect.clone_from(&self.connect);
        let known = self.members.iter().find(|(name, _)| *name == member);
        let protection = known.map_or(Ok(None), |(_, protection)| protection.clone());
        config.zenoh.protection = protection.map_err(Failure::Mend)?;
        Ok(())
    }
}
