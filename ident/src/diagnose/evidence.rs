//! The signals of a diagnosis for the report: runs before and after, and what each cause explains.

use whirlstand_vehicle::{Kind, Vehicle};

use super::answer::{Diagnosis, EvidenceCurve, Figures, OutputFigure};
use super::data::{Channel, Data};
use super::gains::Gains;
use super::library::Candidate;
use super::model::Model;
use super::run::Findings;

/// Rejected candidates that are shown beside the accepted ones.
const REJECTED: usize = 2;
/// Points of a curve.
const POINTS: usize = 1500;

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

fn evidence(findings: &Findings<'_, '_>, data: &Data, vehicle: &Vehicle) -> Vec<EvidenceCurve> {
    let selection = &findings.selection;
    let mut curves = Vec::new();
    for (term, candidate) in selection.model.terms.iter().enumerate() {
        let mut others = selection.model.clone();
        others.terms.remove(term);
        let mut values = selection.fit.values.clone();
        values.drain(selection.model.range(term));
        if let Some(without) = others.predict(&values) {
            curves.extend(curve(data, vehicle, candidate, &without, &selection.fit.predicted, true));
        }
    }
    let tried = selection.refused.iter().filter_map(|(t, _)| Some((&t.candidate, t.fit.as_ref()?)));
    for (candidate, fit) in tried.take(REJECTED) {
        let model: &Model<'_, '_> = &selection.model;
        let values = &fit.values[..fit.values.len() - candidate.tunables.len()];
        if let Some(without) = model.predict(values) {
            curves.extend(curve(data, vehicle, candidate, &without, &fit.predicted, false));
        }
    }
    curves
}

/// The residual without a cause, and what the cause says it should be, in the output that shows it best, over the part
/// of the record that shows it best.
fn curve(
    data: &Data,
    vehicle: &Vehicle,
    candidate: &Candidate,
    without: &[f64],
    with: &[f64],
    accepted: bool,
) -> Option<EvidenceCurve> {
    let ranges = data.ranges();
    let strength = |c: usize| {
        let output = &vehicle.outputs[data.channels[c].output];
        let noise = if output.noise > 0.0 { output.noise } else { 1.0 };
        let power: f64 = ranges[c].clone().map(|k| (with[k] - without[k]).powi(2)).sum();
        power / (noise * noise)
    };
    let c = (0..ranges.len()).max_by(|a, b| strength(*a).total_cmp(&strength(*b)))?;
    let (channel, range) = (&data.channels[c], ranges[c].clone());
    let difference: Vec<f64> = range.clone().map(|k| with[k] - without[k]).collect();
    let window = POINTS.min(difference.len());
    let mut sum: f64 = difference[..window].iter().map(|d| d * d).sum();
    let mut best = (sum, 0);
    for k in window..difference.len() {
        sum += difference[k].powi(2) - difference[k - window].powi(2);
        if sum > best.0 {
            best = (sum, k + 1 - window);
        }
    }
    let rows = best.1..best.1 + window;
    let output = &vehicle.outputs[channel.output];
    Some(EvidenceCurve {
        cause: format!("{} on {}", candidate.kind, candidate.place),
        accepted,
        x_label: "time, s".into(),
        y_label: format!("residual of {}, {}", output.name, output.unit.si_symbol()),
        x: rows.clone().map(|k| data.start_s + channel.step(k) as f64 * data.period_s).collect(),
        residual: rows.clone().map(|k| channel.values[k] - without[range.start + k]).collect(),
        explained: rows.map(|k| difference[k]).collect(),
    })
}
