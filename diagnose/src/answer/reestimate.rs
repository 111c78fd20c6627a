//! Free parameters of a fitted model, estimated again without the noise model under which its causes were found.

use std::ops::Range;

use whirlstand_vehicle::Kind;

use crate::answer::score::score;
use crate::data::record::Channel;
use crate::model::fit::{Fit, Model};
use crate::model::free_run::FreeRun;
use crate::model::noise::Noise;
use crate::model::state_filter::follow;

/// A model whose initial state and free parameters were estimated again. The causes keep their values, which the answer
/// gives with their intervals.
pub(crate) struct Reestimated {
    /// Values of the model.
    pub values: Vec<f64>,
    /// Samples as the model's own predictor predicts them.
    pub predicted: Vec<f64>,
}

/// Estimates the free parameters again: as an output-error model where the vehicle runs free, else with the likeliest
/// filter. `None` without free parameters, or where neither is possible.
pub(crate) fn reestimated(model: &Model<'_, '_>, fit: &Fit) -> Option<Reestimated> {
    if model.free.is_empty() {
        None
    } else if model.free_run.data.memory_s.is_none() {
        output_error(model, fit)
    } else {
        by_likeliest_filter(model, fit)
    }
}

/// Causes are searched for with a long memory, because process noise absorbs them. Where a law opposes disturbances, a
/// noise model that is not the likeliest biases what the commands do (Ljung, System Identification, 1999, 13.4).
fn by_likeliest_filter(model: &Model<'_, '_>, fit: &Fit) -> Option<Reestimated> {
    let data = model.free_run.data;
    let filter = data.likeliest_filter.as_deref()?;
    // The states of another mode are those of the vehicle alone.
    if filter.forced && model.terms.iter().any(|term| term.kind == Kind::ModeTransition) {
        return None;
    }
    let followed = follow(data);
    let mut vehicle = model.free_run.vehicle.clone();
    for effect in model.effects(&fit.values).ok()? {
        vehicle.add_effect(effect).ok()?;
    }
    let runs = filter.runs(&vehicle, &followed)?;
    let other = Model { free_run: &runs, free: model.free, terms: Vec::new() };
    // From the given values: those of the long memory may be far away.
    let given = model.free.iter().map(|free| vehicle.free_value(&free.target));
    let start = runs.start().into_iter().chain(given).collect();
    let found = other.fit(start, None, None).ok()?;
    let own = model.free_run.states();
    let states = found.values[..other.states()].chunks_exact(runs.states());
    let states = states.flat_map(|x| &x[..own]).copied();
    let free = found.values[other.states()..].iter().copied();
    let terms = fit.values[model.base()..].iter().copied();
    Some(Reestimated { values: states.chain(free).chain(terms).collect(), predicted: fit.predicted.clone() })
}

/// The initial state and free parameters as those of an output-error model: where a noise model takes slow residuals for
/// coloured noise, refitted parameters would leave them in the simulation.
///
/// `None` where the free run is no better than the mean for most outputs. These then move under disturbances, which a law
/// opposes: an output-error fit takes its commands for ineffective (Ljung 1999, 13.4).
fn output_error(model: &Model<'_, '_>, fit: &Fit) -> Option<Reestimated> {
    let data = model.free_run.data;
    let is_simulated = |(channel, range): &(&Channel, Range<usize>)| {
        score(channel, &fit.predicted[range.clone()], 0).fit.is_some_and(|fit| fit > 0.0)
    };
    let simulated = data.channels.iter().zip(data.ranges()).filter(is_simulated).count();
    if 2 * simulated < data.channels.len() {
        return None;
    }
    let channels = 0..data.channels.len();
    let stds: Vec<f64> = channels.map(|c| fit.profile.noise.std(c, data, &fit.residual)).collect();
    let vehicle = model.vehicle(&fit.values).ok()?;
    let free_run = FreeRun::new(&vehicle, data);
    let (base, terms) = fit.values.split_at(model.base());
    let base = Model { free_run: &free_run, free: model.free, terms: Vec::new() }
        .fit(base.to_vec(), Some(&Noise::white(&stds)), None)
        .ok()?;
    Some(Reestimated { values: [&base.values, terms].concat(), predicted: base.predicted })
}
