//! A whole diagnosis: checks of the data, causes, the extended vehicle, and what is gained.

use std::collections::BTreeMap;

use whirlstand_logs::Record;
use whirlstand_vehicle::{Effect, Free, Kind, Vehicle};

use super::DiagnoseError;
use super::adequacy::{Lack, lack};
use super::answer::*;
use super::choice::chosen;
use super::data::{Data, coarser_period};
use super::doubt::withhold;
use super::forced::Follower;
use super::gains::output_error;
use super::library::{self, Candidate, Sizes};
use super::model::{Fit, Model};
use super::outliers::{outliers, still_wild};
use super::runner::Runner;
use super::samples::{SampleEffect, measured_effects};
use super::select::{MOST, Selection};
use super::shaking::{self, Shaking};
use super::stochastic::{ExcessNoise, Turbulence, excess_noise};
use super::survey::Scene;
use super::turbulent::beside;
use super::{checks, declared, gains, words};

/// What can be chosen.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Period, s; the record's own when `None`.
    pub period_s: Option<f64>,
    /// The vehicle's free parameters are estimates that may be refitted; `None`: they are when the vehicle file says
    /// that they were identified from a record.
    pub refit: Option<bool>,
    /// Vehicles whose flight mode the record may change to, beside the built-in ones.
    pub modes: Vec<String>,
    /// A record on the ground with the engine on.
    pub engine_on: Option<Record>,
    /// A record with the engine off.
    pub engine_off: Option<Record>,
}

/// Difference in BIC from which on it is plain that the first commands of a record were not there before.
const PLAIN: f64 = 30.0;

/// A push before this time is one at the beginning, s.
const BEGINNING_S: f64 = 0.1;

/// All that was found, before it is put into words.
pub(super) struct Findings<'r, 'd> {
    pub selection: Selection<'r, 'd>,
    pub sizes: Sizes,
    pub samples: Vec<SampleEffect>,
    pub turbulence: Option<Turbulence>,
    pub noise: Vec<(usize, ExcessNoise)>,
    /// Lines that wander, which no tone explains.
    pub shaking: Vec<Shaking>,
    /// What is left, against chance.
    pub lack: Option<Lack>,
    /// A force that would explain what is left, or as much as the causes that were taken back.
    pub like: Option<Follower>,
    /// Causes that were found and taken back, because what they leave is not noise.
    pub withheld: Vec<(Candidate, f64)>,
}

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
    let coarser = if options.period_s.is_none() { coarser_period(records) } else { None };
    let data = Data::join(records, vehicle, options.period_s.or(coarser))?;
    let mut found: Vec<DataFinding> = records.iter().flat_map(|r| checks::record(r, vehicle)).collect();
    found.extend(coarser.map(checks::thinned));
    let search = |data: Data| searched(records, vehicle, options, data, found.clone());
    if !data.begins_moving(vehicle) {
        return Ok(search(data)?.0);
    }
    // What came before the record nobody knows. A command that was there at first was there before, unless the causes
    // that are found so do plainly better without.
    let held = Data { held: true, ..data.clone() };
    match search(held)? {
        (_, gain) if gain > PLAIN => Ok(search(data)?.0),
        (answer, _) => Ok(answer),
    }
}

/// The answer for one pre-history, and what its causes would gain in BIC had the inputs been at rest before. `found` is
/// what the records themselves show.
fn searched(
    records: &[Record],
    vehicle: &Vehicle,
    options: &Options,
    mut data: Data,
    mut found: Vec<DataFinding>,
) -> Result<(Diagnosis, f64), DiagnoseError> {
    found.extend(checks::stuck(&mut data, vehicle));
    found.extend(checks::excitation(&data, vehicle));
    let mut samples = measured_effects(&mut data, vehicle);
    let free = free(vehicle, options);
    let states = vehicle.states.len() * data.starts.len();
    let start = || -> Vec<f64> {
        let values = free.iter().map(|f| vehicle.free_value(&f.target));
        std::iter::repeat_n(0.0, states).chain(values).collect()
    };
    let first = {
        let runner = Runner::new(vehicle, &data);
        let model = Model { runner: &runner, free: &[], terms: Vec::new() };
        let Some(fit) = model.fit(vec![0.0; states], None, None) else {
            return Ok((words::diverged(records, vehicle, &data, found), 0.0));
        };
        found.extend(checks::channels(&runner, &fit.predicted, &fit.residual));
        if !found.iter().any(|f| f.blocking) {
            found.extend(checks::inputs(&runner, &fit.values, &fit.predicted, &fit.residual));
        }
        fit
    };
    declared::take_off(&mut data, vehicle, &first.residual);
    let good: Vec<Vec<bool>> = data.channels.iter().map(|c| c.good.clone()).collect();
    if !found.iter().any(|f| f.blocking) {
        samples.extend(outliers(&mut data, &first.residual, &samples));
    }
    let runner = Runner::new(vehicle, &data);
    let blocked = found.iter().any(|f| f.blocking);
    let present: Vec<usize> = data.channels.iter().map(|c| c.output).collect();
    let declared: Vec<f64> = present.iter().map(|i| vehicle.outputs[*i].noise).collect();
    let declared = with_rounding(&declared, &samples);
    let sizes = sizes(&runner, &first, &declared);
    let mut candidates = if blocked { Vec::new() } else { library::library(vehicle, &sizes, &present) };
    if !blocked {
        candidates.extend(transitions(vehicle, &sizes, &options.modes));
    }
    let scene = Scene { library: &candidates, sizes: &sizes, most: MOST, declared: &declared };
    let model = Model { runner: &runner, free: &free, terms: Vec::new() };
    let selection = if blocked { Selection::nothing(model.clone(), start()) } else { chosen(&model, &scene) };
    let Some(mut selection) = selection else {
        return Ok((words::diverged(records, vehicle, &data, found), 0.0));
    };
    let exact = declared.iter().all(|d| *d > 0.0);
    let judged = |selection: &Selection<'_, '_>, turbulent: bool| {
        let noise = excess(&data, &selection.fit, &declared, turbulent);
        let asked = exact && !blocked && noise.is_empty();
        let rounded = samples.iter().filter(|e| e.kind == Kind::Quantization).map(|e| e.channel);
        let rounded: Vec<usize> = rounded.collect();
        let lack = if asked { lack(&selection.model, &selection.fit, &sizes, &rounded) } else { None };
        (noise, lack)
    };
    let (mut random, mut like) = (None, None);
    let alone = selection.clone();
    if !blocked {
        (selection, random, like) = beside(selection, &model, &scene);
    }
    let (mut noise, mut doubt) = judged(&selection, random.is_some());
    if random.is_some() && doubt.is_some_and(|lack| lack.is_certain()) {
        // It was the trace of something else, and what was chosen beside it rests on it.
        (selection, random) = (alone, None);
        (noise, doubt) = judged(&selection, false);
    }
    if let Some(by) = &like {
        doubt = doubt.map(|lack| lack.or_one(by.gain));
    }
    let gain = if data.held { otherwise(&selection, vehicle) } else { 0.0 };
    let mut withheld = Vec::new();
    if let Some(lack) = &mut doubt {
        withheld = withhold(&mut selection, (lack, &mut like), random.is_some(), start(), &scene);
    }
    still_wild(&mut samples, &data, good, &selection.fit.predicted);
    let shaking =
        if blocked { Vec::new() } else { shaking::shaking(&selection.model, &selection.fit.residual) };
    let like = like.filter(|_| doubt.is_some_and(|lack| lack.is_told()));
    let turbulence = random;
    let findings =
        Findings { selection, sizes, samples, turbulence, noise, shaking, lack: doubt, like, withheld };
    let extended = extended(vehicle, &findings);
    let gains = gains::gains(&findings, &data, vehicle);
    Ok((words::answer(records, vehicle, options, &data, found, findings, extended, gains), gain))
}

/// What the same causes gain in BIC when the inputs were at rest before. A push at the very beginning may stand for just
/// that: it is left out.
fn otherwise(selection: &Selection<'_, '_>, vehicle: &Vehicle) -> f64 {
    let own = selection.model.runner.data;
    let data = Data { held: false, ..own.clone() };
    let runner = Runner::new(vehicle, &data);
    let mut rest = selection.clone();
    let first = |c: &Candidate, values: &[f64]| {
        let at = c.tunables.iter().position(|t| t.name == "at_s");
        c.kind == Kind::PulseDisturbance && at.is_some_and(|i| values[i] < BEGINNING_S)
    };
    let terms = (0..selection.model.terms.len())
        .filter(|t| !first(&selection.model.terms[*t], &selection.fit.values[selection.model.range(*t)]));
    let names: Vec<String> = terms.map(|t| selection.model.terms[t].name()).collect();
    rest.keep(|c| names.contains(&c.name()));
    let model = Model { runner: &runner, free: selection.model.free, terms: rest.model.terms.clone() };
    let shared = selection.fit.profile.noise.shared();
    let other = model.fit(rest.fit.values, shared, None);
    let bic = |fit: &Fit, model: &Model<'_, '_>| fit.profile.bic(model.parameters());
    other.map_or(0.0, |other| bic(&selection.fit, &selection.model) - bic(&other, &model))
}

/// Which free parameters are estimates.
fn free(vehicle: &Vehicle, options: &Options) -> Vec<Free> {
    let estimated = options.refit.unwrap_or(!vehicle.provenance.is_empty());
    if estimated { vehicle.free.clone() } else { Vec::new() }
}

fn sizes(runner: &Runner<'_>, fit: &Fit, declared: &[f64]) -> Sizes {
    let data = runner.data;
    let n = runner.states();
    let states = runner.run_states(&fit.values).unwrap_or_else(|| vec![Vec::new(); n]);
    let peak = |v: &[f64]| v.iter().fold(0.0f64, |m, x| m.max(x.abs()));
    let slope = |v: &Vec<f64>| {
        crate::stats::rms(&v.windows(2).map(|w| (w[1] - w[0]) / data.period_s).collect::<Vec<_>>())
    };
    let mut outputs = vec![0.0; runner.vehicle.outputs.len()];
    let mut noise = vec![0.0; outputs.len()];
    for (c, channel) in data.channels.iter().enumerate() {
        let values: Vec<f64> = channel.values.iter().copied().filter(|v| v.is_finite()).collect();
        outputs[channel.output] = peak(&values);
        noise[channel.output] =
            if declared[c] > 0.0 { declared[c] } else { fit.profile.noise.channels[c].variance.sqrt() };
    }
    Sizes {
        inputs: runner.input_peaks(),
        states: states.iter().map(|s| peak(s)).collect(),
        slopes: states.iter().map(slope).collect(),
        outputs,
        noise,
        duration_s: data.duration_s(),
        period_s: data.period_s,
    }
}

/// Times at which a transition is tried.
const TRANSITIONS: usize = 24;

fn transitions(vehicle: &Vehicle, sizes: &Sizes, modes: &[String]) -> Vec<Candidate> {
    let builtin = whirlstand_vehicle::builtin_names().map(String::from);
    let others = builtin.chain(modes.iter().cloned()).filter(|name| *name != vehicle.name);
    let times =
        || (0..TRANSITIONS).map(|i| i as f64 / TRANSITIONS as f64 * sizes.duration_s).collect::<Vec<_>>();
    others
        .filter(|to| {
            let effect = Effect::mode_transition(0.0, to);
            effect.is_ok_and(|e| vehicle.clone().add_effect(e).is_ok())
        })
        .map(|to| library::transition(&to, times(), sizes, TRANSITIONS as f64))
        .collect()
}

/// Standard deviations of the channels' noise with what rounding adds to it.
fn with_rounding(declared: &[f64], samples: &[SampleEffect]) -> Vec<f64> {
    let mut expected = declared.to_vec();
    for effect in samples.iter().filter(|e| e.kind == Kind::Quantization) {
        let step = effect.parameters.get("step").map_or(0.0, |v| v.0);
        // Nothing is expected where nothing is declared.
        let own = &mut expected[effect.channel];
        *own = if *own > 0.0 { own.hypot(step / 12.0f64.sqrt()) } else { 0.0 };
    }
    expected
}

/// Noise beyond the declared; coloured noise that turbulence accounts for is none.
fn excess(data: &Data, fit: &Fit, declared: &[f64], turbulent: bool) -> Vec<(usize, ExcessNoise)> {
    if turbulent {
        return Vec::new();
    }
    let channels = fit.profile.noise.channels.iter().zip(declared).enumerate();
    channels
        .filter_map(|(c, (ar, declared))| Some((c, excess_noise(data, &fit.residual, ar, c, *declared)?)))
        .collect()
}

/// The vehicle with everything that was found.
fn extended(vehicle: &Vehicle, findings: &Findings<'_, '_>) -> Option<Vehicle> {
    let selection = &findings.selection;
    let mut extended = vehicle.clone();
    let refitted =
        if selection.model.free.is_empty() { None } else { output_error(&selection.model, &selection.fit) };
    let values = refitted.as_ref().map_or(&selection.fit.values, |f| &f.values);
    for (free, value) in selection.model.free.iter().zip(&values[selection.model.states()..]) {
        extended.set_free(&free.target, *value).ok()?;
    }
    let mut any = false;
    let mut add = |effect: Effect| any |= extended.add_effect(effect).is_ok();
    selection.model.effects(values)?.into_iter().for_each(&mut add);
    for effect in &findings.samples {
        let place = &vehicle.outputs[selection.model.runner.data.channels[effect.channel].output].name;
        let parameters: Vec<(&str, f64)> = effect.parameters.iter().map(|(n, v)| (*n, v.0)).collect();
        if let Ok(effect) = Effect::new(effect.kind, place, &parameters) {
            add(effect);
        }
    }
    if let Some(t) = &findings.turbulence {
        let place = &vehicle.states[t.state].name;
        if let Ok(e) =
            Effect::new(Kind::Turbulence, place, &[("std", t.std.0), ("bandwidth_hz", t.bandwidth_hz.0)])
        {
            add(e);
        }
    }
    for (channel, noise) in &findings.noise {
        let place = &vehicle.outputs[selection.model.runner.data.channels[*channel].output].name;
        if let Ok(e) = Effect::new(Kind::Noise, place, &[("std", noise.std.0)]) {
            add(e);
        }
    }
    for found in &findings.shaking {
        shaking::declare(&mut extended, selection.model.runner.data, found);
    }
    (any || !findings.shaking.is_empty()).then_some(extended)
}

/// Names and 95 % intervals of a term's values.
pub(super) fn estimates(selection: &Selection<'_, '_>, term: usize) -> BTreeMap<String, Estimate> {
    let range = selection.model.range(term);
    let covariance = selection.model.covariance(&selection.fit);
    let candidate = &selection.model.terms[term];
    let mut estimates: BTreeMap<String, Estimate> = candidate
        .tunables
        .iter()
        .zip(range)
        .map(|(t, i)| {
            let value = selection.fit.values[i];
            let mut half = covariance.as_ref().map_or(0.0, |c| 1.96 * c[(i, i)].max(0.0).sqrt());
            if matches!(t.name, "at_s" | "duration_s") {
                // Within a period nothing tells times apart.
                half = half.max(selection.model.runner.data.period_s);
            }
            let (mut low, mut high) = ((value - half).max(t.lower), (value + half).min(t.upper));
            let mut value = value;
            if t.name == "phase_rad" {
                let turns = (value / std::f64::consts::TAU).round() * std::f64::consts::TAU;
                (value, low, high) = (value - turns, low - turns, high - turns);
            }
            (t.name.to_string(), Estimate { value, low, high })
        })
        .collect();
    for (name, value) in &candidate.fixed {
        estimates.insert((*name).into(), Estimate { value: *value, low: *value, high: *value });
    }
    estimates
}
