//! Signals of a diagnosis for the report: predictions before and after, and an evidence curve per cause.

use crate::thresholds::REJECTED_SHOWN;
use rayon::prelude::*;
use whirlstand_vehicle::{Kind, Vehicle};

use crate::answer::evidence_plots::{PlotInput, evidence_plot};
use crate::answer::evidence_random;
use crate::answer::schema::{Diagnosis, EvidenceCurve, Figures, OutputFigure};
use crate::candidates::library::Candidate;
use crate::data::record::{Channel, Data};
use crate::model::fit::Model;
use crate::search::selection::Selection;
use crate::stages::findings::Findings;

pub(crate) fn figures(findings: &Findings<'_>, answer: &Diagnosis) -> Figures {
    let (data, vehicle, gains) = (findings.baseline.data(), findings.baseline.vehicle(), &findings.gains);
    let inputs = vehicle
        .inputs
        .iter()
        .enumerate()
        .map(|(j, input)| (input.name.clone(), input.unit.shown(), data.input(j).collect()));
    let ranges = data.ranges();
    let outputs = data.channels.iter().zip(&ranges).map(|(channel, range)| {
        let output = &vehicle.outputs[channel.output];
        let tones = answer.causes.iter().filter(|c| {
            c.effect == Kind::Vibration.name() && c.place == output.name
                || c.effect == Kind::PeriodicDisturbance.name()
        });
        OutputFigure {
            name: output.name.clone(),
            unit: output.unit.shown(),
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

/// Samples of a channel on the common grid of all channels, NaN in between.
fn spread(data: &Data, channel: &Channel, samples: &[f64]) -> Vec<f64> {
    let mut all = vec![f64::NAN; data.steps];
    for (k, value) in samples.iter().enumerate() {
        all[channel.step(k)] = *value;
    }
    all
}

/// A cause to plot: predictions without it, with it, and with its nearest rejected rival in its place.
struct Case<'c> {
    candidate: &'c Candidate,
    /// The model that contains the candidate, and its parameter values.
    model: Model<'c, 'c>,
    values: Vec<f64>,
    without: Vec<f64>,
    with: Vec<f64>,
    rival: Option<(String, Vec<f64>)>,
    accepted: bool,
}

fn evidence(findings: &Findings<'_>, data: &Data, vehicle: &Vehicle) -> Vec<EvidenceCurve> {
    let residual = &findings.residual;
    let fit = &residual.selection.fit;
    let noise: Vec<f64> =
        (0..data.channels.len()).map(|c| fit.profile.noise.std(c, data, &fit.residual)).collect();
    let cases: Vec<Case<'_>> = accepted(&residual.selection).chain(rejected(&residual.selection)).collect();
    let mut curves: Vec<EvidenceCurve> =
        cases.par_iter().filter_map(|case| drawn(case, data, vehicle, &noise)).collect();
    let turbulence = residual.turbulence.iter();
    curves.extend(turbulence.filter_map(|t| evidence_random::turbulence(t, findings, data, vehicle, &noise)));
    let lines = residual.narrow_band.iter();
    curves.extend(lines.map(|line| evidence_random::narrow_band(line, findings, data, vehicle)));
    let samples = residual.samples.iter();
    curves.extend(samples.filter_map(|effect| evidence_random::samples(effect, data, vehicle)));
    let noisy = residual.noise.iter();
    curves.extend(noisy.map(|(channel, _)| evidence_random::noise(*channel, findings, data, vehicle)));
    // Accepted causes come before rejected ones.
    curves.sort_by_key(|c| !c.accepted);
    curves
}

/// The accepted causes, each fitted beside all others, with its nearest rejected rival.
fn accepted<'c>(selection: &'c Selection<'_, '_>) -> impl Iterator<Item = Case<'c>> {
    let (model, fit) = (&selection.model, &selection.fit);
    model.terms.iter().zip(&selection.accepted).enumerate().filter_map(|(term, (candidate, accepted))| {
        let mut others = model.clone();
        others.terms.remove(term);
        let mut values = fit.values.clone();
        values.drain(model.range(term));
        let without = others.predict(&values).ok()?;
        let rival = accepted.rivals.iter().find(|r| !r.indistinguishable() && r.kappa < 0.999);
        let rival = rival.and_then(|rival| {
            others.terms.push(rival.candidate.clone());
            values.extend(&rival.values);
            Some((label(&rival.candidate), others.predict(&values).ok()?))
        });
        Some(Case {
            candidate,
            model: model.clone(),
            values: fit.values.clone(),
            without,
            with: fit.predicted.clone(),
            rival,
            accepted: true,
        })
    })
}

/// The evidence curve of a cause; `None` where nothing can be drawn.
fn drawn(case: &Case<'_>, data: &Data, vehicle: &Vehicle, noise: &[f64]) -> Option<EvidenceCurve> {
    let (model, values) = (&case.model, &case.values);
    let states = model.free_run.run_states(&model.vehicle(values).ok()?, &values[..model.states()]).ok()?;
    let shown = PlotInput {
        data,
        vehicle,
        noise,
        states,
        without: &case.without,
        with: &case.with,
        rival: case.rival.as_ref().map(|(_, predicted)| predicted.as_slice()),
    };
    let mut curve = evidence_plot(&shown, &case.candidate.effect(own_values(case))?)?;
    curve.cause = label(case.candidate);
    curve.accepted = case.accepted;
    if let (Some((name, _)), Some(rival)) = (&case.rival, &mut curve.rival) {
        rival.0.clone_from(name);
    }
    Some(curve)
}

/// The nearest refused candidates, each with the terms that it was fitted beside.
fn rejected<'c>(selection: &'c Selection<'_, '_>) -> impl Iterator<Item = Case<'c>> {
    let tried = selection.refused.iter().filter_map(|t| Some((t, t.values.as_ref()?)));
    tried.take(REJECTED_SHOWN).filter_map(|(refused, values)| {
        let candidate = &refused.candidate;
        let mut model = selection.model.clone();
        model.terms.clone_from(&refused.beside);
        let without = model.predict(&values[..values.len() - candidate.tunables.len()]).ok()?;
        model.terms.push(candidate.clone());
        let with = model.predict(values).ok()?;
        Some(Case { candidate, model, values: values.clone(), without, with, rival: None, accepted: false })
    })
}

fn label(candidate: &Candidate) -> String {
    format!("{} on {}", candidate.kind, candidate.place)
}

fn own_values<'c>(case: &'c Case<'_>) -> &'c [f64] {
    let term =
        case.model.terms.iter().position(|t| t == case.candidate).unwrap_or(case.model.terms.len() - 1);
    &case.values[case.model.range(term)]
}

#[cfg(test)]
mod tests {
    use super::rejected;
    use crate::candidates::library::{Sizes, library};
    use crate::data::flown::flown;
    use crate::model::fit::Model;
    use crate::model::free_run::FreeRun;
    use crate::search::alternative::SearchSpace;
    use crate::search::select::select;
    use whirlstand_vehicle::{Effect, Kind, Vehicle};

    /// The search may end with other terms than those beside which a refused cause was fitted.
    #[test]
    fn a_refused_cause_is_shown_beside_the_terms_of_its_own_fit() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let mut truth = vehicle.clone();
        truth.add_effect(Effect::new(Kind::InputGain, "u_roll", &[("factor", 0.8)]).unwrap()).unwrap();
        let inputs = (0..600)
            .flat_map(|k| [if k % 150 < 75 { 0.5 } else { -0.5 }, if k % 220 < 110 { 0.5 } else { -0.5 }])
            .collect();
        let data = flown(&truth, inputs, 3);
        let free_run = FreeRun::new(&vehicle, &data);
        let model = Model { free_run: &free_run, free: &[], terms: Vec::new() };
        let sizes = Sizes::ones(&vehicle, data.duration_s(), data.period_s);
        let library = library(&vehicle, &sizes, &[0, 1, 2, 3]);
        let declared: Vec<f64> = vehicle.outputs.iter().map(|o| o.noise).collect();
        let space = SearchSpace {
            library: &library,
            sizes: &sizes,
            most: 3,
            declared: &declared,
            watch: &crate::Watch::default(),
        };
        let mut selection = select(model, &space, None, &[]).unwrap();
        assert!(selection.refused.iter().any(|t| t.values.is_some()), "{:?}", selection.accepted);
        let before: Vec<Vec<f64>> = rejected(&selection).map(|case| case.without).collect();
        let other = library.iter().find(|c| c.kind == Kind::UnmodelledMode).unwrap();
        selection.model.terms.extend([other.clone(), other.clone()]);
        let after: Vec<Vec<f64>> = rejected(&selection).map(|case| case.without).collect();
        assert_eq!(before, after);
    }
}
