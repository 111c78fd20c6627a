//! Advice on the next flight: experiments for effects that a record cannot show or cannot tell apart.

use std::collections::BTreeMap;

use rayon::prelude::*;
use whirlstand_vehicle::{Effect, Kind, Vehicle};

use crate::answer::schema::{Diagnosis, NotTestable, Verdict};
use crate::data::record::Data;
use crate::model::columns::dot;
use crate::model::score_test::ScoreTest;
use crate::stages::findings::Findings;
use crate::thresholds::MIN_DETECTABILITY;

/// The experiment that distinguishes two effects.
pub fn separating(a: Kind, b: Kind) -> &'static str {
    use Kind::*;
    let is = |x: Kind, y: Kind| (a == x && b == y) || (a == y && b == x);
    let either = |x: Kind| a == x || b == x;
    if is(InputDelay, ActuatorLag) || is(SensorDelay, SensorLag) {
        "faster inputs: a sweep or multisine beyond 1 / (2 pi delay), sampled faster"
    } else if is(InputDelay, SensorDelay)
        || is(ActuatorLag, SensorLag)
        || is(InputDelay, SensorLag)
        || is(ActuatorLag, SensorDelay)
    {
        "a second output that responds to the same input: an input delay affects all outputs, a sensor delay only its own"
    } else if either(InputGain) && (either(DeadZone) || either(InputSaturation) || either(Backlash)) {
        "inputs of several amplitudes: both small and large steps"
    } else if either(DeadZone) || either(Backlash) || either(InputSaturation) || either(RateLimit) {
        "steps of several amplitudes, and slow ramps that reverse within that range"
    } else if either(InputBias) && (either(StepDisturbance) || either(CoulombFriction))
        || is(InputBias, SensorBias)
    {
        "a record that starts at rest with zero input, followed by motion"
    } else if either(ParameterChange) && (either(InputGain) || either(SensorScale)) {
        "a second output: a gain scales every response to the input, a matrix entry only its own"
    } else if either(SensorScale) {
        "a steady attitude against an independent reference, such as a level"
    } else if either(Vibration) && either(PeriodicDisturbance) {
        "a second output: a force affects every output of the state, a tone on a sensor only its own"
    } else if either(UnmodelledMode) {
        "a large-amplitude sweep across the suspected frequency"
    } else if either(Turbulence) {
        "the same flight in calm air, with more outputs measured"
    } else {
        "a longer flight with inputs of several amplitudes and a wider band (whirlstand excite)"
    }
}

/// Candidates that would not be detectable even at the largest size tried.
pub(crate) fn not_testable(findings: &Findings<'_>, data: &Data, vehicle: &Vehicle) -> Vec<NotTestable> {
    let selection = &findings.residual.selection;
    let peaks = &findings.baseline.sizes.inputs;
    let mut found = Vec::new();
    for (j, input) in vehicle.inputs.iter().enumerate() {
        if peaks[j] <= 0.0 {
            found.push(NotTestable {
                effect: "every effect".into(),
                place: input.name.clone(),
                why: "the input is zero throughout; fly a multistep on it (whirlstand excite)".into(),
                effects: 0,
            });
        } else {
            let text = format!(
                "the input never exceeds {}, so limits beyond that cannot be detected: fly with a larger amplitude",
                input.unit.shown().text(peaks[j])
            );
            found.push(NotTestable {
                effect: Kind::InputSaturation.name().into(),
                place: input.name.clone(),
                why: text,
                effects: 0,
            });
        }
    }
    let zero = vec![0.0; selection.fit.residual.len()];
    let score_test = ScoreTest::new(data, &selection.fit.profile.noise, &zero, &selection.fit.columns);
    let mut by_effect: BTreeMap<(&str, String), f64> = BTreeMap::new();
    let energies = selection.refused.par_iter().filter_map(|refused| {
        let candidate = &refused.candidate;
        // The largest size tried is the last start value; a proportional response may be ten times that and
        // still be physically plausible.
        let effect = candidate.effect(candidate.starts.last()?)?;
        let energy = energy(findings, &score_test, &effect).unwrap_or(0.0);
        Some((candidate, energy * if candidate.linear { 100.0 } else { 1.0 }))
    });
    for (candidate, energy) in energies.collect::<Vec<_>>() {
        let known = by_effect.entry((candidate.kind.name(), candidate.place.clone())).or_insert(0.0);
        *known = known.max(energy);
    }
    // One entry per effect: all its places, and the largest detectability among them.
    let mut hidden: BTreeMap<&str, (Vec<String>, f64)> = BTreeMap::new();
    for ((effect, place), energy) in by_effect.into_iter().filter(|(_, energy)| *energy < MIN_DETECTABILITY) {
        let (places, largest) = hidden.entry(effect).or_default();
        places.push(place);
        *largest = largest.max(energy);
    }
    found.extend(hidden.into_iter().map(|(effect, (places, largest))| NotTestable {
        effect: effect.into(),
        effects: places.len(),
        place: places.join(", "),
        why: format!(
            "even a large one would have a detectability of only {largest:.1} here; at least {MIN_DETECTABILITY:.0} is required: fly longer, or with a larger amplitude"
        ),
    }));
    found
}

fn energy(findings: &Findings<'_>, score_test: &ScoreTest<'_>, effect: &Effect) -> Option<f64> {
    let (model, fit) = (&findings.residual.selection.model, &findings.residual.selection.fit);
    let mut vehicle = model.vehicle(&fit.values).ok()?;
    vehicle.add_effect(effect.clone()).ok()?;
    let mut samples = model.free_run.run_vehicle(&vehicle, &fit.values[..model.states()]).ok()?;
    samples.iter_mut().zip(&fit.predicted).for_each(|(y, p)| *y -= p);
    let s = score_test.signature(&samples);
    Some(dot(&s, &s))
}

/// Advice on what to do next.
pub fn advice(answer: &Diagnosis) -> Vec<String> {
    let mut advice = Vec::new();
    for cause in &answer.causes {
        for other in &cause.indistinguishable {
            advice.push(format!(
                "To distinguish {} on {} from {} on {}, use {}.",
                cause.effect, cause.place, other.effect, other.place, other.experiment
            ));
        }
    }
    match answer.verdict {
        Verdict::Inconclusive => advice.push(format!(
            "Fly again with more excitation: whirlstand excite {} --out flight designs such a flight.",
            answer.vehicle
        )),
        Verdict::Unexplained => advice.push(
            "Repeat the flight with half the amplitude: an error that falls to less than half is nonlinear, one that stays the same is a disturbance.".into(),
        ),
        _ => {}
    }
    advice.truncate(6);
    advice
}
