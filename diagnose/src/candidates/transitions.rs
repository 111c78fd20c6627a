//! Transitions to the flight modes of other vehicles.

use whirlstand_vehicle::{Effect, Vehicle};

use super::candidate::{Candidate, Sizes};
use super::library::transition;
use crate::thresholds::TRANSITION_TIMES;

/// Transitions to every built-in vehicle and to `modes` that has the same states, inputs and outputs.
pub fn transitions(vehicle: &Vehicle, sizes: &Sizes, modes: &[String]) -> Vec<Candidate> {
    let count = TRANSITION_TIMES as f64;
    let (from_s, until_s) = sizes.times_s;
    let times = (0..TRANSITION_TIMES).map(|i| from_s + i as f64 / count * (until_s - from_s));
    let times: Vec<f64> = times.collect();
    self::modes(vehicle, modes).map(|to| transition(&to, times.clone(), sizes, count)).collect()
}

/// Names of the built-in vehicles and of those of `modes` that a vehicle can change to.
pub fn modes(vehicle: &Vehicle, modes: &[String]) -> impl Iterator<Item = String> {
    let builtin = whirlstand_vehicle::builtin_names().map(String::from);
    let others = builtin.chain(modes.iter().cloned()).filter(|name| *name != vehicle.name);
    others.filter(|to| {
        let effect = Effect::mode_transition(0.0, to);
        effect.is_ok_and(|e| vehicle.clone().add_effect(e).is_ok())
    })
}
