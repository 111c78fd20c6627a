//! Causes that are the same thing where nothing parts them: which of the two is named.

use whirlstand_vehicle::Kind;

use super::data::Data;

/// Difference in BIC up to which two causes are the same thing.
const SAME: f64 = 0.5;
/// The same with one input and one output, where no record tells them apart but by its first samples; and as a share of
/// what they explain.
const ALONE: f64 = 20.0;
const SHARE: f64 = 0.02;
/// The same for a tone of a force and one of a sensor.
const TONE: f64 = 3.0;

/// True with one input and one output.
pub fn single(data: &Data) -> bool {
    data.m == 1 && data.channels.len() == 1
}

/// What comes first where it does as well: the input's before the sensor's, but a tone is the sensor's; and up to which
/// difference in BIC that is so. `explained` is the gain in BIC.
pub fn simpler(kind: Kind, explained: f64, data: &Data) -> Option<(Kind, f64)> {
    let same = if single(data) { ALONE.max(SHARE * explained) } else { SAME };
    Some(match kind {
        Kind::SensorDelay => (Kind::InputDelay, same),
        Kind::SensorLag => (Kind::ActuatorLag, same),
        Kind::SensorScale => (Kind::InputGain, same),
        Kind::PeriodicDisturbance => (Kind::Vibration, TONE),
        _ => return None,
    })
}

/// Whether a cause gives its place to a rival that is worse by `gap` in BIC.
pub fn yields((own, explained): (Kind, f64), rival: Kind, gap: f64, data: &Data) -> bool {
    let simpler = simpler(own, explained, data).is_some_and(|(kind, same)| kind == rival && gap < same);
    simpler || gap < -lead((own, explained), rival, data)
}

/// By how much in BIC a rival must be better to take a cause's place.
pub fn lead((own, explained): (Kind, f64), rival: Kind, data: &Data) -> f64 {
    match simpler(rival, explained, data) {
        Some((kind, same)) if kind == own => same.max(1.0),
        _ => 1.0,
    }
}
