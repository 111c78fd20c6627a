//! Draws of the vehicle: what the diagnosis found, within what it is sure of; each as the bench that flies it.

use whirlstand_diagnose::answer::Cause;
use whirlstand_nodes::config::{NodeConfig, VehicleSource};
use whirlstand_vehicle::{Effect, Kind, Stream, Vehicle};

use super::pilot::Pilot;

/// Standard deviations from the middle to either end of an interval that holds 95 %.
const NINETY_FIVE: f64 = 1.96;

/// Whether a launch file's effect belongs to every flight of a vehicle, whatever the vehicle is: it comes from outside.
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
    /// Where the vehicle's file was read, for what it names beside itself.
    origin: &'a str,
    extended: &'a Vehicle,
    causes: &'a [Cause],
}

impl<'a> Draws<'a> {
    /// Of `extended`, within the intervals of `causes`, flown as `config` says: its start, setpoints, stick and disturbances.
    /// Other effects of the launch file are what the record shows and the diagnosis finds.
    pub fn new(config: &NodeConfig, origin: &'a str, extended: &'a Vehicle, causes: &'a [Cause]) -> Self {
        let mut config = config.clone();
        config.effects.retain(is_disturbance);
        Self { config, origin, extended, causes }
    }

    /// The vehicle of a draw, without disturbances; the first is what was found itself.
    pub fn vehicle(&self, number: u64) -> Vehicle {
        match number {
            0 => self.extended.clone(),
            _ => drawn(self.extended, self.causes, self.seed(number)),
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

/// Draws the parameters of the causes anew, each from a normal distribution over its interval. The causes' joint
/// distribution is not part of a diagnosis, so they are drawn one by one, which spreads them further than they are.
fn drawn(extended: &Vehicle, causes: &[Cause], seed: u64) -> Vehicle {
    let mut vehicle = extended.clone();
    for cause in causes {
        let mut stream = Stream::new(seed, &format!("tune/{}/{}", cause.effect, cause.place));
        let found = vehicle
            .effects
            .iter_mut()
            .rev()
            .find(|e| e.kind().name() == cause.effect && e.place() == cause.place);
        let Some(effect) = found else { continue };
        for (name, estimate) in &cause.parameters {
            let deviation = (estimate.high - estimate.low) / (2.0 * NINETY_FIVE);
            let drawn = estimate.value + deviation * stream.normal();
            // Out of the range of the parameter, as a negative delay: the value that was found.
            if deviation.is_finite() {
                drop(effect.set_parameter(name, drawn));
            }
        }
    }
    vehicle
}
