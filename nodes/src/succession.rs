//! What mirror and controller agree on when a law changes in flight.
//!
//! A mirror that says so at step k names the cause; the controller designs the law for it by itself, beside the loop, and by the same
//! rules that the mirror has checked it with. Nothing but a finding travels, so that its log says which law flew.

use whirlstand_msgs::{Finding, text_of};
use whirlstand_vehicle::{Effect, Kind, Vehicle};

use crate::config::NodeConfig;
use crate::setup::Setup;

/// Steps that a lockstep plant may be ahead of a mirror that changes laws.
pub const WINDOW: u64 = 64;

/// Steps from the word of the mirror to the first at which the new law flies along: in lockstep the word has reached the controller
/// by then, whatever the machine does, so that a run repeats itself bit for bit.
pub const READY: u64 = WINDOW + 32;

/// The effect that a finding names; `None` for one that is no part of a linear vehicle, or whose name did not fit.
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

/// The vehicle with the cause that a finding names.
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

/// What a law is designed from: the bench as it is, with another belief.
pub fn believing(setup: &Setup, model: Vehicle) -> Setup {
    Setup { model, ..setup.clone() }
}

/// The first step at which a law flies along that the mirror told of at `step`.
pub fn ready_at(step: u64) -> u64 {
    step + READY
}

/// Steps in `seconds`.
pub fn steps(config: &NodeConfig, seconds: f64) -> u64 {
    (seconds / Setup::period_s(config)).ceil() as u64
}
