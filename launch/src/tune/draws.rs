//! Draws of the vehicle from the uncertainty of the diagnosis, each as the bench that flies it.

use whirlstand_nodes::config::{NodeConfig, VehicleSource};
use whirlstand_vehicle::{Effect, Kind, Vehicle};

use super::joint::Joint;
use super::pilot::Pilot;

/// Whether a launch file's effect is an external disturbance, which belongs to every flight, whatever the vehicle
/// is.
pub(super) fn is_disturbance(effect: &Effect) -> bool {
    matches!(
        effect.kind(),
        Kind::StepDisturbance | Kind::PulseDisturbance | Kind::PeriodicDisturbance | Kind::Turbulence
    )
}

/// The draws, by number.
pub(super) struct Draws<'a> {
    /// The bench of the launch file.
    config: NodeConfig,
    /// Path from which the vehicle file was read, to which the paths in it are relative.
    origin: &'a str,
    extended: &'a Vehicle,
    joint: Joint<'a>,
}

impl<'a> Draws<'a> {
    /// Draws of `extended` within the intervals of the causes, with the correlations of their errors. They are
    /// flown with the start, setpoints, stick and disturbances of `config`. Other effects of the launch file are
    /// left out, because the record shows them and the diagnosis finds them.
    pub fn new(config: &NodeConfig, origin: &'a str, extended: &'a Vehicle, joint: Joint<'a>) -> Self {
        let mut config = config.clone();
        config.effects.retain(is_disturbance);
        Self { config, origin, extended, joint }
    }

    /// The vehicle of a draw, without disturbances; the first is what was found itself.
    pub fn vehicle(&self, number: u64) -> Vehicle {
        match number {
            0 => self.extended.clone(),
            _ => drawn(self.extended, &self.joint, self.seed(number)),
        }
    }

    /// Seed of the noise of a draw, and of what it draws.
    pub fn seed(&self, number: u64) -> u64 {
        self.config.seed.wrapping_add(number)
    }

    /// Number of steps of a flight that comes to its end.
    pub fn steps(&self) -> usize {
        usize::try_from(self.config.steps).unwrap_or(usize::MAX)
    }

    /// The bench of a draw under a law.
    pub fn bench(&self, number: u64, pilot: &Pilot) -> NodeConfig {
        let text = self.vehicle(number).to_toml();
        NodeConfig {
            vehicle: VehicleSource { origin: self.origin.into(), text },
            model: Some(pilot.model.clone()),
            controller: pilot.controller.clone(),
            seed: self.seed(number),
            ..self.config.clone()
        }
    }
}

/// The vehicle with the parameters of a draw.
fn drawn(extended: &Vehicle, joint: &Joint<'_>, seed: u64) -> Vehicle {
    let mut vehicle = extended.clone();
    for (cause, parameter, value) in joint.draw(seed) {
        let found = vehicle
            .effects
            .iter_mut()
            .rev()
            .find(|e| e.kind().name() == cause.effect && e.place() == cause.place);
        if let Some(effect) = found {
            // Out of the range of the parameter, as a negative delay: the value that was found.
            drop(effect.set_parameter(parameter, value));
        }
    }
    vehicle
}
