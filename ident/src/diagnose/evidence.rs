//! The signals of a diagnosis for the report: runs before and after, and what shows each cause.

use rayon::prelude::*;
use whirlstand_vehicle::{Kind, Vehicle};

use super::answer::{Diagnosis, EvidenceCurve, Figures, OutputFigure};
use super::data::{Channel, Data};
use super::evidence_random as random;
use super::gains::Gains;
use super::library::Candidate;
use super::model::Model;
use super::run::Findings;
use super::select::Selection;
use super::shows::{Shown, shows};

/// Rejected candidates that are shown beside the accepted ones.
const REJECTED: usize = 2;

pub(super) fn figures(
    findings: &Findings<'_, '_>,
    data: &Data,
    vehicle: &Vehicle,
    gains: &Gains,
    answer: &Diagnosis,
) -> Figures {
    let inputs = vehicle
        .inputs
        .iter()
        .enumerate()
        .map(|(j, input)| (input.name.clone(), input.unit.si_symbol(), data.input(j).collect()));
    let ranges = data.ranges();
    let outputs = data.channels.iter().zip(&ranges).map(|(channel, range)| {
        let output = &vehicle.outputs[channel.output];
        let tones = answer.causes.iter().filter(|c| {
            c.effect == Kind::Vibration.name() && c.place == output.name
                || c.effect == Kind::PeriodicDisturbance.name()
        });
        OutputFigure {
            name: output.name.clone(),
            unit: output.unit.si_symbol(),
            measured: spread(data, channel, &channel.values),
            before: spread(data, channel, &gains.before[range.clone()]),
            after: if answer.causes.is_empty() {
                Vec::new()
            } else {
                spread(data, channel, &gains.after[range.clone()])
            },
            tones: tones.filter_map(|c| c.parameters.get("frequency_hz").map(|p| p.value)).collect(),
        }
    });
    Figures {
        t: (0..data.steps).map(|k| data.start_s + k as f64 * data.period_s).collect(),
        inputs: inputs.collect(),
        outputs: outputs.collect(),
        evidence: evidence(findings, data, vehicle),
        given_vehicle: vehicle.to_toml(),
    }
}

/// Samples of a channel on the grid of all.
fn spread(data: &Data, channel: &Channel, samples: &[f64]) -> Vec<f64> {
    let mut all = vec![f64::NAN; data.steps];
    for (k, value) in samples.iter().enumerate() {
        all[channel.step(k)] = *value;
    }
    all
}

/// A cause to be shown: without it, with it, and with its nearest rejected rival in its place.
struct Case<'c> {
    candidate: &'c Candidate,
    /// Values of the model that has the candidate last or at its place, and the model.
    model: Model<'c, 'c>,
    values: Vec<f64>,
    without: Vec<f64>,
    with: Vec<f64>,
    rival: Option<(String, Vec<f64>)>,
    accepted: bool,
}

fn evidence(findings: &Findings<'_, '_>, data: &Data, vehicle: &Vehicle) -> Vec<EvidenceCurve> {
    let selection = &findings.selection;
    let fit = &selection.fit;
    let mut cases = Vec::new();
    for (term, (candidate, accepted)) in selection.model.terms.iter().zip(&selection.accepted).enumerate() {
        let mut others = selection.model.clone();
        others.terms.remove(term);
        let mut values = fit.values.clone();
        values.drain(selection.model.range(term));
        let Some(without) = others.predict(&values) else { continue };
        let rival =
            accepted.rivals.iter().find(|r| !r.indistinguishable() && r.kappa < 0.999).and_then(|rival| {
                let mut model = others.clone();
                model.terms.push(rival.candidate.clone());
                let values: Vec<f64> = values.iter().chain(&rival.values).copied().collect();
                Some((words(&rival.candidate), model.predict(&values)?))
            });
        cases.push(Case {
            candidate,
            model: selection.model.clone(),
            values: fit.values.clone(),
            without,
            with: fit.predicted.clone(),
            rival,
            accepted: true,
        });
    }
    cases.extend(rejected(selection));
    let noise: Vec<f64> =
        (0..data.channels.len()).map(|c| fit.profile.noise.std(c, data, &fit.residual)).collect();
    let mut curves: Vec<EvidenceCurve> = cases
        .par_iter()
        .filter_map(|case| {
            let shown = Shown {
                data,
                vehicle,
                noise: &noise,
                states: states(&case.model, &case.values)?,
                without: &case.without,
                with: &case.with,
                rival: case.rival.as_ref().map(|(_, predicted)| predicted.as_slice()),
            };
            let mut curve = shows(&shown, &case.candidate.effect(own_values(case))?)?;
            curve.cause = words(case.candidate);
            curve.accepted = case.accepted;
            if let (Some((name, _)), Some(rival)) = (&case.rival, &mut curve.rival) {
                rival.0.clone_from(name);
            }
            Some(curve)
        })
        .collect();
    let turbulence = findings.turbulence.iter();
    curves.extend(turbulence.filter_map(|t| random::turbulence(t, findings, data, vehicle, &noise)));
    curves.extend(findings.shaking.iter().map(|s| random::shaking(s, findings, data, vehicle)));
    curves.extend(findings.samples.iter().filter_map(|s| random::samples(s, data, vehicle)));
    curves.extend(findings.noise.iter().map(|(c, _)| random::noise(*c, findings, data, vehicle)));
    // Accepted ones first.
    curves.sort_by_key(|c| !c.accepted);
    curves
}

/// The nearest causes that were refused, each beside the terms that it was fitted with.
fn rejected<'c>(selection: &'c Selection<'_, '_>) -> impl Iterator<Item = Case<'c>> {
    let tried = selection.refused.iter().filter_map(|(t, _)| Some((t, t.fit.as_ref()?)));
    tried.take(REJECTED).filter_map(|(trial, fit)| {
        let candidate = &trial.candidate;
        let mut model = selection.model.clone();
        model.terms.clone_from(&trial.beside);
        let without = model.predict(&fit.values[..fit.values.len() - candidate.tunables.len()])?;
        model.terms.push(candidate.clone());
        Some(Case {
            candidate,
            model,
            values: fit.values.clone(),
            without,
            with: fit.predicted.clone(),
            rival: None,
            accepted: false,
        })
    })
}

fn words(candidate: &Candidate) -> String {
    format!("{} on {}", candidate.kind, candidate.place)
}

fn own_values<'c>(case: &'c Case<'_>) -> &'c [f64] {
    let term =
        case.model.terms.iter().position(|t| t == case.candidate).unwrap_or(case.model.terms.len() - 1);
    &case.values[case.model.range(term)]
}

/// States over the steps of the record.
fn states(model: &Model<'_, '_>, values: &[f64]) -> Option<Vec<Vec<f64>>> {
    let data = model.runner.data;
    let vehicle = model.vehicle(values)?;
    let n = vehicle.states.len();
    let mut simulator = data.begin(&vehicle, 0)?;
    let mut states = vec![Vec::with_capacity(data.steps); n];
    for (k, u) in data.inputs.chunks_exact(data.m).enumerate() {
        if let Some(record) = data.starts.iter().position(|s| *s == k) {
            simulator = data.begin(&vehicle, k)?;
            simulator.set_state(&values[record * n..(record + 1) * n]);
        }
        states.iter_mut().zip(simulator.state()).for_each(|(column, x)| column.push(*x));
        simulator.step(u);
    }
    Some(states)
}

#[cfg(test)]
mod tests {
    use super::rejected;
    use crate::diagnose::data::{Channel, Data};
    use crate::diagnose::library::{Sizes, library};
    use crate::diagnose::model::Model;
    use crate::diagnose::runner::Runner;
    use crate::diagnose::select::select;
    use crate::diagnose::survey::Scene;
    use whirlstand_vehicle::{Effect, Kind, Simulator, Vehicle};

    /// A search may end with other terms than those that a refused cause was fitted with.
    #[test]
    fn a_refused_cause_is_shown_beside_the_terms_of_its_own_fit() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let mut truth = vehicle.clone();
        truth.add_effect(Effect::new(Kind::InputGain, "u_roll", &[("factor", 0.8)]).unwrap()).unwrap();
        let (steps, period_s) = (600, 0.02);
        let inputs: Vec<f64> = (0..steps)
            .flat_map(|k| [if k % 150 < 75 { 0.5 } else { -0.5 }, if k % 220 < 110 { 0.5 } else { -0.5 }])
            .collect();
        let mut simulator = Simulator::new(&truth, period_s, 3).unwrap();
        let mut values = vec![Vec::new(); vehicle.outputs.len()];
        for u in inputs.chunks_exact(2) {
            simulator.apply(u);
            values.iter_mut().zip(simulator.measure()).for_each(|(v, y)| v.push(*y));
            simulator.advance();
        }
        let channel = |(output, values): (usize, Vec<f64>)| Channel {
            output,
            stride: 1,
            first: 0,
            good: vec![true; steps],
            values,
        };
        let data = Data {
            origin: "none".into(),
            start_s: 0.0,
            period_s,
            steps,
            inputs,
            m: 2,
            starts: vec![0],
            held: false,
            channels: values.into_iter().enumerate().map(channel).collect(),
        };
        let runner = Runner::new(&vehicle, &data);
        let model = Model { runner: &runner, free: &[], terms: Vec::new() };
        let sizes = Sizes::ones(&vehicle, steps as f64 * period_s, period_s);
        let library = library(&vehicle, &sizes, &[0, 1, 2, 3]);
        let declared: Vec<f64> = vehicle.outputs.iter().map(|o| o.noise).collect();
        let scene = Scene { library: &library, sizes: &sizes, most: 3, declared: &declared };
        let mut selection = select(model, &scene, None, &[]).unwrap();
        assert!(selection.refused.iter().any(|(t, _)| t.fit.is_some()), "{:?}", selection.accepted);
        let before: Vec<Vec<f64>> = rejected(&selection).map(|case| case.without).collect();
        let other = library.iter().find(|c| c.kind == Kind::UnmodelledMode).unwrap();
        selection.model.terms.extend([other.clone(), other.clone()]);
        let after: Vec<Vec<f64>> = rejected(&selection).map(|case| case.without).collect();
        assert_eq!(before, after);
    }
}
