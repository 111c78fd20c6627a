//! Improvement by the extension on a held-out part of the record.

use std::ops::Range;

use crate::thresholds::LOUD_RATIO;
use whirlstand_vehicle::{Kind, Vehicle};

use crate::answer::reestimate::reestimated;
use crate::answer::schema::HeldOut;
use crate::answer::score::{Score, score, score_within, share};
use crate::data::record::Data;
use crate::model::commands::Commands;
use crate::model::fit::{Fit, Model};
use crate::model::free_run::FreeRun;
use crate::model::predictor::{default_horizon_s, with_forces};
use crate::search::selection::Selection;
use crate::stages::baseline::Baseline;
use crate::stages::residual::Residual;

/// Predictions of the whole record by models fitted to its first part only.
#[derive(Debug, Clone)]
pub struct Gains {
    /// The part that was held out.
    pub heldout: HeldOut,
    /// First step of the held-out part.
    pub cut: usize,
    /// Prediction of all samples by the given vehicle: its free run, or predictions over the horizon where a
    /// free run is not meaningful.
    pub before: Vec<f64>,
    /// Prediction of all samples by the vehicle with all causes, of the same kind as `before`.
    pub after: Vec<f64>,
    /// Scores of every channel on the held-out part.
    pub channels: Vec<Gain>,
}

/// Scores of one channel on the held-out part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gain {
    /// Scores of the free runs before and after; `None` where free runs are not meaningful.
    pub free_run: Option<(Score, Score)>,
    /// Scores of the predictions over the horizon, before and after.
    pub horizon: (Score, Score),
    /// Standard deviation of the noise; 0 where it is not known.
    pub floor: f64,
    /// Share of the output's power that is left to the noise model, where no noise is declared.
    pub noise_model_share: Option<f64>,
}

/// A model that was fitted to the first part of a record.
struct Trained {
    /// Predictions of the record's own predictor: a free run, or a filter that follows the record.
    own: Vec<f64>,
    /// Predictions over the horizon; NaN where there is none.
    ahead: Vec<f64>,
}

impl Gain {
    /// Logarithm of the ratio of the errors over the horizon, after to before.
    pub fn growth(&self) -> Option<f64> {
        let (before, after) = self.horizon;
        Some((after.rmse? / before.rmse?).ln()).filter(|ratio| ratio.is_finite())
    }
}

/// Mean of the growth of the outputs' errors; 0 without any.
pub fn mean_growth<'g>(gains: impl Iterator<Item = &'g Gain>) -> f64 {
    let all: Vec<f64> = gains.filter_map(Gain::growth).collect();
    all.iter().sum::<f64>() / all.len().max(1) as f64
}

/// Fits the given and the extended vehicle to the first part of the record, and scores both on the last part.
pub(crate) fn gains(baseline: &Baseline<'_>, residual: &Residual<'_>) -> Gains {
    let (data, vehicle) = (baseline.data(), baseline.vehicle());
    let selection = &residual.selection;
    let cut = data.held_out_from();
    let (asked, likeliest_s) = (baseline.checked.loaded.options.horizon_s, data.likeliest_s);
    let horizon_s = asked.unwrap_or_else(|| default_horizon_s(vehicle, data, likeliest_s));
    let follows = data.memory_s.is_some();
    // To predict over a horizon, even a model fitted as a free run is corrected by the record up to then,
    // with a memory as long as the horizon.
    let following = Data { memory_s: likeliest_s.or(Some(horizon_s)), ..data.clone() };
    let training = first_part(data, cut);
    let free_run = FreeRun::new(vehicle, &training);
    let trained = |full: &Fit, model: &Model<'_, '_>| -> Trained {
        let model = Model { free_run: &free_run, free: model.free, terms: model.terms.clone() };
        // A parameter that only the held-out part determines (an event within it) keeps its value of the
        // whole record.
        let fit =
            model.fit(full.values.clone(), Some(&full.profile.noise), Some(&full.columns[..model.states()]));
        let fit = fit.ok();
        let again = fit.as_ref().and_then(|fit| reestimated(&model, fit));
        let (values, own) = again
            .map(|again| (again.values, again.predicted))
            .or_else(|| fit.map(|f| (f.values, f.predicted)))
            .unwrap_or_else(|| (full.values.clone(), full.predicted.clone()));
        let ahead = ahead(&following, &model, &values, (horizon_s, cut));
        let ahead = ahead.unwrap_or_else(|| vec![f64::NAN; full.predicted.len()]);
        Trained { own, ahead }
    };
    // Before: the vehicle as given, without any refit.
    let bare = Model { terms: Vec::new(), free: &[], ..selection.model.clone() };
    let states = bare.states();
    let given = Fit { values: selection.null.values[..states].to_vec(), ..selection.null.clone() };
    let named = !(selection.model.terms.is_empty() && selection.model.free.is_empty());
    let (before, after) =
        rayon::join(|| trained(&given, &bare), || named.then(|| trained(&selection.fit, &selection.model)));
    let after = after.as_ref().unwrap_or(&before);
    let channels = data.channels.iter().zip(data.ranges()).enumerate().map(|(c, (channel, range))| {
        let score = |predicted: &[f64]| score(channel, &predicted[range.clone()], cut);
        let floor = floor(&selection.fit, data, vehicle, c);
        let horizon = (score(&before.ahead), score(&after.ahead));
        let free_run = (score(&before.own), score(&after.own));
        let lost = is_lost(free_run.1, horizon.1, floor) && never_forgets(selection, &range);
        let free_run = (!follows && !lost).then_some(free_run);
        let error = free_run.unwrap_or(horizon).1;
        Gain {
            free_run,
            horizon,
            floor,
            noise_model_share: (vehicle.outputs[channel.output].noise == 0.0).then(|| share(error)),
        }
    });
    let time = |k: usize| data.start_s + k as f64 * data.period_s;
    let shown = |trained: &Trained| if follows { trained.ahead.clone() } else { trained.own.clone() };
    Gains {
        heldout: HeldOut { from_s: time(cut), to_s: time(data.steps - 1), horizon_s },
        cut,
        channels: channels.collect(),
        before: shown(&before),
        after: shown(after),
    }
}

/// The record with all samples from step `cut` on excluded.
fn first_part(data: &Data, cut: usize) -> Data {
    let mut training = data.clone();
    for channel in &mut training.channels {
        let after = (0..channel.good.len()).find(|k| channel.step(*k) >= cut).unwrap_or(channel.good.len());
        channel.good[after..].fill(false);
        channel.early.retain(|k| *k < after);
    }
    training
}

/// True when a free run is clearly worse than the mean although predictions over the horizon are better than
/// it.
fn is_lost(free_run: Score, horizon: Score, floor: f64) -> bool {
    let loud = free_run.rmse.is_some_and(|rmse| rmse > LOUD_RATIO * floor);
    loud && free_run.fit.is_some_and(|fit| fit <= 0.0) && horizon.fit.is_some_and(|fit| fit > 0.0)
}

/// True when a channel depends on a past state until the end of the record, as an integrator does: its free
/// run is then the sum of all gusts, which no model knows.
fn never_forgets(selection: &Selection<'_, '_>, range: &Range<usize>) -> bool {
    selection.fit.columns[..selection.model.states()].iter().any(|column| {
        let moved = &column[range.clone()];
        let peak = moved.iter().fold(0.0f64, |peak, v| peak.max(v.abs()));
        let last = moved.iter().rev().find(|v| v.is_finite()).map_or(0.0, |v| v.abs());
        last * std::f64::consts::E > peak && peak > 0.0
    })
}

/// Predictions of a model over a horizon, corrected by the whole record up to the start of each: of the state, and of
/// what else pushes the vehicle. Of the likeliest filter, where it is known, and one with a force on each state and a single
/// memory, that which predicts the first part better: a likelihood is of one step, beside coloured noise that no prediction
/// over a horizon has.
fn ahead(
    following: &Data,
    model: &Model<'_, '_>,
    values: &[f64],
    (horizon_s, cut): (f64, usize),
) -> Option<Vec<f64>> {
    let steps = ((horizon_s / following.period_s).round() as usize).max(1);
    let vehicle = model.vehicle(values).ok()?;
    let states = vehicle.states.len();
    // The states of another mode are those of the vehicle alone.
    let modes = vehicle.effects.iter().any(|effect| effect.kind() == Kind::ModeTransition);
    let filter = following.likeliest_filter.as_deref().filter(|filter| !(modes && filter.forced));
    let forced = if modes { vehicle.clone() } else { with_forces(&vehicle) };
    let runs =
        [filter.and_then(|filter| filter.runs(&vehicle, following)), Some(FreeRun::new(&forced, following))];
    let predicted = runs.into_iter().flatten().filter_map(|runs| {
        let forces = vec![0.0; runs.states() - states];
        let initial = values[..model.states()].chunks_exact(states).flat_map(|x| [x, &forces[..]].concat());
        let begun = runs.begun(&runs.vehicle, &initial.collect::<Vec<_>>(), cut);
        runs.ahead(&runs.vehicle, &begun, steps, Commands::Recorded).ok()
    });
    let error = |predicted: &Vec<f64>| -> f64 {
        let channels = following.channels.iter().zip(following.ranges());
        channels
            .filter_map(|(channel, range)| score_within(channel, &predicted[range], 0..cut).rmse)
            .map(f64::ln)
            .sum()
    };
    predicted.min_by(|a, b| error(a).total_cmp(&error(b)))
}

/// Noise of a channel: the whole residual where nothing is left to explain, else its one-step unpredictable
/// part. Innovations of a filter that follows the record with a long memory are larger than errors over a horizon: there,
/// it is the declared noise, 0 where none is.
fn floor(fit: &Fit, data: &Data, vehicle: &Vehicle, c: usize) -> f64 {
    let declared = vehicle.outputs[data.channels[c].output].noise;
    if data.memory_s.is_some() {
        return declared;
    }
    let total = fit.profile.noise.std(c, data, &fit.residual);
    let innovation = fit.profile.noise.channels[c].variance().sqrt();
    if declared > 0.0 && total > 2.0 * declared { innovation.max(declared) } else { total }
}
