//! Diagnosis of a simulation against flight records: its errors, their causes, and the improvement by
//! correcting them.
//!
//! A diagnosis is a sequence of stages, each a type in [`stages`]: load, check, baseline, select, residual,
//! findings, answer.

pub mod answer;
pub mod candidates;
pub mod data;
mod error;
pub mod model;
mod options;
pub mod residual;
pub mod screen;
pub mod search;
pub(crate) mod stages;
mod thresholds;

use std::sync::Arc;

use whirlstand_logs::Record;
use whirlstand_vehicle::Vehicle;

pub use answer::{DIAGNOSIS_SCHEMA, Diagnosis, Verdict};
pub use error::DiagnoseError;
pub use options::Options;
pub use whirlstand_ident::watch::{Stage, Watch};

use answer::compose;
use data::limits::limits;
use data::record::{Channel, StateFilter};
use model::free_run::FreeRun;
use model::predictor::memories;
use stages::baseline::Baseline;
use stages::check::Checked;
use stages::findings::Findings;
use stages::load::Loaded;
use stages::residual::Residual;
use stages::select::Selected;
use stages::weighed::Weighed;
use thresholds::MIN_BIC_GAIN;

/// Diagnoses one or more records of a vehicle. They are dropped as soon as they are on the grid of the search,
/// because a record at its own rate may be longer than everything that the search needs.
///
/// # Errors
/// [`DiagnoseError`] when nothing can be simulated; problems of data that can be simulated are part of the
/// answer.
///
/// # Panics
/// Without a record.
pub fn diagnose(
    records: Vec<Record>,
    vehicle: &Vehicle,
    options: &Options,
) -> Result<Diagnosis, DiagnoseError> {
    if !vehicle.sensor_noise_is_estimated() {
        return diagnosed(records, vehicle, options);
    }
    // Sample-to-sample changes in flight are no upper bound of the noise: it is fitted, as where none is
    // declared.
    let mut undeclared = vehicle.clone();
    undeclared.outputs.iter_mut().for_each(|output| output.noise = 0.0);
    let mut answer = diagnosed(records, &undeclared, options)?;
    if let Some(extended) = &mut answer.extended {
        extended.outputs.iter_mut().zip(&vehicle.outputs).for_each(|(own, given)| own.noise = given.noise);
    }
    Ok(answer)
}

/// The diagnosis under the assumption that the noise in the vehicle file is the sensors' true noise.
fn diagnosed(records: Vec<Record>, vehicle: &Vehicle, options: &Options) -> Result<Diagnosis, DiagnoseError> {
    let units = screen::wrong_units(&records, vehicle, options.period_s)?;
    if !units.is_empty() {
        let mut loaded = Loaded::new(&records, vehicle, options)?;
        loaded.found.extend(units);
        return Ok(answered(&loaded).answer);
    }
    let limits = limits(&records, vehicle, options);
    let mut loaded = Loaded::new(&records, limits.wider.as_ref().unwrap_or(vehicle), options)?;
    loaded.found.extend(limits.found);
    loaded.stranger = screen::stranger(&records, vehicle, &options.modes, options.period_s)?;
    drop(records);
    if loaded.data.channels.iter().any(|c| loaded.vehicle.outputs[c.output].noise == 0.0) {
        loaded.options.watch.tell("fitting a filter to the record");
        let filter = StateFilter::likeliest(loaded.vehicle, &Checked::new(&loaded).data, &options.watch);
        loaded.data.likeliest_filter = filter.map(Arc::new);
    }
    let free = over_commands(&loaded);
    if free.blocked {
        return Ok(free.answer);
    }
    Ok(match followed(&loaded, &free) {
        Some(followed) => followed.answer,
        None => free.answer,
    })
}

/// The answer of a predictor that follows the record, where it is more likely than the free run with all its
/// causes, either with the vehicle alone or with its own causes. A meaningful free run's residual has to be
/// explained: a filter that found no cause has only absorbed it as process noise.
fn followed(loaded: &Loaded<'_>, free: &Weighed) -> Option<Weighed> {
    // Where all noise is declared, nothing beyond it may be taken for noise.
    let declared = |c: &Channel| loaded.vehicle.outputs[c.output].noise > 0.0;
    let declared = loaded.data.channels.iter().all(declared);
    let explained = free.answer.verdict == Verdict::Explained;
    if (free.means_something || explained) && declared || loaded.options.watch.is_stopped() {
        return None;
    }
    let data = Checked::new(loaded).data;
    let known = loaded.data.likeliest_filter.clone();
    let filter = known
        .or_else(|| StateFilter::likeliest(loaded.vehicle, &data, &loaded.options.watch).map(Arc::new))?;
    let likelihood = filter.likelihood(loaded.vehicle, &data)?;
    let unlikely = free.likelihood.is_some_and(|l| l.bic_gain(&likelihood) < MIN_BIC_GAIN);
    if free.means_something && unlikely {
        return None;
    }
    // Process noise absorbs causes, and more so the shorter the memory: causes are searched for with the
    // longest memory. Colour that remains in the innovations is modelled anew beside every candidate.
    let memories = memories(loaded.vehicle, &data);
    let likeliest = memories.first()?;
    let longest = memories.iter().max_by(|a, b| a.seconds.total_cmp(&b.seconds))?;
    let mut best = over_commands(&loaded.remembering(longest.seconds, likeliest.seconds, filter));
    let likelihood = best.likelihood?;
    // Named turbulence makes a free run a bad prediction and a good model.
    let plainly_likelier = free.likelihood.is_some_and(|l| l.bic_gain(&likelihood) < -MIN_BIC_GAIN);
    let free_stands = if free.means_something {
        best.answer.causes.is_empty()
    } else {
        declared && plainly_likelier && !free.answer.causes.is_empty()
    };
    if free_stands {
        return None;
    }
    if free.means_something && free.answer.verdict == Verdict::Unexplained {
        compose::doubt(&mut best.answer, HIDDEN_BY_FILTER.into());
    }
    Some(best)
}

/// Doubt about causes beside a filter, where a free run that means something found none.
const HIDDEN_BY_FILTER: &str =
    "no cause explains the record without a filter, whose process noise may hide another one";

/// The answer over loaded records. Commands before a record are unknown: the first command is assumed to have
/// been applied before, unless the causes found under that assumption are clearly worse than with inputs at
/// rest.
fn over_commands(loaded: &Loaded<'_>) -> Weighed {
    if !loaded.data.begins_moving(loaded.vehicle) {
        return answered(loaded);
    }
    let held = answered(&loaded.held());
    let stopped = loaded.options.watch.is_stopped();
    if held.rest_before && !stopped { answered(loaded) } else { held }
}

/// Runs all stages over loaded records.
fn answered(loaded: &Loaded<'_>) -> Weighed {
    let baseline = match Baseline::new(Checked::new(loaded)) {
        Ok(baseline) => baseline,
        Err(no_baseline) => return Weighed::nothing(compose::no_prediction(&no_baseline.0, no_baseline.1)),
    };
    let free_run = FreeRun::new(loaded.vehicle, baseline.data()).watched(&loaded.options.watch);
    let selected = match Selected::new(&baseline, &free_run) {
        Ok(selected) => selected,
        Err(why) => return Weighed::nothing(compose::no_prediction(&baseline.checked, why)),
    };
    let residual = Residual::new(selected);
    Weighed::new(Findings::new(&baseline, residual))
}
