//! Screening of a record before the search: columns in a wrong unit, and records of another vehicle.

mod gain;
mod predictions;
mod resemblance;
mod responses;
mod units;

pub use resemblance::{Foresight, foresight};
use whirlstand_logs::Record;
use whirlstand_vehicle::{Effect, Vehicle};

use crate::DiagnoseError;
use crate::answer::schema::DataFinding;
use crate::candidates::transitions;
use crate::data::record::{Data, coarser_period_for};
use crate::screen::responses::without_limits;
use crate::thresholds::{MAX_COMPARED_STEPS, MAX_SCREENED_STEPS};

/// Columns of the records in a wrong unit, or of a size that no fault explains; takes about a second.
///
/// # Errors
/// As [`Data::join`].
pub fn wrong_units(
    records: &[Record],
    vehicle: &Vehicle,
    period_s: Option<f64>,
) -> Result<Vec<DataFinding>, DiagnoseError> {
    Ok(units::units(vehicle, &screened(records, vehicle, period_s, MAX_SCREENED_STEPS)?))
}

/// Finding that the records are not of the vehicle, neither in a built-in flight mode nor in one of `modes`;
/// takes about a second.
///
/// # Errors
/// As [`Data::join`].
pub fn stranger(
    records: &[Record],
    vehicle: &Vehicle,
    modes: &[String],
    period_s: Option<f64>,
) -> Result<Option<DataFinding>, DiagnoseError> {
    let data = screened(records, vehicle, period_s, MAX_COMPARED_STEPS)?;
    let open = without_limits(vehicle);
    let modes = transitions::modes(&open, modes).filter_map(|to| {
        let mut other = open.clone();
        other.add_effect(Effect::mode_transition(0.0, &to).ok()?).ok()?;
        Some(other)
    });
    Ok(resemblance::stranger(&open, &modes.collect::<Vec<_>>(), &data))
}

/// The records with commands as recorded, whatever the limits, with at most the given number of steps; with their own where
/// the parts between gaps are too short for longer steps.
fn screened(
    records: &[Record],
    vehicle: &Vehicle,
    period_s: Option<f64>,
    most: f64,
) -> Result<Data, DiagnoseError> {
    let coarser = coarser_period_for(records, period_s, most);
    let open = without_limits(vehicle);
    match Data::join(records, &open, coarser.or(period_s)) {
        Err(DiagnoseError::TooShort { .. }) if coarser.is_some() => Data::join(records, &open, period_s),
        joined => joined,
    }
}
