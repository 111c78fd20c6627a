//! Commands beyond the limits that the vehicle file states: decides whether the file's limit or the record is
//! wrong.

use whirlstand_logs::Record;
use whirlstand_vehicle::Vehicle;

use super::record::{Data, coarser_period};
use crate::Options;
use crate::answer::DataFinding;
use crate::model::predictor::memories;
use crate::thresholds::{MIN_BIC_GAIN, MIN_HELD_SAMPLES};

/// Result of comparing a record's commands with the limits.
#[derive(Debug, Clone, PartialEq)]
pub struct Limits {
    /// The vehicle with limits as wide as the commands, where the outputs answered to them.
    pub wider: Option<Vehicle>,
    /// Findings as sentences; empty where all commands are within the limits.
    pub found: Vec<DataFinding>,
}

/// Compares commands with limits. Where some are beyond, the record is predicted with and without the limits,
/// by predictors that follow it: the more likely one decides whether the vehicle responded beyond the limits.
pub fn limits(records: &[Record], vehicle: &Vehicle, options: &Options) -> Limits {
    let beyond = beyond(records, vehicle);
    if beyond.is_empty() {
        return Limits { wider: None, found: Vec::new() };
    }
    let mut wider = vehicle.clone();
    for (j, least, greatest, _) in &beyond {
        let input = &mut wider.inputs[*j];
        (input.lower, input.upper) = (input.lower.min(*least), input.upper.max(*greatest));
    }
    let likeliest = |vehicle: &Vehicle| {
        let data = Data::join(records, vehicle, options.period_s.or_else(|| coarser_period(records))).ok()?;
        memories(vehicle, &data).first().map(|m| m.likelihood)
    };
    let answered = likeliest(vehicle).zip(likeliest(&wider)).map(|(within, open)| within.bic_gain(&open));
    let answered = answered.unwrap_or(0.0);
    let found = beyond.iter().map(|(j, least, greatest, share)| {
        let input = &vehicle.inputs[*j];
        let shown = |v: f64| input.unit.shown().text(v);
        let whose = if answered > MIN_BIC_GAIN {
            "the outputs responded to them: the file's limits are too narrow and were widened to the range of the commands"
        } else if answered < -MIN_BIC_GAIN {
            "the outputs did not respond beyond them: the vehicle has those limits, and the recorded commands were clipped"
        } else {
            "the record does not show whether the outputs responded beyond the limits: the file's limits are kept"
        };
        DataFinding {
            kind: "limit".into(),
            place: input.name.clone(),
            text: format!(
                "{} was commanded from {} to {}, for {:.0} % of the time beyond the file's limits of {} and {}; {whose}",
                input.name,
                shown(*least),
                shown(*greatest),
                100.0 * share,
                shown(input.lower),
                shown(input.upper)
            ),
            blocking: false,
        }
    });
    Limits { found: found.collect(), wider: (answered > MIN_BIC_GAIN).then_some(wider) }
}

/// Inputs that were commanded beyond their limits for more than a few samples: index, least and greatest command, share of
/// the samples beyond.
fn beyond(records: &[Record], vehicle: &Vehicle) -> Vec<(usize, f64, f64, f64)> {
    let one = |(j, input): (usize, &whirlstand_vehicle::Input)| {
        let values = records.iter().filter_map(|r| r.get(&input.name)).flat_map(|s| s.values.iter().copied());
        let values: Vec<f64> = values.filter(|v| v.is_finite()).collect();
        // Rounding of a command at the limit does not count as beyond it.
        let reach = 1e-3 * (input.upper - input.lower);
        let out = |v: &&f64| **v < input.lower - reach || **v > input.upper + reach;
        let count = values.iter().filter(out).count();
        let least = values.iter().copied().fold(f64::INFINITY, f64::min);
        let greatest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        (count >= MIN_HELD_SAMPLES).then(|| (j, least, greatest, count as f64 / values.len() as f64))
    };
    vehicle.inputs.iter().enumerate().filter_map(one).collect()
}
