//! Draws an effect of the table at a random place, with a realistic range of sizes.

use std::f64::consts::{PI, TAU};

use whirlstand_vehicle::{Effect, EffectError, Kind, Vehicle};

use super::facts::{Facts, Range};
use super::random::RandomStream;
use super::ranges::{EffectRanges, Interval};
use super::sense::Noise;
use super::vehicles::HELICOPTERS;

/// An effect whose size is not yet chosen.
pub(crate) struct Draft {
    /// Least and greatest size; the meaning of the size depends on the effect.
    pub sizes: Interval,
    /// Whether the size is drawn from the range instead of chosen for a detectability.
    pub fixed: bool,
    build: Box<dyn Fn(f64) -> Result<Effect, EffectError>>,
}

impl Draft {
    /// The effect with the size `size`.
    pub fn at(&self, size: f64) -> Result<Effect, EffectError> {
        (self.build)(size)
    }
}

type Parameters = Vec<(&'static str, f64)>;

/// Draws the place and all parameters except the size; `None` where the vehicle has no place for such an
/// effect.
pub(crate) fn draft(
    kind: Kind,
    vehicle: &Vehicle,
    facts: &Facts,
    noise: &Noise,
    ranges: &EffectRanges,
    stream: &mut RandomStream,
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
        | K::UnmodelledMode => input(kind, vehicle, facts, ranges, stream)?,
        K::ParameterChange => entry(vehicle, ranges, stream)?,
        K::QuadraticDrag
        | K::CoulombFriction
        | K::CubicStiffness
        | K::StepDisturbance
        | K::PulseDisturbance
        | K::PeriodicDisturbance
        | K::Turbulence => motion(kind, vehicle, facts, ranges, stream)?,
        K::ModeTransition => transition(vehicle, facts, ranges, stream)?,
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
        | K::Outliers => sensor(kind, vehicle, facts, noise, ranges, stream)?,
    };
    Some(draft)
}

fn sized(
    kind: Kind,
    place: &str,
    sizes: Interval,
    parameters: impl Fn(f64) -> Parameters + 'static,
) -> Draft {
    let place = place.to_string();
    Draft { sizes, fixed: false, build: Box::new(move |size| Effect::new(kind, &place, &parameters(size))) }
}

fn fixed(draft: Draft) -> Draft {
    Draft { fixed: true, ..draft }
}

fn input(
    kind: Kind,
    vehicle: &Vehicle,
    facts: &Facts,
    ranges: &EffectRanges,
    stream: &mut RandomStream,
) -> Option<Draft> {
    let moving: Vec<usize> = (0..facts.u.len()).filter(|i| facts.u[*i].peak() > 0.0).collect();
    let i = *stream.one_of(&moving)?;
    let Range { low, high, .. } = facts.u[i];
    let peak = facts.u[i].peak();
    let place = vehicle.inputs[i].name.as_str();
    let (side, length_s) = (stream.sign(), facts.length_s);
    Some(match kind {
        Kind::InputDelay => sized(kind, place, ranges.input_delay_s, |s| vec![("delay_s", s)]),
        Kind::ActuatorLag => sized(kind, place, ranges.actuator_lag_s, |s| vec![("time_constant_s", s)]),
        Kind::InputGain => sized(kind, place, ranges.input_gain, move |s| vec![("factor", 1.0 + side * s)]),
        Kind::GainDrift => {
            sized(kind, place, ranges.gain_drift, move |s| vec![("rate_per_s", side * s / length_s)])
        }
        Kind::InputBias => sized(kind, place, ranges.input_bias, move |s| vec![("offset", side * s * peak)]),
        Kind::DeadZone => sized(kind, place, ranges.dead_zone, move |s| vec![("width", s * peak)]),
        Kind::InputSaturation => {
            if !facts.u[i].two_sided() {
                return None;
            }
            let lean = stream.within(ranges.saturation_lean);
            sized(kind, place, ranges.input_saturation, move |s| {
                vec![("lower", low * (1.0 - (s * lean).min(0.9))), ("upper", high * (1.0 - s))]
            })
        }
        // The size is the time of a full-range move.
        Kind::RateLimit => {
            sized(kind, place, ranges.rate_limit_s, move |s| vec![("limit_per_s", (high - low) / s)])
        }
        Kind::Backlash => sized(kind, place, ranges.backlash, move |s| vec![("width", s * (high - low))]),
        Kind::InputCoupling => {
            let others: Vec<usize> = (0..facts.u.len()).filter(|j| *j != i).collect();
            let onto = &vehicle.inputs[*stream.one_of(&others)?].name;
            let pair = format!("{place}->{onto}");
            sized(kind, &pair, ranges.input_coupling, move |s| vec![("coefficient", side * s)])
        }
        // The size is the period of the mode.
        _ => {
            let damping = stream.scaled_within(ranges.mode_damping);
            let gain =
                if stream.chance(ranges.mode_unit_gain) { 1.0 } else { stream.within(ranges.mode_gain) };
            sized(kind, place, ranges.mode_period_s, move |s| {
                vec![("frequency_hz", 1.0 / s), ("damping_ratio", damping), ("gain", gain)]
            })
        }
    })
}

fn entry(vehicle: &Vehicle, ranges: &EffectRanges, stream: &mut RandomStream) -> Option<Draft> {
    let rows = super::facts::dynamic(vehicle);
    let mut entries = Vec::new();
    for &i in &rows {
        let named = |matrix: &str, j: usize| format!("{matrix}[{},{}]", i + 1, j + 1);
        let a = vehicle.a.row(i);
        entries.extend((0..a.len()).filter(|j| a[*j] != 0.0).map(|j| named("A", j)));
        let b = vehicle.b.row(i);
        entries.extend((0..b.len()).filter(|j| b[*j] != 0.0).map(|j| named("B", j)));
    }
    let place = stream.one_of(&entries)?;
    let side = stream.sign();
    Some(sized(Kind::ParameterChange, place, ranges.parameter_change, move |s| {
        vec![("factor", 1.0 + side * s)]
    }))
}

fn motion(
    kind: Kind,
    vehicle: &Vehicle,
    facts: &Facts,
    ranges: &EffectRanges,
    stream: &mut RandomStream,
) -> Option<Draft> {
    let driven: Vec<usize> = facts.dynamic.iter().copied().filter(|i| facts.force[*i] > 0.0).collect();
    let i = *stream.one_of(&driven)?;
    let (force, rms) = (facts.force[i], facts.x[i].rms);
    let place = vehicle.states[i].name.as_str();
    let (side, length_s) = (stream.sign(), facts.length_s);
    Some(match kind {
        Kind::QuadraticDrag => {
            sized(kind, place, ranges.quadratic_drag, move |s| vec![("coefficient", s * force / (rms * rms))])
        }
        Kind::CoulombFriction => {
            let lean = if stream.chance(ranges.lopsided_friction) {
                stream.within(ranges.friction_asymmetry)
            } else {
                0.0
            };
            sized(kind, place, ranges.coulomb_friction, move |s| {
                vec![("level", s * force), ("asymmetry", lean * s * force)]
            })
        }
        Kind::CubicStiffness => {
            // A spring acts from a position onto its rate, where the vehicle has such a pair of states.
            let positions: Vec<usize> =
                (0..facts.x.len()).filter(|j| *j != i && vehicle.a[(*j, i)] == 1.0).collect();
            let from = stream.one_of(&positions).copied().unwrap_or(i);
            let rms = facts.x[from].rms;
            let pair = format!("{}->{place}", vehicle.states[from].name);
            let hard = if stream.chance(ranges.hardening) { 1.0 } else { -ranges.softening };
            sized(kind, &pair, ranges.cubic_stiffness, move |s| {
                vec![("coefficient", hard * s * force / rms.powi(3))]
            })
        }
        Kind::StepDisturbance => {
            let at_s = length_s * stream.within(ranges.step_at);
            sized(kind, place, ranges.step, move |s| vec![("at_s", at_s), ("magnitude", side * s * force)])
        }
        Kind::PulseDisturbance => {
            let (at_s, duration_s) =
                (length_s * stream.within(ranges.pulse_at), stream.scaled_within(ranges.pulse_s));
            sized(kind, place, ranges.pulse, move |s| {
                vec![("at_s", at_s), ("duration_s", duration_s), ("magnitude", side * s * force)]
            })
        }
        Kind::PeriodicDisturbance => {
            let (hz, phase) = (stream.scaled_within(ranges.periodic_hz), stream.between(-PI, PI));
            sized(kind, place, ranges.periodic, move |s| {
                vec![("frequency_hz", hz), ("amplitude", s * force), ("phase_rad", phase)]
            })
        }
        _ => {
            let bandwidth = stream.scaled_within(ranges.turbulence_hz);
            sized(kind, place, ranges.turbulence, move |s| {
                vec![("std", s * force), ("bandwidth_hz", bandwidth)]
            })
        }
    })
}

fn transition(
    vehicle: &Vehicle,
    facts: &Facts,
    ranges: &EffectRanges,
    stream: &mut RandomStream,
) -> Option<Draft> {
    if !HELICOPTERS.contains(&vehicle.name.as_str()) {
        return None;
    }
    let others: Vec<&str> = HELICOPTERS.into_iter().filter(|h| *h != vehicle.name).collect();
    let to = (*stream.one_of(&others)?).to_string();
    let length_s = facts.length_s;
    // The size is the share of the record after the transition.
    let build = move |s: f64| Effect::mode_transition(length_s * (1.0 - s), &to);
    Some(Draft { sizes: ranges.mode_transition, fixed: false, build: Box::new(build) })
}

fn sensor(
    kind: Kind,
    vehicle: &Vehicle,
    facts: &Facts,
    noise: &Noise,
    ranges: &EffectRanges,
    stream: &mut RandomStream,
) -> Option<Draft> {
    let i = stream.below(vehicle.outputs.len());
    let place = vehicle.outputs[i].name.as_str();
    let (declared, own) = (vehicle.outputs[i].noise, noise.std[i]);
    let (side, length_s, rate_hz) = (stream.sign(), facts.length_s, 1.0 / facts.period_s);
    Some(match kind {
        Kind::SensorBias => sized(kind, place, ranges.sensor_bias, move |s| vec![("offset", side * s * own)]),
        Kind::SensorDrift => {
            sized(kind, place, ranges.sensor_drift, move |s| vec![("rate_per_s", side * s * own / length_s)])
        }
        Kind::SensorScale => {
            sized(kind, place, ranges.sensor_scale, move |s| vec![("factor", 1.0 + side * s)])
        }
        Kind::SensorDelay => sized(kind, place, ranges.sensor_delay_s, |s| vec![("delay_s", s)]),
        Kind::SensorLag => sized(kind, place, ranges.sensor_lag_s, |s| vec![("time_constant_s", s)]),
        Kind::Misalignment => {
            let pair = turnable(vehicle, stream)?;
            sized(kind, &pair, ranges.misalignment_rad, move |s| vec![("angle_rad", side * s)])
        }
        Kind::Vibration => {
            let hz = tone(rate_hz, ranges, stream);
            let phase = stream.between(-PI, PI);
            sized(kind, place, ranges.vibration, move |s| {
                vec![("frequency_hz", hz), ("amplitude", s * own), ("phase_rad", phase)]
            })
        }
        // The size is the total noise relative to the declared one; noise is a cause above twice the
        // declared.
        Kind::Noise => fixed(sized(kind, place, ranges.noise, move |s| {
            vec![("std", (s * s * declared * declared - own * own).sqrt())]
        })),
        Kind::Quantization => {
            fixed(sized(kind, place, ranges.quantization, move |s| vec![("step", s * own)]))
        }
        Kind::OutputSaturation => {
            let Range { low, high, .. } = facts.y[i];
            if !facts.y[i].two_sided() {
                return None;
            }
            let lean = stream.within(ranges.saturation_lean);
            sized(kind, place, ranges.output_saturation, move |s| {
                vec![("lower", low * (1.0 - (s * lean).min(0.9))), ("upper", high * (1.0 - s))]
            })
        }
        Kind::Dropouts => fixed(sized(kind, place, ranges.dropouts, |s| vec![("fraction", s)])),
        _ => {
            let magnitude = stream.scaled_within(ranges.outlier_magnitude) * own;
            fixed(sized(kind, place, ranges.outliers, move |s| {
                vec![("fraction", s), ("magnitude", magnitude)]
            }))
        }
    })
}

/// The frequency of a tone, mostly below half the sampling rate, sometimes above it, where it is aliased.
fn tone(rate_hz: f64, ranges: &EffectRanges, stream: &mut RandomStream) -> f64 {
    loop {
        let share = if stream.chance(ranges.vibration_below_half) {
            stream.within(ranges.vibration_low)
        } else {
            stream.within(ranges.vibration_high)
        };
        let folded = (share - share.round()).abs();
        // A tone that is aliased to nearly zero or nearly half the sampling rate cannot be identified.
        if (0.04..0.46).contains(&folded) {
            return share * rate_hz;
        }
    }
}

/// Two angles whose rates are measured too if there are such, or else any two outputs of one unit.
fn turnable(vehicle: &Vehicle, stream: &mut RandomStream) -> Option<String> {
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
    stream.one_of(&pairs).map(|p| p.1.clone())
}

/// An angle wrapped to (-pi, pi].
pub(crate) fn wrapped(angle: f64) -> f64 {
    angle - TAU * (angle / TAU - 0.5).ceil()
}
