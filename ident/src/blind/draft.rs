//! An effect of the table at a drawn place, with a range of sizes that a user would meet.

use std::f64::consts::{PI, TAU};

use whirlstand_vehicle::{Effect, EffectError, Kind, Vehicle};

use super::facts::{Facts, Range};
use super::random::Dice;
use super::sense::Noise;
use super::vehicles::HELICOPTERS;

/// An effect whose size is still open.
pub(crate) struct Draft {
    /// Least and greatest size; what a size is depends on the effect.
    pub sizes: (f64, f64),
    /// The size is drawn from the range, not chosen for a detectability.
    pub fixed: bool,
    build: Box<dyn Fn(f64) -> Result<Effect, EffectError>>,
}

impl Draft {
    /// The effect at a size.
    pub fn at(&self, size: f64) -> Result<Effect, EffectError> {
        (self.build)(size)
    }
}

type Parameters = Vec<(&'static str, f64)>;

/// Draws place and all but the size; `None` where the vehicle has no place for such an effect.
pub(crate) fn draft(
    kind: Kind,
    vehicle: &Vehicle,
    facts: &Facts,
    noise: &Noise,
    dice: &mut Dice,
) -> Option<Draft> {
    use Kind as K;
    let draft = match kind {
        K::InputDelay
        | K::ActuatorLag
        | K::InputGain
        | K::GainDrift
        | K::InputBias
        | K::DeadZone
        | K::InputSaturation
        | K::RateLimit
        | K::Backlash
        | K::InputCoupling
        | K::UnmodelledMode => input(kind, vehicle, facts, dice)?,
        K::ParameterChange => entry(vehicle, dice)?,
        K::QuadraticDrag
        | K::CoulombFriction
        | K::CubicStiffness
        | K::StepDisturbance
        | K::PulseDisturbance
        | K::PeriodicDisturbance
        | K::Turbulence => motion(kind, vehicle, facts, dice)?,
        K::ModeTransition => transition(vehicle, facts, dice)?,
        K::SensorBias
        | K::SensorDrift
        | K::SensorScale
        | K::SensorDelay
        | K::SensorLag
        | K::Misalignment
        | K::Vibration
        | K::Noise
        | K::Quantization
        | K::OutputSaturation
        | K::Dropouts
        | K::Outliers => sensor(kind, vehicle, facts, noise, dice)?,
    };
    Some(draft)
}

fn sized(
    kind: Kind,
    place: &str,
    sizes: (f64, f64),
    parameters: impl Fn(f64) -> Parameters + 'static,
) -> Draft {
    let place = place.to_string();
    Draft { sizes, fixed: false, build: Box::new(move |size| Effect::new(kind, &place, &parameters(size))) }
}

fn fixed(draft: Draft) -> Draft {
    Draft { fixed: true, ..draft }
}

fn input(kind: Kind, vehicle: &Vehicle, facts: &Facts, dice: &mut Dice) -> Option<Draft> {
    let moving: Vec<usize> = (0..facts.u.len()).filter(|i| facts.u[*i].peak() > 0.0).collect();
    let i = *dice.one_of(&moving)?;
    let Range { low, high, .. } = facts.u[i];
    let peak = facts.u[i].peak();
    let place = vehicle.inputs[i].name.as_str();
    let (side, length_s) = (dice.sign(), facts.length_s);
    Some(match kind {
        Kind::InputDelay => sized(kind, place, (0.005, 0.3), |s| vec![("delay_s", s)]),
        Kind::ActuatorLag => sized(kind, place, (0.02, 0.5), |s| vec![("time_constant_s", s)]),
        Kind::InputGain => sized(kind, place, (0.05, 0.5), move |s| vec![("factor", 1.0 + side * s)]),
        Kind::GainDrift => {
            sized(kind, place, (0.05, 0.5), move |s| vec![("rate_per_s", side * s / length_s)])
        }
        Kind::InputBias => sized(kind, place, (0.002, 0.5), move |s| vec![("offset", side * s * peak)]),
        Kind::DeadZone => sized(kind, place, (0.03, 0.6), move |s| vec![("width", s * peak)]),
        Kind::InputSaturation => {
            if !facts.u[i].two_sided() {
                return None;
            }
            let lean = dice.between(0.85, 1.15);
            sized(kind, place, (0.05, 0.7), move |s| {
                vec![("lower", low * (1.0 - (s * lean).min(0.9))), ("upper", high * (1.0 - s))]
            })
        }
        // The size is the time from stop to stop.
        Kind::RateLimit => sized(kind, place, (0.05, 2.0), move |s| vec![("limit_per_s", (high - low) / s)]),
        Kind::Backlash => sized(kind, place, (0.03, 0.5), move |s| vec![("width", s * (high - low))]),
        Kind::InputCoupling => {
            let others: Vec<usize> = (0..facts.u.len()).filter(|j| *j != i).collect();
            let onto = &vehicle.inputs[*dice.one_of(&others)?].name;
            let pair = format!("{place}->{onto}");
            sized(kind, &pair, (0.03, 0.6), move |s| vec![("coefficient", side * s)])
        }
        // The size is the period.
        _ => {
            let damping = dice.scaled(0.05, 0.8);
            let gain = if dice.chance(0.7) { 1.0 } else { dice.between(0.8, 1.2) };
            sized(kind, place, (0.08, 1.2), move |s| {
                vec![("frequency_hz", 1.0 / s), ("damping_ratio", damping), ("gain", gain)]
            })
        }
    })
}

fn entry(vehicle: &Vehicle, dice: &mut Dice) -> Option<Draft> {
    let rows = super::facts::dynamic(vehicle);
    let mut entries = Vec::new();
    for &i in &rows {
        let named = |matrix: &str, j: usize| format!("{matrix}[{},{}]", i + 1, j + 1);
        let a = vehicle.a.row(i);
        entries.extend((0..a.len()).filter(|j| a[*j] != 0.0).map(|j| named("A", j)));
        let b = vehicle.b.row(i);
        entries.extend((0..b.len()).filter(|j| b[*j] != 0.0).map(|j| named("B", j)));
    }
    let place = dice.one_of(&entries)?;
    let side = dice.sign();
    Some(sized(Kind::ParameterChange, place, (0.05, 0.8), move |s| vec![("factor", 1.0 + side * s)]))
}

fn motion(kind: Kind, vehicle: &Vehicle, facts: &Facts, dice: &mut Dice) -> Option<Draft> {
    let driven: Vec<usize> = facts.dynamic.iter().copied().filter(|i| facts.force[*i] > 0.0).collect();
    let i = *dice.one_of(&driven)?;
    let (force, rms) = (facts.force[i], facts.x[i].rms);
    let place = vehicle.states[i].name.as_str();
    let (side, length_s) = (dice.sign(), facts.length_s);
    Some(match kind {
        Kind::QuadraticDrag => {
            sized(kind, place, (0.03, 1.0), move |s| vec![("coefficient", s * force / (rms * rms))])
        }
        Kind::CoulombFriction => {
            let lean = if dice.chance(0.3) { dice.between(-0.5, 0.5) } else { 0.0 };
            sized(kind, place, (0.01, 0.5), move |s| {
                vec![("level", s * force), ("asymmetry", lean * s * force)]
            })
        }
        Kind::CubicStiffness => {
            // A spring acts from a position onto its own rate where there is such a pair.
            let positions: Vec<usize> =
                (0..facts.x.len()).filter(|j| *j != i && vehicle.a[(*j, i)] == 1.0).collect();
            let from = dice.one_of(&positions).copied().unwrap_or(i);
            let rms = facts.x[from].rms;
            let pair = format!("{}->{place}", vehicle.states[from].name);
            let hard = if dice.chance(0.75) { 1.0 } else { -0.2 };
            sized(kind, &pair, (0.02, 1.0), move |s| vec![("coefficient", hard * s * force / rms.powi(3))])
        }
        Kind::StepDisturbance => {
            let at_s = length_s * dice.between(0.15, 0.7);
            sized(kind, place, (1e-4, 2.0), move |s| vec![("at_s", at_s), ("magnitude", side * s * force)])
        }
        Kind::PulseDisturbance => {
            let (at_s, duration_s) = (length_s * dice.between(0.1, 0.8), dice.scaled(0.1, 3.0));
            sized(kind, place, (1e-3, 10.0), move |s| {
                vec![("at_s", at_s), ("duration_s", duration_s), ("magnitude", side * s * force)]
            })
        }
        Kind::PeriodicDisturbance => {
            let (hz, phase) = (dice.scaled(0.1, 3.0), dice.between(-PI, PI));
            sized(kind, place, (1e-4, 2.0), move |s| {
                vec![("frequency_hz", hz), ("amplitude", s * force), ("phase_rad", phase)]
            })
        }
        _ => {
            let bandwidth = dice.scaled(0.1, 2.0);
            sized(kind, place, (3e-3, 1.0), move |s| vec![("std", s * force), ("bandwidth_hz", bandwidth)])
        }
    })
}

fn transition(vehicle: &Vehicle, facts: &Facts, dice: &mut Dice) -> Option<Draft> {
    if !HELICOPTERS.contains(&vehicle.name.as_str()) {
        return None;
    }
    let others: Vec<&str> = HELICOPTERS.into_iter().filter(|h| *h != vehicle.name).collect();
    let to = (*dice.one_of(&others)?).to_string();
    let length_s = facts.length_s;
    // The size is the share of the record that it leaves for the other mode.
    let build = move |s: f64| Effect::mode_transition(length_s * (1.0 - s), &to);
    Some(Draft { sizes: (0.15, 0.7), fixed: false, build: Box::new(build) })
}

fn sensor(kind: Kind, vehicle: &Vehicle, facts: &Facts, noise: &Noise, dice: &mut Dice) -> Option<Draft> {
    let i = dice.below(vehicle.outputs.len());
    let place = vehicle.outputs[i].name.as_str();
    let (declared, own) = (vehicle.outputs[i].noise, noise.std[i]);
    let (side, length_s, rate_hz) = (dice.sign(), facts.length_s, 1.0 / facts.period_s);
    Some(match kind {
        Kind::SensorBias => sized(kind, place, (0.01, 30.0), move |s| vec![("offset", side * s * own)]),
        Kind::SensorDrift => {
            sized(kind, place, (0.02, 60.0), move |s| vec![("rate_per_s", side * s * own / length_s)])
        }
        Kind::SensorScale => sized(kind, place, (0.02, 0.5), move |s| vec![("factor", 1.0 + side * s)]),
        Kind::SensorDelay => sized(kind, place, (0.005, 0.3), |s| vec![("delay_s", s)]),
        Kind::SensorLag => sized(kind, place, (0.02, 0.5), |s| vec![("time_constant_s", s)]),
        Kind::Misalignment => {
            let pair = turnable(vehicle, dice)?;
            sized(kind, &pair, (0.02, 0.35), move |s| vec![("angle_rad", side * s)])
        }
        Kind::Vibration => {
            let hz = tone(rate_hz, dice);
            let phase = dice.between(-PI, PI);
            sized(kind, place, (0.03, 5.0), move |s| {
                vec![("frequency_hz", hz), ("amplitude", s * own), ("phase_rad", phase)]
            })
        }
        // As a cause it is more than twice what is declared. The size is the whole, in declared ones.
        Kind::Noise => fixed(sized(kind, place, (2.3, 8.0), move |s| {
            vec![("std", (s * s * declared * declared - own * own).sqrt())]
        })),
        Kind::Quantization => fixed(sized(kind, place, (3.0, 25.0), move |s| vec![("step", s * own)])),
        Kind::OutputSaturation => {
            let Range { low, high, .. } = facts.y[i];
            if !facts.y[i].two_sided() {
                return None;
            }
            let lean = dice.between(0.85, 1.15);
            sized(kind, place, (0.05, 0.6), move |s| {
                vec![("lower", low * (1.0 - (s * lean).min(0.9))), ("upper", high * (1.0 - s))]
            })
        }
        Kind::Dropouts => fixed(sized(kind, place, (0.02, 0.3), |s| vec![("fraction", s)])),
        _ => {
            let magnitude = dice.scaled(6.0, 40.0) * own;
            fixed(sized(kind, place, (0.002, 0.03), move |s| vec![("fraction", s), ("magnitude", magnitude)]))
        }
    })
}

/// A tone mostly below half the sampling rate, sometimes beyond it, where it is seen under another frequency.
fn tone(rate_hz: f64, dice: &mut Dice) -> f64 {
    loop {
        let share = if dice.chance(0.85) { dice.between(0.05, 0.46) } else { dice.between(0.54, 1.6) };
        let folded = (share - share.round()).abs();
        // Nothing can be told of a tone that stands still in the samples.
        if (0.04..0.46).contains(&folded) {
            return share * rate_hz;
        }
    }
}

/// Two angles measured by one instrument, or else any two outputs of one unit.
fn turnable(vehicle: &Vehicle, dice: &mut Dice) -> Option<String> {
    let name = |i: usize| vehicle.outputs[i].name.as_str();
    let rated = |i: usize| vehicle.output_index(&format!("{}_rate", name(i))).is_some();
    let p = vehicle.outputs.len();
    let mut pairs = Vec::new();
    for i in 0..p {
        for j in i + 1..p {
            let alike = vehicle.outputs[i].unit == vehicle.outputs[j].unit;
            if alike && !name(i).ends_with("_rate") && !name(j).ends_with("_rate") && rated(i) == rated(j) {
                pairs.push((rated(i), format!("{},{}", name(i), name(j))));
            }
        }
    }
    if pairs.iter().any(|p| p.0) {
        pairs.retain(|p| p.0);
    }
    dice.one_of(&pairs).map(|p| p.1.clone())
}

/// An angle brought to (-pi, pi].
pub(crate) fn wrapped(angle: f64) -> f64 {
    angle - TAU * (angle / TAU - 0.5).ceil()
}
