//! Findings stage: everything that was found, the extended vehicle, and its improvement.

use std::collections::BTreeMap;

use whirlstand_vehicle::{Effect, Kind, Vehicle};

use super::baseline::Baseline;
use super::residual::Residual;
use crate::answer::Estimate;
use crate::answer::gains::{self, Gains, mean_growth};
use crate::answer::reestimate::reestimated;
use crate::candidates::Tunable;
use crate::residual::narrow_band;
use crate::thresholds::WORSE_AHEAD_RATIO;

/// Everything that was found, before it is put into words.
#[derive(Debug)]
pub(crate) struct Findings<'r> {
    pub baseline: &'r Baseline<'r>,
    pub residual: Residual<'r>,
    /// The vehicle with everything that was found; `None` when nothing was.
    pub extended: Option<Vehicle>,
    /// Values of the model, its free parameters as they were estimated last.
    pub values: Vec<f64>,
    pub gains: Gains,
}

impl<'r> Findings<'r> {
    pub fn new(baseline: &'r Baseline<'r>, mut residual: Residual<'r>) -> Self {
        let mut gains = gains::gains(baseline, &residual);
        let fits: Vec<Option<f64>> = gains.channels.iter().map(|channel| channel.horizon.1.fit).collect();
        if residual.withdraw_without_skill(baseline, &fits) {
            gains = gains::gains(baseline, &residual);
        }
        // Values that predict worse than the given ones are no better estimates, whatever they gain in likelihood: noise
        // that is not what any noise model says makes large gains of them (cross-validation: Stone 1974).
        let refitted_only =
            residual.selection.model.terms.is_empty() && !residual.selection.model.free.is_empty();
        if refitted_only
            && mean_growth(gains.channels.iter()) > WORSE_AHEAD_RATIO.ln()
            && residual.keep_given_values(baseline)
        {
            gains = gains::gains(baseline, &residual);
        }
        let (model, fit) = (&residual.selection.model, &residual.selection.fit);
        let values = reestimated(model, fit).map_or_else(|| fit.values.clone(), |again| again.values);
        let extended = extended(baseline.vehicle(), &residual, &values);
        Self { baseline, residual, extended, values, gains }
    }
}

/// The vehicle with everything that was found, with these values of the model's parameters.
fn extended(vehicle: &Vehicle, residual: &Residual<'_>, values: &[f64]) -> Option<Vehicle> {
    let model = &residual.selection.model;
    let mut extended = vehicle.clone();
    for (free, value) in model.free.iter().zip(&values[model.states()..]) {
        extended.set_free(&free.target, *value).ok()?;
    }
    let data = model.free_run.data;
    let output = |channel: usize| vehicle.outputs[data.channels[channel].output].name.as_str();
    let samples = residual.samples.iter().filter_map(|effect| {
        let parameters: Vec<(&str, f64)> = effect.parameters.iter().map(|(n, v)| (*n, v.0)).collect();
        Effect::new(effect.kind, output(effect.channel), &parameters).ok()
    });
    let turbulence = residual.turbulence.iter().filter_map(|t| {
        let parameters = [("std", t.std.0), ("bandwidth_hz", t.bandwidth_hz.0)];
        Effect::new(Kind::Turbulence, &vehicle.states[t.state].name, &parameters).ok()
    });
    let noise = residual.noise.iter().filter_map(|(channel, noise)| {
        Effect::new(Kind::Noise, output(*channel), &[("std", noise.std.0)]).ok()
    });
    let mut any = false;
    for effect in model.effects(values).ok()?.into_iter().chain(samples).chain(turbulence).chain(noise) {
        any |= extended.add_effect(effect).is_ok();
    }
    for found in &residual.narrow_band {
        narrow_band::declare(&mut extended, data, found);
    }
    (any || !residual.narrow_band.is_empty()).then_some(extended)
}

/// Names and 95 % intervals of a term's values.
pub(crate) fn estimates(residual: &Residual<'_>, term: usize) -> BTreeMap<String, Estimate> {
    let (model, fit) = (&residual.selection.model, &residual.selection.fit);
    let candidate = &model.terms[term];
    let values = fit.values[model.range(term)].iter().zip(&candidate.tunables);
    let fixed = candidate.fixed.iter().map(|(tunable, value)| (value, tunable));
    let estimate = |((&value, tunable), (low, high)): ((&f64, &Tunable), (f64, f64))| {
        let (mut value, mut low, mut high) = (value, low, high);
        if matches!(tunable.name, "at_s" | "duration_s") {
            // Times within one period cannot be distinguished.
            let period_s = model.free_run.data.period_s;
            low = low.min((value - period_s).max(tunable.lower));
            high = high.max((value + period_s).min(tunable.upper));
        }
        if tunable.name == "phase_rad" {
            let turns = (value / std::f64::consts::TAU).round() * std::f64::consts::TAU;
            (value, low, high) = (value - turns, low - turns, high - turns);
        }
        (tunable.name.to_string(), Estimate::new(value, low, high))
    };
    values.chain(fixed).zip(model.intervals(fit, term)).map(estimate).collect()
}
