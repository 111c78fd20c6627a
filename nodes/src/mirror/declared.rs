//! Effects of the flight that the mirror knows in advance.

use whirlstand_vehicle::{Effect, Kind, Vehicle};

use crate::config::NodeConfig;
use crate::error::NodeError;
use crate::setup::Setup;

/// Declared effects of the flight: disturbances of the launch file, but not its other effects.
pub(super) fn declared_effects(config: &NodeConfig) -> impl Iterator<Item = &Effect> {
    let disturbs = |kind: Kind| {
        matches!(
            kind,
            Kind::StepDisturbance | Kind::PulseDisturbance | Kind::PeriodicDisturbance | Kind::Turbulence
        )
    };
    config.effects.iter().filter(move |e| disturbs(e.kind()))
}

/// The vehicle with all declared effects.
pub(super) fn declared(setup: &Setup, config: &NodeConfig) -> Result<Vehicle, NodeError> {
    let mut vehicle = setup.model.clone();
    for effect in declared_effects(config) {
        let reason = |e: whirlstand_vehicle::EffectError| e.to_string();
        let origin = config.vehicle.origin.clone();
        vehicle.add_effect(effect.clone()).map_err(|e| NodeError::Vehicle { origin, reason: reason(e) })?;
    }
    Ok(vehicle)
}
