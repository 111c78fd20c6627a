//! Draws of the vehicle: what the diagnosis found, within what it is sure of.

use whirlstand_diagnose::Diagnosis;
use whirlstand_vehicle::{Effect, Kind, Stream, Vehicle};

/// Standard deviations from the middle to either end of an interval that holds 95 %.
const NINETY_FIVE: f64 = 1.96;

/// Whether a launch file's effect belongs to every flight of a vehicle, whatever the vehicle is: it comes from outside.
pub(super) fn is_disturbance(effect: &Effect) -> bool {
    matches!(
        effect.kind(),
        Kind::StepDisturbance | Kind::PulseDisturbance | Kind::PeriodicDisturbance | Kind::Turbulence
    )
}

/// Draws the parameters of the causes anew, each from a normal distribution over its interval. The causes' joint
/// distribution is not part of a diagnosis, so they are drawn one by one, which spreads them further than they are.
pub(super) fn draw(extended: &Vehicle, diagnosis: &Diagnosis, seed: u64) -> Vehicle {
    let mut vehicle = extended.clone();
    for cause in &diagnosis.causes {
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
