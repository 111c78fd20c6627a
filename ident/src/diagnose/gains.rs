//! What the extension gains on a part of the record that it was not fitted to.

use whirlstand_vehicle::Vehicle;

use super::answer::HeldOut;
use super::data::Data;
use super::model::{Fit, Model};
use super::noise::Noise;
use super::run::Findings;
use super::runner::Runner;

/// The last part of a record, as a share, is held out.
const HELD_OUT: f64 = 1.0 / 3.0;

/// Free runs over the whole record, fitted to its first part.
#[derive(Debug, Clone)]
pub struct Gains {
    /// The part that was held out.
    pub heldout: HeldOut,
    /// Prediction of the given vehicle, all samples.
    pub before: Vec<f64>,
    /// Prediction with all causes.
    pub after: Vec<f64>,
    /// For every channel: fits and root mean square errors before and after, and the noise floor.
    pub channels: Vec<Gain>,
}

/// Figures of one channel on the held-out part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gain {
    /// Fit before, %.
    pub fit_before: Option<f64>,
    /// Fit after, %.
    pub fit_after: Option<f64>,
    /// Root mean square error before.
    pub rmse_before: Option<f64>,
    /// Root mean square error after.
    pub rmse_after: Option<f64>,
    /// Standard deviation of the noise.
    pub floor: f64,
}

/// Fits before and after to the first part of the record, and judges both on the last.
pub(super) fn gains(findings: &Findings<'_, '_>, data: &Data, vehicle: &Vehicle) -> Gains {
    let selection = &findings.selection;
    let cut = ((1.0 - HELD_OUT) * data.steps as f64) as usize;
    let mut training = data.clone();
    for channel in &mut training.channels {
        for k in 0..channel.good.len() {
            channel.good[k] &= channel.step(k) < cut;
        }
    }
    let runner = Runner::new(vehicle, &training);
    let trained = |full: &Fit, model: &Model<'_, '_>| -> Vec<f64> {
        let model = Model { runner: &runner, free: model.free, terms: model.terms.clone() };
        // What only the held-out part shows (an event in it) keeps the value that the whole record gives.
        let fit = if model.free.is_empty() {
            model.fit(full.values.clone(), Some(&full.profile.noise), Some(&full.columns[..model.states()]))
        } else {
            output_error(&model, full)
        };
        fit.map_or_else(|| full.predicted.clone(), |f| f.predicted)
    };
    // Before: the vehicle as it was given, whatever a refit would make of it.
    let bare = Model { terms: Vec::new(), free: &[], ..selection.model.clone() };
    let states = bare.states();
    let given = Fit { values: selection.null.values[..states].to_vec(), ..selection.null.clone() };
    let before = trained(&given, &bare);
    let after = if selection.model.terms.is_empty() && selection.model.free.is_empty() {
        before.clone()
    } else {
        trained(&selection.fit, &selection.model)
    };
    let channels = data.channels.iter().zip(data.ranges()).enumerate().map(|(c, (channel, range))| {
        let rows: Vec<usize> =
            (0..channel.values.len()).filter(|k| channel.good[*k] && channel.step(*k) >= cut).collect();
        let measured: Vec<f64> = rows.iter().map(|k| channel.values[*k]).collect();
        let mean = crate::stats::mean(&measured);
        let spread = crate::stats::rms(&measured.iter().map(|y| y - mean).collect::<Vec<_>>());
        let rmse = |predicted: &[f64]| {
            let errors: Vec<f64> =
                rows.iter().map(|k| channel.values[*k] - predicted[range.start + k]).collect();
            (!errors.is_empty()).then(|| crate::stats::rms(&errors))
        };
        let fit = |rmse: Option<f64>| rmse.filter(|_| spread > 0.0).map(|e| 100.0 * (1.0 - e / spread));
        let (rmse_before, rmse_after) = (rmse(&before), rmse(&after));
        Gain {
            fit_before: fit(rmse_before),
            fit_after: fit(rmse_after),
            rmse_before,
            rmse_after,
            floor: floor(findings, data, vehicle, c),
        }
    });
    let time = |k: usize| data.start_s + k as f64 * data.period_s;
    Gains {
        heldout: HeldOut { from_s: time(cut), to_s: time(data.steps - 1) },
        channels: channels.collect(),
        before,
        after,
    }
}

/// The same structure fitted for the free run: where a noise model takes slow residuals for colour, parameters that are
/// refitted leave them in the simulation. Names and intervals are those of the likelihood, simulations those of this.
pub(super) fn output_error(model: &Model<'_, '_>, fit: &Fit) -> Option<Fit> {
    let data = model.runner.data;
    let channels = 0..data.channels.len();
    let stds: Vec<f64> = channels.map(|c| fit.profile.noise.std(c, data, &fit.residual)).collect();
    model.fit(fit.values.clone(), Some(&Noise::white(&stds)), None)
}

/// Noise of a channel: all of the residual where nothing is left to explain, else what could not be foretold of it.
fn floor(findings: &Findings<'_, '_>, data: &Data, vehicle: &Vehicle, c: usize) -> f64 {
    let fit = &findings.selection.fit;
    let total = fit.profile.noise.std(c, data, &fit.residual);
    let declared = vehicle.outputs[data.channels[c].output].noise;
    let innovation = fit.profile.noise.channels[c].variance.sqrt();
    if declared > 0.0 && total > 2.0 * declared { innovation.max(declared) } else { total }
}
