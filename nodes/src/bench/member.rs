//! Member processes of a measurement.

use serde::{Deserialize, Serialize};
use whirlstand_bus::ring::Ring;
use whirlstand_bus::{Bus, BusConfig};

use super::BenchError;
use super::echo::run_echo;
use crate::NodeError;
use crate::config::{NodeConfig, RealtimeOptions, Role};
use crate::os::{StopFlag, apply_realtime};
use crate::plant::Plant;
use crate::process::{run_node_until, run_plant};
use crate::ready::get_ready;
use crate::setup::Setup;

/// One process of a measurement.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Member {
    /// A node of a bench.
    Node {
        /// Role of the node.
        role: Role,
        /// Configuration of its bench.
        config: Box<NodeConfig>,
    },
    /// A position of a ring that only passes messages round.
    Ring {
        /// Position, from 0.
        position: usize,
        /// Configuration with which it joins.
        bus: Box<BusConfig>,
        /// True to use the transport alone, without the bus.
        bare: bool,
        /// Number of timed laps.
        laps: u64,
        /// CPUs that it may use; empty for all.
        cpus: Vec<usize>,
    },
    /// Returns every datagram to its sender.
    Echo {
        /// Port on the loopback.
        port: u16,
    },
}

/// Final report of a member, as JSON on standard output.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
#[serde(default)]
pub(super) struct MemberReport {
    /// Steps of a node, messages of a recorder, laps of a ring.
    pub count: u64,
    /// Wall-clock time of the count, s, where the member knows it.
    pub seconds: f64,
    pub misses: u64,
    pub lost: u64,
    pub rejected: u64,
    /// Start times of a realtime plant's periods whose command did not arrive in time, `CLOCK_MONOTONIC`, ns.
    pub missed_ns: Vec<u64>,
    /// Command latency of a realtime plant: 50 %, 99 %, 99.9 % quantile and maximum, ns.
    pub latency_ns: [u64; 4],
}

/// Runs a member and returns its report, one line of JSON for standard output.
///
/// # Errors
/// [`BenchError`] when the member fails.
pub fn run_member(member: &Member) -> Result<String, BenchError> {
    let report = match member {
        Member::Node { role, config } => node(*role, config)?,
        Member::Ring { position, bus, bare, laps, cpus } => {
            apply_realtime(&RealtimeOptions { cpus: cpus.clone(), ..RealtimeOptions::default() })
                .map_err(NodeError::from)?;
            let ring = Ring { bus: bus.as_ref().clone(), bare: *bare, laps: *laps };
            let seconds = ring.run(*position)?.map_or(0.0, |t| t.as_secs_f64());
            MemberReport { count: *laps, seconds, ..MemberReport::default() }
        }
        Member::Echo { port } => {
            run_echo(*port)?;
            MemberReport::default()
        }
    };
    serde_json::to_string(&report)
        .map_err(|e| BenchError::Member { who: "a member".into(), why: e.to_string() })
}

fn node(role: Role, config: &NodeConfig) -> Result<MemberReport, NodeError> {
    let stop = StopFlag::on_signals()
        .map_err(|source| NodeError::System { action: "install signal handlers", source })?;
    if role != Role::Plant {
        let health = run_node_until(role, config, &stop)?;
        let (count, lost, rejected) = (health.steps, health.lost, health.rejected);
        return Ok(MemberReport { count, lost, rejected, ..MemberReport::default() });
    }
    let setup = Setup::new(config)?;
    let bus = Bus::open(&Setup::bus_config(config, role))?;
    let mut plant = Plant::open(&bus, config, &setup)?;
    get_ready(role, config, &bus, &[])?;
    let health = run_plant(&bus, &mut plant, &stop)?;
    let latencies = plant.latencies();
    let quantile = |q| latencies.value_at_quantile(q);
    Ok(MemberReport {
        count: health.steps,
        seconds: plant.looped_for().as_secs_f64(),
        misses: health.deadline_misses,
        lost: health.lost,
        rejected: health.rejected,
        missed_ns: plant.missed().to_vec(),
        latency_ns: [quantile(0.5), quantile(0.99), quantile(0.999), latencies.max()],
    })
}
