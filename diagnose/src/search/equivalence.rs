//! Equivalent causes: decides which of two indistinguishable effects is named.

use crate::thresholds::{SAME_EFFECT_BIC, SAME_TONE_BIC, SISO_SAME_BIC, SISO_SAME_SHARE};
use whirlstand_vehicle::Kind;

use crate::data::record::Data;

/// True for a system with one input and one output.
pub fn single(data: &Data) -> bool {
    data.m == 1 && data.channels.len() == 1
}

/// The equivalent kind of effect that is preferred, and the difference in BIC up to which it is: the input's
/// before the sensor's, except that a tone is the sensor's, and an offset: a sensor's needs no motion to come about.
/// `explained` is the gain in BIC.
pub fn simpler(kind: Kind, explained: f64, data: &Data) -> Option<(Kind, f64)> {
    let same = match (single(data), data.memory_s) {
        // The two differ only in how process noise propagates, and the gain of a predictor that follows the
        // record does not depend on that.
        (true, Some(_)) => f64::INFINITY,
        (true, None) => SISO_SAME_BIC.max(SISO_SAME_SHARE * explained),
        (false, _) => SAME_EFFECT_BIC,
    };
    Some(match kind {
        Kind::SensorDelay => (Kind::InputDelay, same),
        Kind::SensorLag => (Kind::ActuatorLag, same),
        Kind::SensorScale => (Kind::InputGain, same),
        Kind::InputBias => (Kind::SensorBias, SAME_EFFECT_BIC),
        Kind::PeriodicDisturbance => (Kind::Vibration, SAME_TONE_BIC),
        _ => return None,
    })
}

/// True when a rival that is worse by `gap` in BIC is the equivalent kind that is preferred to a cause.
pub fn is_twin((own, explained): (Kind, f64), rival: Kind, gap: f64, data: &Data) -> bool {
    simpler(own, explained, data).is_some_and(|(kind, same)| kind == rival && gap < same)
}

/// True when a cause is replaced by a rival that is worse by `gap` in BIC.
pub fn yields((own, explained): (Kind, f64), rival: Kind, gap: f64, data: &Data) -> bool {
    is_twin((own, explained), rival, gap, data) || gap < -lead((own, explained), rival, data)
}

/// Difference in BIC by which a rival must be better to replace a cause.
pub fn lead((own, explained): (Kind, f64), rival: Kind, data: &Data) -> f64 {
    match simpler(rival, explained, data) {
        Some((kind, same)) if kind == own => same.max(1.0),
        _ => 1.0,
    }
}
