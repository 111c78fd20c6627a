//! The answer: findings put into figures and sentences.

use std::collections::BTreeMap;

use whirlstand_logs::Record;
use whirlstand_vehicle::{Kind, Vehicle};

use super::answer::*;
use super::data::Data;
use super::gains::Gains;
use super::model::dot;
use super::run::{Findings, Options, estimates};
use super::samples::SampleEffect;
use super::shaking::{self, Shaking};
use super::{describe, engine, evidence, experiments};

/// Causes that leave less than this share of what was wrong explain it.
const EXPLAINED: f64 = 0.1;
/// Rejected effects that are told.
const TOLD: usize = 12;

fn frame(records: &[Record], vehicle: &Vehicle, data: &Data, found: Vec<DataFinding>) -> Diagnosis {
    Diagnosis {
        schema: DIAGNOSIS_SCHEMA.into(),
        verdict: Verdict::Inconclusive,
        summary: String::new(),
        version: env!("CARGO_PKG_VERSION").into(),
        records: records.iter().map(|r| r.origin.clone()).collect(),
        vehicle: vehicle.name.clone(),
        period_s: data.period_s,
        causes: Vec::new(),
        rejected: Vec::new(),
        not_testable: Vec::new(),
        outputs: BTreeMap::new(),
        heldout: HeldOut::default(),
        unexplained: Unexplained::default(),
        data: found,
        remarks: Vec::new(),
        advice: Vec::new(),
        extended_vehicle: None,
        extended: None,
        figures: Figures::default(),
    }
}

/// The answer when the vehicle's free run leaves all bounds.
pub fn diverged(records: &[Record], vehicle: &Vehicle, data: &Data, found: Vec<DataFinding>) -> Diagnosis {
    let mut answer = frame(records, vehicle, data, found);
    answer.summary =
        format!("Inconclusive: the free run of {} over this record leaves all bounds.", vehicle.name);
    answer.advice.push(format!(
        "Check the units of the inputs and the vehicle file (whirlstand compare shows both), or identify the vehicle from this record first: whirlstand identify {} --vehicle {}.",
        data.origin, vehicle.name
    ));
    answer
}

/// The answer.
#[expect(clippy::too_many_arguments, reason = "all that a diagnosis has found comes together here, once")]
pub(super) fn answer(
    records: &[Record],
    vehicle: &Vehicle,
    options: &Options,
    data: &Data,
    found: Vec<DataFinding>,
    findings: Findings<'_, '_>,
    extended: Option<Vehicle>,
    gains: Gains,
) -> Diagnosis {
    let mut answer = frame(records, vehicle, data, found);
    let selection = &findings.selection;
    answer.heldout = gains.heldout;
    for (channel, gain) in data.channels.iter().zip(&gains.channels) {
        let output = &vehicle.outputs[channel.output];
        let figures = OutputGain {
            unit: output.unit.si_symbol(),
            fit_before: gain.fit_before,
            fit_after: gain.fit_after,
            rmse_before: gain.rmse_before,
            rmse_after: gain.rmse_after,
            noise_floor: gain.floor,
        };
        answer.outputs.insert(output.name.clone(), figures);
    }
    causes(&mut answer, &findings, data, vehicle, options);
    for (trial, why) in selection.refused.iter().filter(|(t, _)| t.fit.is_some()).take(TOLD) {
        answer.rejected.push(Rejected {
            effect: trial.candidate.kind.name().into(),
            place: trial.candidate.place.clone(),
            delta_bic: trial.delta_bic,
            why: why.clone(),
        });
    }
    for (candidate, delta_bic) in &findings.withheld {
        answer.rejected.push(Rejected {
            effect: candidate.kind.name().into(),
            place: candidate.place.clone(),
            delta_bic: *delta_bic,
            why: "it explains much, but what it leaves is not noise: the cause is like it, not it".into(),
        });
    }
    for accepted in &selection.accepted {
        for rival in accepted.rivals.iter().filter(|r| !r.indistinguishable()) {
            let (effect, place) = (rival.candidate.kind.name(), &rival.candidate.place);
            let known = |e: &str, p: &str| e == effect && p == place;
            if answer.rejected.iter().any(|r| known(&r.effect, &r.place))
                || answer.causes.iter().any(|c| known(&c.effect, &c.place))
            {
                continue;
            }
            answer.rejected.push(Rejected {
                effect: effect.into(),
                place: place.clone(),
                delta_bic: -rival.gap,
                why: format!(
                    "in place of the accepted cause it would lose {:.0} in BIC (signatures alike to {:.2})",
                    rival.gap, rival.kappa
                ),
            });
        }
    }
    answer.rejected.sort_by(|a, b| b.delta_bic.total_cmp(&a.delta_bic));
    answer.rejected.truncate(TOLD);
    answer.not_testable = experiments::not_testable(&findings, data, vehicle);
    answer.unexplained = describe::unexplained(&findings, data, vehicle);
    answer.verdict = verdict(&answer, &findings, data, vehicle);
    answer.advice = experiments::advice(&answer);
    answer.summary = summary(&answer);
    answer.figures = evidence::figures(&findings, data, vehicle, &gains, &answer);
    answer.extended = extended.filter(|_| !answer.causes.is_empty()).map(Box::new);
    answer
}

fn causes(
    answer: &mut Diagnosis,
    findings: &Findings<'_, '_>,
    data: &Data,
    vehicle: &Vehicle,
    options: &Options,
) {
    let selection = &findings.selection;
    for (term, (candidate, accepted)) in selection.model.terms.iter().zip(&selection.accepted).enumerate() {
        let mut cause = Cause {
            effect: candidate.kind.name().into(),
            place: candidate.place.clone(),
            parameters: estimates(selection, term),
            text: candidate.text.clone(),
            evidence: Evidence {
                delta_bic: accepted.weight.delta_bic,
                heldout_gain_sigma: accepted.weight.heldout,
                share_of_residual: share(findings, data, term),
                p_value: accepted.weight.p_value,
                detectability: accepted.weight.detectability,
            },
            indistinguishable: Vec::new(),
            notes: Vec::new(),
        };
        for rival in accepted.rivals.iter().filter(|r| r.indistinguishable()) {
            let parameters = rival.candidate.tunables.iter().zip(&rival.values);
            cause.indistinguishable.push(LookAlike {
                effect: rival.candidate.kind.name().into(),
                place: rival.candidate.place.clone(),
                kappa: rival.kappa,
                parameters: parameters.map(|(t, v)| (t.name.to_string(), *v)).collect(),
                experiment: experiments::separating(candidate.kind, rival.candidate.kind).into(),
            });
        }
        if candidate.kind == Kind::Vibration {
            tone_notes(&mut cause, data, vehicle, options);
        }
        answer.causes.push(cause);
    }
    for effect in &findings.samples {
        answer.causes.push(sample_cause(effect, data, vehicle));
    }
    if let Some(t) = &findings.turbulence {
        let around = |(value, error): (f64, f64)| Estimate {
            value,
            low: value * (-1.96 * error).exp(),
            high: value * (1.96 * error).exp(),
        };
        let parameters = BTreeMap::from([
            ("std".to_string(), around(t.std)),
            ("bandwidth_hz".to_string(), around(t.bandwidth_hz)),
        ]);
        let near = t.others.iter().filter(|(_, bic)| t.delta_bic - bic < 6.0);
        answer.causes.push(Cause {
            effect: Kind::Turbulence.name().into(),
            place: vehicle.states[t.state].name.clone(),
            parameters,
            text: None,
            evidence: Evidence {
                delta_bic: t.delta_bic,
                heldout_gain_sigma: 0.0,
                share_of_residual: 0.0,
                p_value: 0.0,
                detectability: 2.0 * t.delta_bic,
            },
            indistinguishable: near
                .map(|(state, _)| LookAlike {
                    effect: Kind::Turbulence.name().into(),
                    place: vehicle.states[*state].name.clone(),
                    kappa: 1.0,
                    parameters: BTreeMap::new(),
                    experiment: experiments::separating(Kind::Turbulence, Kind::Turbulence).into(),
                })
                .collect(),
            notes: vec!["random: the simulation can be like the flight in kind, not follow it".into()],
        });
    }
    answer.causes.extend(findings.shaking.iter().map(|s| shaking_cause(s, findings, data, vehicle, options)));
    for (channel, noise) in &findings.noise {
        let (value, low, high) = noise.std;
        answer.causes.push(Cause {
            effect: Kind::Noise.name().into(),
            place: vehicle.outputs[data.channels[*channel].output].name.clone(),
            parameters: BTreeMap::from([("std".to_string(), Estimate { value, low, high })]),
            text: None,
            evidence: Evidence {
                delta_bic: data.channels[*channel].values.len() as f64
                    * (noise.times * noise.times - 1.0 - 2.0 * noise.times.ln()),
                heldout_gain_sigma: 0.0,
                share_of_residual: 1.0 - 1.0 / (noise.times * noise.times),
                p_value: 0.0,
                detectability: data.channels[*channel].values.len() as f64,
            },
            indistinguishable: Vec::new(),
            notes: vec![format!("in all {:.1} times what the vehicle file declares", noise.times)],
        });
    }
    answer.causes.sort_by(|a, b| b.evidence.delta_bic.total_cmp(&a.evidence.delta_bic));
}

fn shaking_cause(
    found: &Shaking,
    findings: &Findings<'_, '_>,
    data: &Data,
    vehicle: &Vehicle,
    options: &Options,
) -> Cause {
    let name = |s: &Shaking| vehicle.outputs[data.channels[s.channel].output].name.clone();
    let around = |(value, half): (f64, f64)| Estimate { value, low: value - half, high: value + half };
    let mut cause = Cause {
        effect: Kind::Vibration.name().into(),
        place: name(found),
        parameters: BTreeMap::from([
            ("frequency_hz".to_string(), around(found.frequency_hz)),
            ("amplitude".to_string(), around(found.amplitude)),
        ]),
        text: None,
        evidence: Evidence {
            delta_bic: found.gain - 2.0 * (data.channels[found.channel].values.len() as f64).ln(),
            heldout_gain_sigma: 0.0,
            share_of_residual: found.share,
            p_value: 0.0,
            detectability: found.gain,
        },
        indistinguishable: Vec::new(),
        notes: vec![
            "its frequency wanders: the simulation can be like the flight in kind, not follow it".into(),
        ],
    };
    tone_notes(&mut cause, data, vehicle, options);
    let others = findings.shaking.iter().filter(|s| s.channel != found.channel && shaking::same(s, found));
    let others: Vec<String> = others.map(name).collect();
    if !others.is_empty() {
        cause.notes.push(format!("the same line is on {}", others.join(", ")));
    }
    cause
        .notes
        .push("its frequency wanders: the simulation can be like the flight in kind, not follow it".into());
    tone_notes(&mut cause, data, vehicle, options);
    cause
}

fn tone_notes(cause: &mut Cause, data: &Data, vehicle: &Vehicle, options: &Options) {
    let value = |name: &str| cause.parameters.get(name).map_or(0.0, |p| p.value);
    let (f, amplitude) = (value("frequency_hz"), value("amplitude"));
    let channel =
        data.channels.iter().find(|c| vehicle.outputs[c.output].name == cause.place).map_or(1, |c| c.stride);
    let aliases = engine::aliases(f, data.period_s * channel as f64);
    let list: Vec<String> = aliases.iter().map(|a| format!("{a:.2} Hz")).collect();
    cause.notes.push(format!("at this rate it may as well be {}", list.join(", ")));
    let (on, off) = (options.engine_on.as_ref(), options.engine_off.as_ref());
    if let Some((source, why)) = engine::source(&cause.place, f, amplitude, on, off) {
        cause.text = Some(source.into());
        cause.notes.push(format!("source: {source} ({why})"));
    }
}

fn sample_cause(effect: &SampleEffect, data: &Data, vehicle: &Vehicle) -> Cause {
    let n = data.channels[effect.channel].values.len() as f64;
    let estimate = |v: &(f64, f64, f64)| Estimate { value: v.0, low: v.1, high: v.2 };
    Cause {
        effect: effect.kind.name().into(),
        place: vehicle.outputs[data.channels[effect.channel].output].name.clone(),
        parameters: effect.parameters.iter().map(|(name, v)| ((*name).to_string(), estimate(v))).collect(),
        text: None,
        evidence: Evidence {
            // Every such sample would be a coincidence of continuous values without the effect.
            delta_bic: effect.samples as f64 * n.ln(),
            heldout_gain_sigma: (effect.samples as f64).sqrt(),
            share_of_residual: effect.samples as f64 / n,
            p_value: 0.0,
            detectability: effect.samples as f64 * n.ln(),
        },
        indistinguishable: Vec::new(),
        notes: vec![format!("{} of {} samples", effect.samples, n)],
    }
}

/// Share of the residual's power, over the noise, that goes when a term is added to the others.
fn share(findings: &Findings<'_, '_>, data: &Data, term: usize) -> f64 {
    let selection = &findings.selection;
    let model = &selection.model;
    let mut others = model.clone();
    others.terms.remove(term);
    let mut values = selection.fit.values.clone();
    values.drain(model.range(term));
    let Some(without) = others.predict(&values) else { return 0.0 };
    let scaled = |predicted: &[f64]| -> f64 {
        let mut residual: Vec<f64> = data.measured().iter().zip(predicted).map(|(y, p)| y - p).collect();
        data.fill(&mut residual);
        let ranges = data.ranges().into_iter().enumerate();
        ranges
            .map(|(c, range)| {
                let output = data.channels[c].output;
                let noise = findings.sizes.noise[output].max(f64::MIN_POSITIVE);
                dot(&residual[range.clone()], &residual[range]) / (noise * noise)
            })
            .sum()
    };
    let (before, after) = (scaled(&without), scaled(&selection.fit.predicted));
    if before > 0.0 { (1.0 - after / before).clamp(0.0, 1.0) } else { 0.0 }
}

fn verdict(answer: &Diagnosis, findings: &Findings<'_, '_>, data: &Data, vehicle: &Vehicle) -> Verdict {
    if answer.data.iter().any(|f| f.blocking) && answer.causes.is_empty() {
        return Verdict::Inconclusive;
    }
    let left = answer.unexplained.share;
    if !answer.causes.is_empty() {
        return if left < EXPLAINED { Verdict::Explained } else { Verdict::PartlyExplained };
    }
    let residual = &findings.selection.fit.residual;
    let noise = &findings.selection.fit.profile.noise;
    let loud = (0..data.channels.len()).any(|c| {
        let output = data.channels[c].output;
        vehicle.outputs[output].noise > 0.0
            && noise.std(c, data, residual) > 2.0 * findings.sizes.noise[output]
    });
    let more = findings.lack.as_ref().is_some_and(super::adequacy::Lack::is_told);
    if loud || more || describe::structured(findings, data) {
        Verdict::Unexplained
    } else if answer.data.iter().any(|f| f.kind == "no_excitation" && f.blocking) {
        Verdict::Inconclusive
    } else {
        Verdict::Consistent
    }
}

fn summary(answer: &Diagnosis) -> String {
    let cause = |c: &Cause| {
        let mut parameters: Vec<String> = Vec::new();
        for (name, p) in c.parameters.iter().filter(|(n, _)| *n != "phase_rad") {
            parameters.push(format!("{name} {} ({} to {})", short(p.value), short(p.low), short(p.high)));
        }
        let alike = match c.indistinguishable.first() {
            Some(l) => format!(", or {} on {}", l.effect, l.place),
            None => String::new(),
        };
        format!("{} on {}{alike}: {}", c.effect, c.place, parameters.join(", "))
    };
    let list: Vec<String> = answer.causes.iter().map(cause).collect();
    let blocking: Vec<&str> = answer.data.iter().filter(|f| f.blocking).map(|f| f.text.as_str()).collect();
    let left = 100.0 * answer.unexplained.share;
    match answer.verdict {
        Verdict::Consistent => {
            format!(
                "Consistent: no effect passed; the record is what {} does, within its noise.",
                answer.vehicle
            )
        }
        Verdict::Explained => format!("Explained by {}.", list.join("; and ")),
        Verdict::PartlyExplained => {
            format!("Partly explained by {}; {left:.0} % of what was wrong remains.", list.join("; and "))
        }
        Verdict::Unexplained => {
            format!("Unexplained: no effect of the table is it. {}", answer.unexplained.description)
        }
        Verdict::Inconclusive if !blocking.is_empty() => format!("Inconclusive: {}.", blocking.join("; ")),
        Verdict::Inconclusive => "Inconclusive: this record could not have shown an effect.".into(),
    }
}

/// Four digits at most.
pub(super) fn short(v: f64) -> String {
    crate::units::number((v * 1e9).round() / 1e9)
}
