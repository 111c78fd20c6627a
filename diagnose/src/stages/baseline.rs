//! Baseline stage: the given vehicle, its fit to the channels, and the candidates.

use whirlstand_logs::stats::rms;
use whirlstand_vehicle::{Free, Kind, Vehicle};

use super::check::Checked;
use crate::Options;
use crate::candidates::library::library;
use crate::candidates::transitions::transitions;
use crate::candidates::{Candidate, Sizes};
use crate::data::outliers::outliers;
use crate::data::record::Data;
use crate::data::sample_effect::SampleEffect;
use crate::data::{checks, declared_vibration};
use crate::model::fit::{Fit, Model};
use crate::model::free_run::FreeRun;
use crate::model::optimum::ModelError;
use crate::search::alternative::SearchSpace;
use crate::thresholds::{LIMITED_TIMES_S, MAX_CAUSES};

/// Everything that the search needs; it does not change afterwards.
#[derive(Debug, Clone)]
pub(crate) struct Baseline<'a> {
    pub checked: Checked<'a>,
    /// Free parameters that may be refitted.
    pub free: Vec<Free>,
    /// Standard deviations of the channels' declared noise, rounding included; 0 where none is declared.
    pub declared: Vec<f64>,
    pub sizes: Sizes,
    pub library: Vec<Candidate>,
    /// Samples that counted before outliers were excluded.
    pub good: Vec<Vec<bool>>,
    /// True when the data themselves are wrong, so that no cause can be searched for.
    pub blocked: bool,
}

impl<'a> Baseline<'a> {
    /// Builds the baseline of checked records.
    ///
    /// # Errors
    /// Returns the checked records when the given vehicle's free run diverges.
    pub fn new(mut checked: Checked<'a>) -> Result<Self, Box<(Checked<'a>, ModelError)>> {
        let vehicle = checked.loaded.vehicle;
        let first = match first_fit(&mut checked) {
            Ok(first) => first,
            Err(why) => return Err(Box::new((checked, why))),
        };
        let measured: Vec<Vec<f64>> = checked.data.channels.iter().map(|c| c.values.clone()).collect();
        let left = declared_vibration::take_off(&mut checked.data, vehicle, &first.residual);
        let good = checked.data.channels.iter().map(|c| c.good.clone()).collect();
        let blocked = checked.is_blocked();
        if !blocked {
            let (wild, excluded) = outliers(&mut checked.data, &left, &checked.samples);
            if !(wild.is_empty() && excluded.is_empty()) {
                // Far samples had changed the amplitude and the phase of what was taken off.
                checked.data.channels.iter_mut().zip(measured).for_each(|(c, values)| c.values = values);
                declared_vibration::take_off(&mut checked.data, vehicle, &first.residual);
            }
            checked.samples.extend(wild);
            checked.found.extend(excluded.iter().map(|e| checks::excluded(e, &checked.data, vehicle)));
        }
        let present: Vec<usize> = checked.data.channels.iter().map(|c| c.output).collect();
        let declared = present.iter().map(|i| vehicle.outputs[*i].noise).collect();
        let declared = with_rounding(declared, &checked.samples);
        let sizes = sizes(&FreeRun::new(vehicle, &checked.data), &first, &declared);
        let options = checked.loaded.options;
        let mut candidates = Vec::new();
        if !blocked {
            candidates = library(vehicle, &sizes, &present);
            candidates.extend(transitions(vehicle, &sizes, &options.modes));
        }
        let free = free(vehicle, options);
        Ok(Self { checked, free, declared, sizes, library: candidates, good, blocked })
    }

    pub fn data(&self) -> &Data {
        &self.checked.data
    }

    pub fn vehicle(&self) -> &'a Vehicle {
        self.checked.loaded.vehicle
    }

    /// Inputs of the search.
    pub fn space(&self) -> SearchSpace<'_> {
        let (library, sizes, declared) = (&self.library, &self.sizes, &self.declared);
        let watch = &self.checked.loaded.options.watch;
        SearchSpace { library, sizes, most: MAX_CAUSES, declared, watch }
    }

    /// The vehicle without any cause over a free run of the data.
    pub fn model<'r>(&'r self, free_run: &'r FreeRun<'r>) -> Model<'r, 'r> {
        Model { free_run, free: &self.free, terms: Vec::new() }
    }

    /// Parameter values without any cause: states as of [`FreeRun::start`], free parameters as the vehicle has them.
    pub fn start(&self) -> Vec<f64> {
        let vehicle = self.vehicle();
        let values = self.free.iter().map(|f| vehicle.free_value(&f.target));
        FreeRun::new(vehicle, self.data()).start().into_iter().chain(values).collect()
    }
}

/// Fits the initial states of the given vehicle, and checks channels and inputs against its free run.
fn first_fit(checked: &mut Checked<'_>) -> Result<Fit, ModelError> {
    let free_run = FreeRun::new(checked.loaded.vehicle, &checked.data);
    let model = Model { free_run: &free_run, free: &[], terms: Vec::new() };
    let fit = model.fit(free_run.start(), None, None)?;
    // With wrong units, signs or sizes, other checks of the channels are meaningless.
    if checked.found.iter().any(|f| ["unit", "sign", "size"].contains(&f.kind.as_str())) {
        return Ok(fit);
    }
    let mut found = checks::channels(&free_run, &fit.predicted, &fit.residual);
    if !found.iter().any(|f| f.blocking) {
        found.extend(checks::inputs(&free_run, &fit.values, &fit.predicted, &fit.residual));
    }
    if !found.iter().any(|f| f.blocking) && !checked.is_blocked() {
        found.extend(checked.loaded.stranger.clone());
    }
    checked.found.extend(found);
    Ok(fit)
}

/// Free parameters that may be refitted.
fn free(vehicle: &Vehicle, options: &Options) -> Vec<Free> {
    let estimated = options.refit.unwrap_or(!vehicle.provenance.is_empty());
    if estimated { vehicle.free.clone() } else { Vec::new() }
}

fn sizes(free_run: &FreeRun<'_>, fit: &Fit, declared: &[f64]) -> Sizes {
    let data = free_run.data;
    let run = free_run.run_states(&free_run.vehicle, &fit.values);
    let states = run.unwrap_or_else(|_| vec![Vec::new(); free_run.states()]);
    let peak = |v: &[f64]| v.iter().fold(0.0f64, |m, x| m.max(x.abs()));
    let slope = |v: &Vec<f64>| {
        // The interval between two records contains no motion.
        let within = v.windows(2).enumerate().filter(|(k, _)| !data.starts.contains(&(k + 1)));
        rms(&within.map(|(_, w)| (w[1] - w[0]) / data.period_s).collect::<Vec<_>>())
    };
    let mut outputs = vec![0.0; free_run.vehicle.outputs.len()];
    let mut noise = vec![0.0; outputs.len()];
    for (c, channel) in data.channels.iter().enumerate() {
        let values: Vec<f64> = channel.values.iter().copied().filter(|v| v.is_finite()).collect();
        outputs[channel.output] = peak(&values);
        noise[channel.output] =
            if declared[c] > 0.0 { declared[c] } else { fit.profile.noise.channels[c].variance().sqrt() };
    }
    let range = |(low, high): (f64, f64), u: f64| (low.min(u), high.max(u));
    Sizes {
        inputs: free_run.input_peaks(),
        input_ranges: (0..data.m)
            .map(|j| data.input(j).fold((f64::INFINITY, f64::NEG_INFINITY), range))
            .collect(),
        input_rates: (0..data.m).map(|j| LIMITED_TIMES_S.map(|t| data.fastest(j, t)).to_vec()).collect(),
        states: states.iter().map(|s| peak(s)).collect(),
        slopes: states.iter().map(slope).collect(),
        outputs,
        noise,
        duration_s: data.duration_s(),
        times_s: data.times_s(),
        period_s: data.period_s,
    }
}

/// Standard deviations of the channels' noise, with rounding noise added.
fn with_rounding(mut expected: Vec<f64>, samples: &[SampleEffect]) -> Vec<f64> {
    for effect in samples.iter().filter(|e| e.kind == Kind::Quantization) {
        let step = effect.parameters.get("step").map_or(0.0, |v| v.0);
        // No noise is expected where none is declared.
        let own = &mut expected[effect.channel];
        *own = if *own > 0.0 { own.hypot(step / 12.0f64.sqrt()) } else { 0.0 };
    }
    expected
}
