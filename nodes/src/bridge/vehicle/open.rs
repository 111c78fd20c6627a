//! Creates the state machine of a bridge to a vehicle from its options.

use std::time::{SystemTime, UNIX_EPOCH};

use whirlstand_bridge::config::BridgeConfig;
use whirlstand_bridge::mavlink::Signing;
use whirlstand_bridge::turning::{inputs_of, own_motion_of};
use whirlstand_bridge::vehicle::{Bench, FIELDS, Vehicle};

use super::requirements::read_key;
use crate::config::NodeConfig;
use crate::error::NodeError;
use crate::os::was_restarted;
use crate::setup::Setup;

/// The state machine for a bench.
///
/// # Errors
/// [`NodeError::Config`] for invalid options, and a key file that cannot be read.
pub fn open_vehicle(config: &NodeConfig, bridge: &BridgeConfig, setup: &Setup) -> Result<Vehicle, NodeError> {
    let signing = match bridge.options.mavlink.as_ref().and_then(|m| m.signing_key.as_ref()) {
        Some(path) => {
            let unix = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
            Some(Signing::new(read_key(path)?, 0, unix))
        }
        None => None,
    };
    if let Some(output) = setup.vehicle.outputs.iter().find(|o| !FIELDS.contains(&o.name.as_str())) {
        let reason = format!(
            "a bridge reads no output \"{}\" from a vehicle; it can carry {}",
            output.name,
            FIELDS.join(", ")
        );
        return Err(NodeError::NotOnBus { vehicle: setup.vehicle.name.clone(), reason });
    }
    let bench = Bench {
        inputs: inputs_of(&setup.vehicle),
        own: own_motion_of(&setup.vehicle),
        rate_hz: 1e9 / config.period_ns as f64,
        wants_odometry: setup.map.has_odometry(),
        signing,
    };
    let mut vehicle = Vehicle::new(bridge, bench).map_err(|e| NodeError::Config {
        field: format!("bridge.{}", e.path.join(".")),
        value: "the data written to the port".into(),
        reason: e.message,
    })?;
    if was_restarted() {
        vehicle.come_back();
    }
    Ok(vehicle)
}
