//! Conventions of mirror and controller for a change of the law in flight.
//!
//! At step k the mirror publishes a finding that names the cause; the controller designs the law for it by
//! itself, beside the loop, by the same rules with which the mirror has evaluated it. Only the finding is
//! transmitted, so that its log determines which law was in charge.

use whirlstand_msgs::{Finding, text_of};
use whirlstand_vehicle::{Effect, Kind, Vehicle};

use crate::config::NodeConfig;
use crate::setup::Setup;

/// Largest number of steps by which a lockstep plant may be ahead of a mirror that changes laws.
pub const WINDOW: u64 = 64;

/// Number of steps from the mirror's finding to the first at which the new law runs in parallel: in lockstep
/// the finding has reached the controller by then, whatever the machine does, so that a run is reproducible
/// bit for bit.
pub const READY: u64 = WINDOW + 32;

/// The effect of a finding; `None` for one that is no part of a linear vehicle, or whose name was truncated.
fn effect_of(finding: &Finding) -> Option<Effect> {
    let kind = Kind::from_name(text_of(&finding.effect)).ok()?;
    let (place, onto) = (text_of(&finding.place), text_of(&finding.onto));
    let place = match (kind, onto) {
        (Kind::ModeTransition | Kind::Vibration, _) => return None,
        (_, "") => place.to_string(),
        (Kind::Misalignment, other) => format!("{place},{other}"),
        (_, onto) => format!("{place}->{onto}"),
    };
    let values = finding.value.iter().take(finding.count as usize);
    let values: Vec<(&str, f64)> = text_of(&finding.names).split(',').zip(values.copied()).collect();
    Effect::new(kind, &place, &values).ok()
}

/// The vehicle with the cause of a finding.
///
/// # Errors
/// A sentence when no law can be designed for it.
pub fn extended(model: &Vehicle, finding: &Finding) -> Result<Vehicle, String> {
    let name = text_of(&finding.effect);
    let effect = effect_of(finding).ok_or_else(|| format!("no law can be designed for {name}"))?;
    let mut vehicle = model.clone();
    vehicle.add_effect(effect).map_err(|e| format!("no law can be designed for {name}: {e}"))?;
    Ok(vehicle)
}

/// Setup for the design of a law: the same bench with another model.
pub fn believing(setup: &Setup, model: Vehicle) -> Setup {
    Setup { model, ..setup.clone() }
}

/// First step at which a law announced at `step` runs in parallel.
pub fn ready_at(step: u64) -> u64 {
    step + READY
}

/// Number of steps in `seconds`.
pub fn steps(config: &NodeConfig, seconds: f64) -> u64 {
    (seconds / Setup::period_s(config)).ceil() as u64
}
