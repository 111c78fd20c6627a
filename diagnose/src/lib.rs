//! Diagnosis: what a simulation gets wrong, why, and what is gained by mending it.
//!
//! A diagnosis is a list of stages, each a type in [`stages`]: load, check, baseline, select, residual, findings, answer.

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
mod vehicle_poles;

use whirlstand_logs::Record;
use whirlstand_vehicle::Vehicle;

pub use answer::{DIAGNOSIS_SCHEMA, Diagnosis, Verdict};
pub use error::DiagnoseError;
pub use options::Options;
pub use whirlstand_ident::watch::{Stage, Watch};

use answer::compose;
use data::limits::limits;
use data::record::Channel;
use model::free_run::FreeRun;
use model::predictor::memories;
use stages::baseline::Baseline;
use stages::check::Checked;
use stages::findings::Findings;
use stages::load::Loaded;
use stages::residual::Residual;
use stages::select::Selected;
use stages::weighed::Weighed;
use thresholds::{MIN_BIC_GAIN, REST_BEFORE_BIC};

/// Diagnoses one or more records, at least one.
///
/// # Errors
/// [`DiagnoseError`] when there is nothing that could be simulated; what is wrong with data that can is an answer.
///
/// # Panics
/// Without a record.
pub fn diagnose(
    records: &[Record],
    vehicle: &Vehicle,
    options: &Options,
) -> Result<Diagnosis, DiagnoseError> {
    if !vehicle.sensor_noise_is_estimated() {
        return diagnosed(records, vehicle, options);
    }
    // What changes from sample to sample in flight is no bound of what is noise: it is fitted, as where none is declared.
    let mut undeclared = vehicle.clone();
    undeclared.outputs.iter_mut().for_each(|output| output.noise = 0.0);
    let mut answer = diagnosed(records, &undeclared, options)?;
    if let Some(extended) = &mut answer.extended {
        extended.outputs.iter_mut().zip(&vehicle.outputs).for_each(|(own, given)| own.noise = given.noise);
    }
    Ok(answer)
}

/// The diagnosis where the noise that the vehicle file gives is what its sensors err by.
fn diagnosed(records: &[Record], vehicle: &Vehicle, options: &Options) -> Result<Diagnosis, DiagnoseError> {
    let units = screen::wrong_units(records, vehicle, options.period_s)?;
    if !units.is_empty() {
        let mut loaded = Loaded::new(records, vehicle, options)?;
        loaded.found.extend(units);
        return Ok(answered(&loaded).answer);
    }
    let limits = limits(records, vehicle, options);
    let mut loaded = Loaded::new(records, limits.wider.as_ref().unwrap_or(vehicle), options)?;
    loaded.found.extend(limits.found);
    loaded.stranger = screen::stranger(records, vehicle, &options.modes, options.period_s)?;
    let free = over_commands(&loaded);
    if free.blocked {
        return Ok(free.answer);
    }
    Ok(match followed(&loaded, &free) {
        Some(followed) => followed.answer,
        None => free.answer,
    })
}

/// The answer of predictors that follow the record, where they are likelier than the free run with all that was found, by
/// the vehicle alone or with causes of their own. What a free run leaves has to be explained where it means something:
/// a filter that found no cause has only taken it for noise.
fn followed(loaded: &Loaded<'_>, free: &Weighed) -> Option<Weighed> {
    // Where all noise is declared, nothing that goes beyond it may be taken for noise.
    let declared = |c: &Channel| loaded.vehicle.outputs[c.output].noise > 0.0;
    let declared = loaded.data.channels.iter().all(declared);
    let explained = free.answer.verdict == Verdict::Explained;
    if (free.means_something || explained) && declared || loaded.options.watch.is_stopped() {
        return None;
    }
    let memories = memories(loaded.vehicle, &Checked::new(loaded).data);
    let likeliest = memories.first()?;
    let unlikely = free.likelihood.is_some_and(|l| l.bic_gain(&likeliest.likelihood) < MIN_BIC_GAIN);
    if free.means_something && unlikely {
        return None;
    }
    // Process noise takes a cause for noise, the more the sooner it forgets: causes are looked for with the least of it.
    // What that leaves of the record's own colour, the noise of the innovations has, anew beside every candidate.
    let longest = memories.iter().max_by(|a, b| a.seconds.total_cmp(&b.seconds))?;
    loaded.options.watch.tell("fitting a filter to the record");
    let best = over_commands(&loaded.remembering(longest.seconds, likeliest.seconds));
    let likelihood = best.likelihood?;
    // Gusts that are named make a free run a bad prediction and a good model.
    let plainly_likelier = free.likelihood.is_some_and(|l| l.bic_gain(&likelihood) < -MIN_BIC_GAIN);
    let free_stands = if free.means_something {
        best.answer.causes.is_empty()
    } else {
        declared && plainly_likelier && !free.answer.causes.is_empty()
    };
    (!free_stands).then_some(best)
}

/// The answer over loaded records. What came before a record nobody knows: a command that was there at first was there
/// before, unless the causes that are found so do plainly better without.
fn over_commands(loaded: &Loaded<'_>) -> Weighed {
    if !loaded.data.begins_moving(loaded.vehicle) {
        return answered(loaded);
    }
    let held = answered(&loaded.held());
    let stopped = loaded.options.watch.is_stopped();
    if held.rest_before > REST_BEFORE_BIC && !stopped { answered(loaded) } else { held }
}

/// The stages over loaded records.
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
