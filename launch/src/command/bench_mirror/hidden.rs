//! The effect hidden in a flight: one of twelve, with uniformly drawn location, size and onset.

use whirlstand_mirror::Cause;
use whirlstand_nodes::flight::Onset;
use whirlstand_vehicle::{Effect, EffectError, Kind, Stream, Vehicle};

/// The effects of the measurement, in the order of its table.
pub(super) const EFFECTS: [&str; 12] = [
    "loss of effectiveness",
    "delay",
    "lag",
    "bias",
    "drift",
    "friction",
    "vibration",
    "noise",
    "stuck sensor",
    "mode transition",
    "limit",
    "backlash",
];

/// Least and greatest onset time of an effect, s.
const BEGINS_S: (f64, f64) = (8.0, 14.0);

/// Name of the vehicle that an effect is hidden in.
pub(super) fn vehicle_of(what: &str) -> &'static str {
    if what == "mode transition" { "helicopter-hover" } else { "quadrotor" }
}

/// Draws a hidden effect. `spans`: least and greatest value of each input in a clean flight.
///
/// # Errors
/// When the table of effects refuses the drawn values.
pub(super) fn draw(
    what: &str,
    vehicle: &Vehicle,
    stream: &mut Stream,
    spans: &[(f64, f64)],
    period_s: f64,
) -> Result<Onset, EffectError> {
    let mut between = |low: f64, high: f64| low + (high - low) * stream.uniform();
    let input = (between(0.0, 2.0) as usize).min(vehicle.inputs.len() - 1);
    let attitude = ["roll", "roll_rate", "pitch", "pitch_rate"][(between(0.0, 4.0) as usize).min(3)];
    let rate = ["roll_rate", "pitch_rate"][(between(0.0, 2.0) as usize).min(1)];
    let noise = vehicle.output_index(attitude).map_or(0.0, |i| vehicle.outputs[i].noise);
    let (name, (low, high)) = (vehicle.inputs[input].name.clone(), spans[input]);
    let (middle, play) = (0.5 * (low + high), high - low);
    let effect = match what {
        "loss of effectiveness" => Effect::new(Kind::InputGain, &name, &[("factor", between(0.4, 0.9))]),
        "delay" => Effect::new(Kind::InputDelay, &name, &[("delay_s", between(0.02, 0.12))]),
        "lag" => Effect::new(Kind::ActuatorLag, &name, &[("time_constant_s", between(0.03, 0.2))]),
        "bias" => Effect::new(Kind::SensorBias, attitude, &[("offset", noise * between(1.0, 8.0))]),
        "drift" => Effect::new(Kind::SensorDrift, attitude, &[("rate_per_s", noise * between(0.5, 5.0))]),
        "friction" => Effect::new(Kind::CoulombFriction, rate, &[("level", between(0.02, 0.2))]),
        "vibration" => {
            let frequency = ("frequency_hz", between(3.0, 80.0_f64.min(0.4 / period_s)));
            let amplitude = ("amplitude", noise * between(0.5, 3.0));
            Effect::new(Kind::Vibration, attitude, &[frequency, amplitude, ("phase_rad", between(0.0, 6.0))])
        }
        "noise" => Effect::new(Kind::Noise, attitude, &[("std", noise * between(1.75, 4.0))]),
        "stuck sensor" => Effect::new(Kind::Dropouts, attitude, &[("fraction", 1.0)]),
        "mode transition" => {
            let modes = ["helicopter-longitudinal", "helicopter-lateral"];
            Effect::mode_transition(0.0, modes[(between(0.0, 2.0) as usize).min(1)])
        }
        "limit" => {
            let share = between(0.2, 0.4);
            let limits = [("lower", middle - share * play), ("upper", middle + share * play)];
            Effect::new(Kind::InputSaturation, &name, &limits)
        }
        _ => Effect::new(Kind::Backlash, &name, &[("width", play * between(0.1, 0.5))]),
    }?;
    Ok(Onset { effect, step: (between(BEGINS_S.0, BEGINS_S.1) / period_s) as u64 })
}

/// Whether a named cause is the hidden effect: named itself, or listed as indistinguishable from the named
/// one.
pub(super) fn is_right(cause: &Cause, hidden: &Effect) -> bool {
    let same = |kind: Kind, place: &str| kind == hidden.kind() && place == hidden.place();
    let told = same(cause.effect.kind(), cause.effect.place())
        && (hidden.kind() != Kind::ModeTransition || cause.effect.text() == hidden.text());
    told || cause.indistinguishable.iter().any(|(kind, place)| same(*kind, place))
}

/// An effect in words: its kind, its location and its values.
pub(super) fn text(effect: &Effect) -> String {
    let values = effect.parameters().map(|(name, value)| format!(" {name} {value:.4}")).collect::<String>();
    format!(
        "{} at {}{}{values}",
        effect.kind().name(),
        effect.place(),
        match effect.text() {
            Some(to) => format!(" to {to}"),
            None => String::new(),
        }
    )
}
