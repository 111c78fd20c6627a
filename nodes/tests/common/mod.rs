//! A small bench for tests.
#![allow(dead_code)] // every test file takes what it needs

use std::time::{SystemTime, UNIX_EPOCH};

use whirlstand_bus::Transport;
use whirlstand_nodes::config::{
    ControllerConfig, EstimatorConfig, LawKind, Mode, NodeConfig, PlantConfig, Role, VehicleSource,
};
use whirlstand_vehicle::Vehicle;

/// A bench name that no other test has.
pub fn unique(name: &str) -> String {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().subsec_nanos();
    format!("{name}-{}-{now}", std::process::id())
}

/// A quadrotor under LQR at 200 Hz, in lockstep, in-process, without a log.
pub fn config(name: &str, steps: u64) -> NodeConfig {
    let vehicle = Vehicle::builtin("quadrotor").unwrap();
    NodeConfig {
        bench: unique(name),
        transport: Transport::Inproc,
        zenoh: Default::default(),
        vehicle: VehicleSource { origin: "quadrotor".into(), text: vehicle.source_text },
        model: None,
        effects: Vec::new(),
        mode: Mode::Lockstep,
        period_ns: 5_000_000,
        steps,
        seed: 1,
        peers: vec![Role::Estimator, Role::Controller],
        start_timeout_s: 5.0,
        telemetry: true,
        plant: PlantConfig { initial: [("roll".to_string(), 0.05)].into(), ..Default::default() },
        estimator: EstimatorConfig::default(),
        controller: ControllerConfig::new(LawKind::Lqr),
        recorder: None,
        mirror: None,
        setpoint: Vec::new(),
        stick: Vec::new(),
        bridge: None,
        realtime: Default::default(),
    }
}
