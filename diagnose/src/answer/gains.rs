//! What the extension gains on a part of the record that it was not fitted to.

use std::ops::Range;

use crate::thresholds::{HELD_OUT_SHARE, LOUD_RATIO};
use whirlstand_logs::stats::{mean, rms};
use whirlstand_vehicle::Vehicle;

use crate::answer::schema::HeldOut;
use crate::data::record::{Channel, Data};
use crate::model::commands::Commands;
use crate::model::fit::{Fit, Model};
use crate::model::free_run::FreeRun;
use crate::model::noise::Noise;
use crate::model::predictor::default_horizon_s;
use crate::search::selection::Selection;
use crate::stages::baseline::Baseline;
use crate::stages::residual::Residual;

/// Predictions of the whole record by models that were fitted to its first part.
#[derive(Debug, Clone)]
pub struct Gains {
    /// The part that was held out.
    pub heldout: HeldOut,
    /// The first step of it.
    pub cut: usize,
    /// Prediction of the given vehicle, all samples: its free run, or, where that means nothing, over the horizon.
    pub before: Vec<f64>,
    /// The same with all causes.
    pub after: Vec<f64>,
    /// Figures of every channel on the held-out part.
    pub channels: Vec<Gain>,
}

/// Figures of one channel on the held-out part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gain {
    /// Free runs before and after; `None` where they mean nothing.
    pub free_run: Option<(Score, Score)>,
    /// Predictions over the horizon before and after.
    pub horizon: (Score, Score),
    /// Standard deviation of the noise.
    pub floor: f64,
    /// Where none is declared, the share of the output's power that the noise model takes.
    pub noise_model_share: Option<f64>,
}

/// How well one channel is predicted.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Score {
    /// Fit, %; `None` when the channel does not change.
    pub fit: Option<f64>,
    /// Root of the mean square error; `None` without samples.
    pub rmse: Option<f64>,
}

/// A model that was fitted to the first part of a record.
struct Trained {
    /// What the predictor of the record predicts.
    own: Vec<f64>,
    /// Predictions over the horizon; NaN where there is none.
    ahead: Vec<f64>,
}

/// Fits before and after to the first part of the record, and judges both on the last.
pub(crate) fn gains(baseline: &Baseline<'_>, residual: &Residual<'_>) -> Gains {
    let (data, vehicle) = (baseline.data(), baseline.vehicle());
    let selection = &residual.selection;
    let cut = ((1.0 - HELD_OUT_SHARE) * data.steps as f64) as usize;
    let (asked, likeliest_s) =
        (baseline.checked.loaded.options.horizon_s, baseline.checked.loaded.likeliest_s);
    let horizon_s = asked.unwrap_or_else(|| default_horizon_s(vehicle, data, likeliest_s));
    let follows = data.memory_s.is_some();
    // Over a horizon even a model of the free run follows the record until then, for as long as the horizon reaches.
    let following = Data { memory_s: likeliest_s.or(Some(horizon_s)), ..data.clone() };
    let following = FreeRun::new(vehicle, &following);
    let training = first_part(data, cut);
    let free_run = FreeRun::new(vehicle, &training);
    let trained = |full: &Fit, model: &Model<'_, '_>| -> Trained {
        let model = Model { free_run: &free_run, free: model.free, terms: model.terms.clone() };
        // What only the held-out part shows (an event in it) keeps the value that the whole record gives.
        let fit = if model.free.is_empty() {
            model
                .fit(full.values.clone(), Some(&full.profile.noise), Some(&full.columns[..model.states()]))
                .ok()
        } else {
            output_error(&model, full)
        };
        let values = fit.as_ref().map_or(&full.values, |f| &f.values);
        let ahead = ahead(&following, &model, values, horizon_s);
        let ahead = ahead.unwrap_or_else(|| vec![f64::NAN; full.predicted.len()]);
        Trained { own: fit.map_or_else(|| full.predicted.clone(), |f| f.predicted), ahead }
    };
    // Before: the vehicle as it was given, whatever a refit would make of it.
    let bare = Model { terms: Vec::new(), free: &[], ..selection.model.clone() };
    let states = bare.states();
    let given = Fit { values: selection.null.values[..states].to_vec(), ..selection.null.clone() };
    let before = trained(&given, &bare);
    let named = !(selection.model.terms.is_empty() && selection.model.free.is_empty());
    let after = named.then(|| trained(&selection.fit, &selection.model));
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

/// The record with the samples from a step on set aside.
fn first_part(data: &Data, cut: usize) -> Data {
    let mut training = data.clone();
    for channel in &mut training.channels {
        for k in 0..channel.good.len() {
            channel.good[k] &= channel.step(k) < cut;
        }
    }
    training
}

/// How well a channel is predicted from a step on; samples without a prediction do not count.
fn score(channel: &Channel, predicted: &[f64], cut: usize) -> Score {
    let rows = (0..channel.values.len())
        .filter(|k| channel.good[*k] && channel.step(*k) >= cut && predicted[*k].is_finite());
    let (measured, errors): (Vec<f64>, Vec<f64>) =
        rows.map(|k| (channel.values[k], channel.values[k] - predicted[k])).unzip();
    let middle = mean(&measured);
    let spread = rms(&measured.iter().map(|y| y - middle).collect::<Vec<_>>());
    let rmse = (!errors.is_empty()).then(|| rms(&errors));
    Score { fit: rmse.filter(|_| spread > 0.0).map(|e| 100.0 * (1.0 - e / spread)), rmse }
}

/// True when a free run is loudly worse than the mean, though predictions over the horizon are better than that.
fn is_lost(free_run: Score, horizon: Score, floor: f64) -> bool {
    let loud = free_run.rmse.is_some_and(|rmse| rmse > LOUD_RATIO * floor);
    loud && free_run.fit.is_some_and(|fit| fit <= 0.0) && horizon.fit.is_some_and(|fit| fit > 0.0)
}

/// True when a channel keeps what a state once was to the end of the record, as one does that integrates: then its free run
/// is the sum of all gusts, which no model knows.
fn never_forgets(selection: &Selection<'_, '_>, range: &Range<usize>) -> bool {
    selection.fit.columns[..selection.model.states()].iter().any(|column| {
        let moved = &column[range.clone()];
        let peak = moved.iter().fold(0.0f64, |peak, v| peak.max(v.abs()));
        let last = moved.iter().rev().find(|v| v.is_finite()).map_or(0.0, |v| v.abs());
        last * std::f64::consts::E > peak && peak > 0.0
    })
}

/// What a prediction leaves, as a share of the power about the mean, 0 to 1.
fn share(score: Score) -> f64 {
    score.fit.map_or(0.0, |fit| (1.0 - fit / 100.0).powi(2).min(1.0))
}

/// The predictions of a model over a horizon, with the whole record to follow.
fn ahead(free_run: &FreeRun<'_>, model: &Model<'_, '_>, values: &[f64], horizon_s: f64) -> Option<Vec<f64>> {
    let steps = ((horizon_s / free_run.data.period_s).round() as usize).max(1);
    let vehicle = model.vehicle(values).ok()?;
    free_run.ahead(&vehicle, &values[..model.states()], steps, Commands::Recorded).ok()
}

/// The same structure fitted for the free run: where a noise model takes slow residuals for colour, parameters that are
/// refitted leave them in the simulation. Names and intervals are those of the likelihood, simulations those of this.
pub(crate) fn output_error(model: &Model<'_, '_>, fit: &Fit) -> Option<Fit> {
    let data = model.free_run.data;
    let channels = 0..data.channels.len();
    let stds: Vec<f64> = channels.map(|c| fit.profile.noise.std(c, data, &fit.residual)).collect();
    model.fit(fit.values.clone(), Some(&Noise::white(&stds)), None).ok()
}

/// Noise of a channel: all of the residual where nothing is left to explain, else what could not be foretold of it.
fn floor(fit: &Fit, data: &Data, vehicle: &Vehicle, c: usize) -> f64 {
    let total = fit.profile.noise.std(c, data, &fit.residual);
    let declared = vehicle.outputs[data.channels[c].output].noise;
    let innovation = fit.profile.noise.channels[c].variance.sqrt();
    if declared > 0.0 && total > 2.0 * declared { innovation.max(declared) } else { total }
}
