//! Bench for measuring throughput and latency.

use std::collections::BTreeMap;
use std::time::{SystemTime, UNIX_EPOCH};

use whirlstand_bus::Transport;
use whirlstand_vehicle::Vehicle;

use super::BenchError;
use crate::config::{
    ControllerConfig, EstimatorConfig, LawKind, Mode, NodeConfig, PlantConfig, Role, VehicleSource,
};

/// Configuration of the bench: the quadrotor with its noisy sensors, model-based estimator, LQR, no log.
pub(super) fn config(
    name: &str,
    transport: Transport,
    mode: Mode,
    steps: u64,
) -> Result<NodeConfig, BenchError> {
    let vehicle = Vehicle::builtin("quadrotor")
        .map_err(|e| BenchError::Member { who: "the built-in quadrotor".into(), why: e.to_string() })?;
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().subsec_micros();
    Ok(NodeConfig {
        bench: format!("bench-{name}-{}-{now}", std::process::id()),
        transport,
        zenoh: whirlstand_bus::ZenohConfig::default(),
        vehicle: VehicleSource { origin: "quadrotor".into(), text: vehicle.source_text },
        model: None,
        effects: Vec::new(),
        mode,
        period_ns: 1_000_000,
        steps,
        seed: 1,
        peers: vec![Role::Estimator, Role::Controller],
        start_timeout_s: 20.0,
        telemetry: false,
        plant: PlantConfig::default(),
        estimator: EstimatorConfig::default(),
        controller: ControllerConfig::new(LawKind::Lqr),
        recorder: None,
        mirror: None,
        setpoint: Vec::new(),
        stick: Vec::new(),
        realtime: BTreeMap::new(),
        bridge: None,
    })
}
