//! Compensation of nonlinear effects by a law, and the decision where that would be unsafe.
//!
//! Sources: inverses of dead zone and backlash, Tao and Kokotovic, "Adaptive Control of Systems with Actuator and Sensor
//! Nonlinearities", 1996; friction, Armstrong-Helouvry, Dupont and Canudas de Wit, Automatica 30, 1994; limits within the
//! anti-windup, Astrom and Wittenmark, "Computer-Controlled Systems", 3rd edition, section 3.5; gains by schedule, Rugh and
//! Shamma, Automatica 36, 2000.

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use whirlstand_linalg::{eigenvalues, pseudo_inverse};
use whirlstand_vehicle::LinearModel;

use crate::actuation::{FrictionForward, Inverse};
use crate::design::Design;

/// A nonlinear effect that a law can compensate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Compensation {
    /// The command jumps over the dead zone.
    DeadZone,
    /// The command traverses the backlash whenever it reverses.
    Backlash,
    /// The inputs counteract the friction of the estimated motion.
    CoulombFriction,
    /// The law and its integrators respect the limits.
    InputSaturation,
    /// The law and its integrators respect the rate limit.
    RateLimit,
    /// The command is divided by the drifted gain.
    GainDrift,
}

impl Compensation {
    /// The name of the effect.
    pub fn name(self) -> &'static str {
        match self {
            Self::DeadZone => "dead_zone",
            Self::Backlash => "backlash",
            Self::CoulombFriction => "coulomb_friction",
            Self::InputSaturation => "input_saturation",
            Self::RateLimit => "rate_limit",
            Self::GainDrift => "gain_drift",
        }
    }
}

/// An effect whose compensation was requested and declined, because it would be unsafe.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Declined {
    /// The effect.
    pub effect: Compensation,
    /// The input or state of the effect.
    pub place: String,
    /// Reason, as a sentence.
    pub why: String,
}

/// Largest slope of an inverse of dead zone or backlash, and the share of the gain margin that it may use up.
const STEEPEST: f64 = 5.0;
const OF_MARGIN: f64 = 0.7;
/// Smallest useful slope of an inverse: a flatter one compensates too little to be worth its noise.
const FLATTEST: f64 = 2.0;
/// Longest time in which a limited rate may complete the jump of an inverse, s.
const LONGEST_JUMP_S: f64 = 0.1;
/// Smallest width of the smooth sign relative to its state's size, and how often it may be doubled.
const NARROWEST: f64 = 0.02;
const DOUBLINGS: i32 = 6;
/// Share of an input's range that friction may take.
const OF_ROOM: f64 = 0.5;

/// Compensation that is safe, and effects whose compensation is declined.
#[derive(Debug, Default)]
pub struct Judged {
    /// One inverse per input; empty for none.
    pub inverses: Vec<Inverse>,
    /// Feedforward against friction.
    pub friction: FrictionForward,
    /// Effects that are not compensated.
    pub declined: Vec<Declined>,
}

/// Judges the requested compensations. Requested effects that the vehicle does not have are ignored.
pub fn judge(design: &Design, linear: &LinearModel, asked: &[Compensation]) -> Judged {
    let mut judged = Judged::default();
    if asked.is_empty() {
        return judged;
    }
    for i in 0..design.plant.input_count() {
        let mut inverse = Inverse::NONE;
        // Limits first: jumps have to fit within them.
        for effect in [
            Compensation::InputSaturation,
            Compensation::RateLimit,
            Compensation::GainDrift,
            Compensation::DeadZone,
            Compensation::Backlash,
        ] {
            if !asked.contains(&effect) {
                continue;
            }
            match with(design, linear, i, inverse, effect) {
                Ok(more) => inverse = more,
                Err(why) => {
                    let place = design.plant.input_names()[i].clone();
                    judged.declined.push(Declined { effect, place, why });
                }
            }
        }
        judged.inverses.push(inverse);
    }
    if asked.contains(&Compensation::CoulombFriction) && !linear.friction.is_empty() {
        match friction(design, linear, &judged.inverses) {
            Ok(forward) => judged.friction = forward,
            Err((state, why)) => judged.declined.push(Declined {
                effect: Compensation::CoulombFriction,
                place: design.plant.own_names()[state].clone(),
                why,
            }),
        }
    }
    judged
}

/// Adds the inverse of one more effect to that of an input.
fn with(
    design: &Design,
    linear: &LinearModel,
    i: usize,
    before: Inverse,
    effect: Compensation,
) -> Result<Inverse, String> {
    let (plant, has) = (&design.plant, &linear.on_inputs[i]);
    let mut inverse = before;
    match effect {
        Compensation::InputSaturation => (inverse.lower, inverse.upper) = (has.lower, has.upper),
        Compensation::RateLimit => inverse.step = has.rate_per_s * plant.period_s(),
        Compensation::GainDrift => inverse.drift = has.drift_per_s * plant.period_s(),
        Compensation::DeadZone => inverse.dead_zone = has.dead_zone,
        Compensation::Backlash => inverse.half_play = 0.5 * has.backlash,
        Compensation::CoulombFriction => {}
    }
    if inverse == before {
        return Ok(before);
    }
    let limits = &plant.inputs()[i];
    let (lower, upper) = inverse.room((limits.lower, limits.upper), plant.trim()[i], 1.0);
    if !(lower < 0.0 && upper > 0.0 && inverse.step > 0.0) {
        return Err("it leaves the input no room about rest within its limits".into());
    }
    let jump = match effect {
        Compensation::DeadZone => 2.0 * inverse.dead_zone,
        Compensation::Backlash => 2.0 * inverse.half_play,
        _ => return Ok(inverse),
    };
    let jump_s = jump / limits.rate.min(has.rate_per_s);
    if jump_s > LONGEST_JUMP_S {
        return Err(format!(
            "at its limited rate the input takes {jump_s:.2} s to jump over it, and comes late"
        ));
    }
    let margin = design.loop_margins[i].gain_increase.unwrap_or(f64::INFINITY);
    let steepest = (OF_MARGIN * margin).min(STEEPEST);
    if steepest < FLATTEST {
        return Err(format!(
            "its inverse makes small commands up to {STEEPEST:.0} times as large, and the loop tolerates {margin:.2} times its gain"
        ));
    }
    inverse.ramp = 1.0 / (steepest - 1.0);
    Ok(inverse)
}

/// Feedforward against all friction; otherwise a state that prevents it, with the reason.
fn friction(
    design: &Design,
    linear: &LinearModel,
    inverses: &[Inverse],
) -> Result<FrictionForward, (usize, String)> {
    let (plant, states) = (&design.plant, &linear.friction);
    let first = states[0].state;
    let b = linear.b.rows(0, linear.own).into_owned();
    let wanted = DMatrix::from_fn(linear.own, states.len(), |r, k| f64::from(u8::from(r == states[k].state)));
    let push = pseudo_inverse(&b, 1e-12).map_err(|e| (first, e.to_string()))? * &wanted;
    let missed = &b * &push - &wanted;
    let sizes = plant.scales();
    for (k, f) in states.iter().enumerate() {
        let off = (0..linear.own).map(|r| (missed[(r, k)] * sizes[f.state] / sizes[r]).abs());
        if off.fold(0.0, f64::max) > 1e-9 {
            return Err((
                f.state,
                "the inputs cannot push against it at once and against nothing else: none acts on this state alone, or a lag \
                 or mode lies before it"
                    .into(),
            ));
        }
    }
    for (i, inverse) in inverses.iter().enumerate() {
        let needed: f64 =
            states.iter().enumerate().map(|(k, f)| push[(i, k)].abs() * (f.level + f.asymmetry.abs())).sum();
        let limits = &plant.inputs()[i];
        let (lower, upper) = inverse.room((limits.lower, limits.upper), plant.trim()[i], 1.0);
        if needed > OF_ROOM * upper.min(-lower) {
            return Err((
                first,
                format!("it would take more than half of what {} can do", plant.input_names()[i]),
            ));
        }
    }
    let held = |factor: f64| {
        let mut law = design.linear.clone();
        for (k, f) in states.iter().enumerate() {
            let slope = f.level / (factor * sizes[f.state]);
            let mut column = law.gain.column_mut(f.state);
            column -= push.column(k) * slope;
        }
        eigenvalues(&law.closed_loop(plant)).is_ok_and(|poles| poles.iter().all(|p| p.norm() < 1.0))
    };
    let widths = (0..=DOUBLINGS).map(|k| NARROWEST * 2f64.powi(k));
    let Some(factor) = widths.into_iter().find(|factor| held(*factor)) else {
        return Err((
            first,
            "were there none, pushing against it would make the loop unstable about rest".into(),
        ));
    };
    Ok(FrictionForward {
        states: states.iter().map(|f| (f.state, f.level, f.asymmetry, factor * sizes[f.state])).collect(),
        push: push.transpose().as_slice().to_vec(),
    })
}
