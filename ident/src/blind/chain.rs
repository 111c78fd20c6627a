//! What happens to a command on its way to the vehicle: limits, static effects, rate limit, play, delay.

use std::f64::consts::TAU;

use whirlstand_vehicle::{Effect, Kind, Vehicle};

use super::outside::{Outside, Strange};
use super::plant::{Commands, value};
use super::signal::Signal;

/// The order in which the effects on an input act.
const ORDER: [Kind; 8] = [
    Kind::InputGain,
    Kind::GainDrift,
    Kind::InputBias,
    Kind::DeadZone,
    Kind::InputSaturation,
    Kind::RateLimit,
    Kind::Backlash,
    Kind::InputDelay,
];

/// Input `index` as it reaches the vehicle; `effects` are those at this input.
pub(crate) fn input(
    vehicle: &Vehicle,
    index: usize,
    commands: &Commands,
    effects: &[&Effect],
    outside: Option<&Outside>,
) -> Signal {
    let limits = &vehicle.inputs[index];
    let rest = limits.neutral();
    let held = commands.inputs[index].iter().map(|u| u.max(limits.lower).min(limits.upper));
    let mut signal = Signal::held(held, commands.period_s, rest);
    if limits.rate_limit.is_finite() {
        signal = signal.limited(limits.rate_limit);
    }
    if let Some(outside) = outside.filter(|o| o.input == index) {
        signal = strange(signal, outside);
    }
    for kind in ORDER {
        for effect in effects.iter().filter(|e| e.kind() == kind) {
            signal = act(signal, effect);
        }
    }
    signal
}

fn act(signal: Signal, effect: &Effect) -> Signal {
    let get = |name| value(effect, name);
    match effect.kind() {
        Kind::InputGain => signal.affine(get("factor"), 0.0),
        Kind::GainDrift => signal.drifting(get("rate_per_s")),
        Kind::InputBias => signal.affine(1.0, get("offset")),
        Kind::DeadZone => {
            let width = get("width");
            signal.bent(&[-width, width], |u| {
                if u > width {
                    u - width
                } else if u < -width {
                    u + width
                } else {
                    0.0
                }
            })
        }
        Kind::InputSaturation => {
            let (lower, upper) = (get("lower"), get("upper"));
            signal.bent(&[lower, upper], |u| u.max(lower).min(upper))
        }
        Kind::RateLimit => signal.limited(get("limit_per_s")),
        Kind::Backlash => signal.played(get("width")),
        Kind::InputDelay => signal.delayed(get("delay_s")),
        _ => signal,
    }
}

fn strange(signal: Signal, outside: &Outside) -> Signal {
    let (size, scale) = (outside.size, outside.scale);
    match outside.strange {
        Strange::AsymmetricGain => signal.bent(&[0.0], |u| u + size * u.abs()),
        Strange::SquaredInput => signal.curved(|_, u| u + size * u * u / scale),
        Strange::SwingingGain => signal.curved(|t, u| u * (1.0 + size * (TAU * scale * t).sin())),
        Strange::InputRelay => signal.relayed(size, scale),
        _ => signal,
    }
}
