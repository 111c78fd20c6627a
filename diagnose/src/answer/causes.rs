//! Builds the list of causes in the answer: terms that the search accepted, effects on single samples, and
//! random causes.

use std::collections::BTreeMap;

use whirlstand_vehicle::{Effect, Kind, Vehicle};

use super::schema::*;
use super::{experiments, vibration_source};
use crate::data::sample_effect::SampleEffect;
use crate::model::columns::dot;
use crate::residual::excess_noise::ExcessNoise;
use crate::residual::narrow_band::{self, NarrowBand};
use crate::residual::turbulence::Turbulence;
use crate::search::selection::Accepted;
use crate::stages::findings::{Findings, estimates};
use crate::thresholds::{RIDER_SHARE, RIVAL_BIC};

/// Note of every random cause: it has no realisation that a simulation could reproduce.
const RANDOM: &str = "the simulation can match the flight statistically, but not sample by sample";

/// All causes, those of the largest gain first, and last the rounding of a log where it is next to nothing: every sample
/// proves it, but it explains no motion.
pub(crate) fn causes(findings: &Findings<'_>) -> Vec<Cause> {
    let residual = &findings.residual;
    let accepted = residual.selection.accepted.iter().enumerate();
    let mut all: Vec<Cause> =
        accepted.map(|(term, accepted)| accepted_cause(findings, term, accepted)).collect();
    all.extend(residual.samples.iter().map(|effect| sample_cause(findings, effect)));
    all.extend(residual.turbulence.iter().map(|t| turbulence_cause(findings, t)));
    all.extend(residual.narrow_band.iter().map(|line| narrow_band_cause(findings, line)));
    all.extend(residual.noise.iter().map(|(channel, noise)| noise_cause(findings, *channel, noise)));
    let is_fine = |cause: &Cause| {
        cause.effect == Kind::Quantization.name() && cause.evidence.share_of_residual < RIDER_SHARE
    };
    all.sort_by(|a, b| {
        is_fine(a).cmp(&is_fine(b)).then(b.evidence.delta_bic.total_cmp(&a.evidence.delta_bic))
    });
    all.iter_mut().for_each(|cause| fill_units(cause, findings.baseline.vehicle()));
    all
}

/// Sets the SI unit of every parameter of a cause, which depends on the place of the cause.
fn fill_units(cause: &mut Cause, vehicle: &Vehicle) {
    let unit = |effect: &str, place: &str, name: &str| {
        let kind = Kind::from_name(effect).ok()?;
        Some(Effect::unit_at(kind, place, name, vehicle)?.in_words())
    };
    for (name, estimate) in &mut cause.parameters {
        estimate.unit = unit(&cause.effect, &cause.place, name).unwrap_or_default();
    }
    for alike in &mut cause.indistinguishable {
        let units = alike.parameters.keys().map(|name| {
            let unit = unit(&alike.effect, &alike.place, name).unwrap_or_default();
            (name.clone(), unit.into())
        });
        alike.units = units.collect();
    }
}

/// Name of the vehicle output that a measured channel records.
fn output_name(findings: &Findings<'_>, channel: usize) -> String {
    findings.baseline.vehicle().outputs[findings.baseline.data().channels[channel].output].name.clone()
}

/// The cause in the answer for one accepted term of the search, with its rivals.
fn accepted_cause(findings: &Findings<'_>, term: usize, accepted: &Accepted) -> Cause {
    let candidate = &findings.residual.selection.model.terms[term];
    let look_alike = |rival: &crate::search::acceptance::Rival| {
        let parameters = rival.candidate.tunables.iter().zip(&rival.values);
        LookAlike {
            effect: rival.candidate.kind.name().into(),
            place: rival.candidate.place.clone(),
            kappa: rival.kappa,
            parameters: parameters.map(|(t, v)| (t.name.to_string(), *v)).collect(),
            units: BTreeMap::new(),
            experiment: experiments::separating(candidate.kind, rival.candidate.kind).into(),
        }
    };
    let mut cause = Cause {
        effect: candidate.kind.name().into(),
        place: candidate.place.clone(),
        parameters: estimates(&findings.residual, term),
        text: candidate.text.clone(),
        evidence: Evidence {
            delta_bic: accepted.evidence.delta_bic,
            heldout_gain_sigma: accepted.evidence.heldout,
            share_of_residual: share(findings, term),
            p_value: accepted.evidence.p_value,
            detectability: accepted.evidence.detectability,
        },
        indistinguishable: accepted.rivals.iter().filter(|r| r.indistinguishable()).map(look_alike).collect(),
        notes: Vec::new(),
    };
    if candidate.kind == Kind::Vibration {
        tone_notes(findings, &mut cause);
    }
    cause
}

fn turbulence_cause(findings: &Findings<'_>, found: &Turbulence) -> Cause {
    let states = &findings.baseline.vehicle().states;
    let around = |(value, error): (f64, f64)| {
        Estimate::new(value, value * (-1.96 * error).exp(), value * (1.96 * error).exp())
    };
    let near = found.others.iter().filter(|(_, bic)| found.delta_bic - bic < RIVAL_BIC);
    let look_alike = |state: usize| LookAlike {
        effect: Kind::Turbulence.name().into(),
        place: states[state].name.clone(),
        kappa: 1.0,
        parameters: BTreeMap::new(),
        units: BTreeMap::new(),
        experiment: experiments::separating(Kind::Turbulence, Kind::Turbulence).into(),
    };
    Cause {
        effect: Kind::Turbulence.name().into(),
        place: states[found.state].name.clone(),
        parameters: BTreeMap::from([
            ("std".to_string(), around(found.std)),
            ("bandwidth_hz".to_string(), around(found.bandwidth_hz)),
        ]),
        text: None,
        evidence: Evidence {
            delta_bic: found.delta_bic,
            heldout_gain_sigma: 0.0,
            share_of_residual: 0.0,
            p_value: 0.0,
            detectability: 2.0 * found.delta_bic,
        },
        indistinguishable: near.map(|(state, _)| look_alike(*state)).collect(),
        notes: vec![format!("random: {RANDOM}")],
    }
}

fn noise_cause(findings: &Findings<'_>, channel: usize, noise: &ExcessNoise) -> Cause {
    let samples = findings.baseline.data().channels[channel].values.len() as f64;
    let (value, low, high) = noise.std;
    let power = noise.times * noise.times;
    Cause {
        effect: Kind::Noise.name().into(),
        place: output_name(findings, channel),
        parameters: BTreeMap::from([("std".to_string(), Estimate::new(value, low, high))]),
        text: None,
        evidence: Evidence {
            delta_bic: samples * (power - 1.0 - power.ln()),
            heldout_gain_sigma: 0.0,
            share_of_residual: 1.0 - 1.0 / power,
            p_value: 0.0,
            detectability: samples,
        },
        indistinguishable: Vec::new(),
        notes: vec![format!("total noise is {:.1} times what the vehicle file declares", noise.times)],
    }
}

fn narrow_band_cause(findings: &Findings<'_>, found: &NarrowBand) -> Cause {
    let around = |(value, half): (f64, f64)| Estimate::new(value, value - half, value + half);
    let samples = findings.baseline.data().channels[found.channel].values.len() as f64;
    let mut cause = Cause {
        effect: Kind::Vibration.name().into(),
        place: output_name(findings, found.channel),
        parameters: BTreeMap::from([
            ("frequency_hz".to_string(), around(found.frequency_hz)),
            ("amplitude".to_string(), around(found.amplitude)),
        ]),
        text: None,
        evidence: Evidence {
            delta_bic: found.gain - 2.0 * samples.ln(),
            heldout_gain_sigma: 0.0,
            share_of_residual: found.share,
            p_value: 0.0,
            detectability: found.gain,
        },
        indistinguishable: Vec::new(),
        notes: vec![format!("its frequency varies: {RANDOM}")],
    };
    tone_notes(findings, &mut cause);
    let others = findings.residual.narrow_band.iter();
    let others = others.filter(|s| s.channel != found.channel && narrow_band::same(s, found));
    let others: Vec<String> = others.map(|s| output_name(findings, s.channel)).collect();
    if !others.is_empty() {
        cause.notes.push(format!("the same line appears in {}", others.join(", ")));
    }
    cause
}

/// Notes on a tone: its aliases, and its source where records on the ground show it.
fn tone_notes(findings: &Findings<'_>, cause: &mut Cause) {
    let (data, vehicle) = (findings.baseline.data(), findings.baseline.vehicle());
    let options = findings.baseline.checked.loaded.options;
    let value = |name: &str| cause.parameters.get(name).map_or(0.0, |p| p.value);
    let (f, amplitude) = (value("frequency_hz"), value("amplitude"));
    let channel = data.channels.iter().find(|c| vehicle.outputs[c.output].name == cause.place);
    let period_s = data.period_s * channel.map_or(1, |c| c.stride) as f64;
    let aliases = vibration_source::aliases(f, period_s);
    let list: Vec<String> = aliases.iter().map(|a| format!("{a:.2} Hz")).collect();
    cause.notes.push(format!("possible aliases at this sampling rate: {}", list.join(", ")));
    let (on, off) = (options.engine_on.as_ref(), options.engine_off.as_ref());
    if let Some((source, why)) = vibration_source::source(&cause.place, f, amplitude, on, off) {
        cause.text = Some(source.into());
        cause.notes.push(format!("source: {source} ({why})"));
    }
}

fn sample_cause(findings: &Findings<'_>, effect: &SampleEffect) -> Cause {
    let n = findings.baseline.data().channels[effect.channel].values.len() as f64;
    let estimate = |v: &(f64, f64, f64)| Estimate::new(v.0, v.1, v.2);
    Cause {
        effect: effect.kind.name().into(),
        place: output_name(findings, effect.channel),
        parameters: effect.parameters.iter().map(|(name, v)| ((*name).to_string(), estimate(v))).collect(),
        text: None,
        evidence: Evidence {
            // Every such sample would be a coincidence of continuous values without the effect.
            delta_bic: effect.samples as f64 * n.ln(),
            heldout_gain_sigma: (effect.samples as f64).sqrt(),
            share_of_residual: rounding(findings, effect).unwrap_or(effect.samples as f64 / n),
            p_value: 0.0,
            detectability: effect.samples as f64 * n.ln(),
        },
        indistinguishable: Vec::new(),
        notes: vec![format!("{} of {} samples", effect.samples, n)],
    }
}

/// Share of rounding in the residual's power: a twelfth of the squared step in each sample (Bennett 1948); `None` for other
/// effects on samples, which are left out of the residual.
fn rounding(findings: &Findings<'_>, effect: &SampleEffect) -> Option<f64> {
    let (step, ..) = *effect.parameters.get("step").filter(|_| effect.kind == Kind::Quantization)?;
    let rounded = findings.baseline.data().channels[effect.channel].values.len() as f64 * step * step / 12.0;
    let output = findings.baseline.data().channels[effect.channel].output;
    let noise = findings.baseline.sizes.noise[output].max(f64::MIN_POSITIVE);
    let all = scaled_power(findings, &findings.residual.selection.fit.predicted);
    Some(if all > 0.0 { (rounded / (noise * noise) / all).min(1.0) } else { 1.0 })
}

/// Power of what predictions leave, each channel in units of its noise.
fn scaled_power(findings: &Findings<'_>, predicted: &[f64]) -> f64 {
    let data = findings.baseline.data();
    let residual = data.residual(predicted);
    let ranges = data.ranges().into_iter().enumerate();
    ranges
        .map(|(c, range)| {
            let noise = findings.baseline.sizes.noise[data.channels[c].output].max(f64::MIN_POSITIVE);
            dot(&residual[range.clone()], &residual[range]) / (noise * noise)
        })
        .sum()
}

/// Reduction of the residual's power beyond the noise when a term is added to all others, as a share.
fn share(findings: &Findings<'_>, term: usize) -> f64 {
    let selection = &findings.residual.selection;
    let model = &selection.model;
    let mut others = model.clone();
    others.terms.remove(term);
    let mut values = selection.fit.values.clone();
    values.drain(model.range(term));
    let Ok(without) = others.predict(&values) else { return 0.0 };
    let (before, after) =
        (scaled_power(findings, &without), scaled_power(findings, &selection.fit.predicted));
    if before > 0.0 { (1.0 - after / before).clamp(0.0, 1.0) } else { 0.0 }
}
