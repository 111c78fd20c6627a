//! A random force on a state, which a search expands into pushes and periodic forces.

use whirlstand_vehicle::Kind;

use crate::candidates::library::Candidate;
use crate::model::noise::Noise;
use crate::residual::turbulence::turbulence;
use crate::search::selection::Selection;
use crate::thresholds::{MAX_GUSTS, MIN_BIC_GAIN};

/// A state on which a random force acts, and the terms into which it was expanded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RandomForce {
    /// Name of the state.
    pub state: String,
    /// Indices of the terms.
    pub terms: Vec<usize>,
}

/// Random forces among the terms of a selection, which turbulence explains as well.
pub fn random_forces(selection: &Selection<'_, '_>) -> Vec<RandomForce> {
    sums(selection).into_iter().filter(|force| !are_events(force, selection)).collect()
}

/// What may be a random force: as many pushes and periodic forces as are looked for on one state, of which two of a kind act
/// at the same time. Any force is a sum of such terms (Karhunen and Loeve; Van Trees, Detection, Estimation and Modulation
/// Theory I, 1968, 3.4). Pushes one after another are events.
fn sums(selection: &Selection<'_, '_>) -> Vec<RandomForce> {
    let model = &selection.model;
    let end_s = model.free_run.data.times_s().1;
    let gusts: Vec<(usize, &Candidate)> =
        model.terms.iter().enumerate().filter(|(_, term)| term.is_gust()).collect();
    let interval =
        |term: usize| interval(&model.terms[term], &selection.fit.values[model.range(term)], end_s);
    let mut states: Vec<&str> = gusts.iter().map(|(_, gust)| gust.place.as_str()).collect();
    states.sort_unstable();
    states.dedup();
    let on = |state: &str| -> Option<RandomForce> {
        let terms: Vec<usize> =
            gusts.iter().filter(|(_, gust)| gust.place == state).map(|(term, _)| *term).collect();
        let at_once = |a: usize, b: usize| {
            let ((from, to), (other_from, other_to)) = (interval(a), interval(b));
            model.terms[a].kind == model.terms[b].kind && from < other_to && other_from < to
        };
        let any = terms.iter().enumerate().any(|(i, a)| terms[..i].iter().any(|b| at_once(*a, *b)));
        (terms.len() >= MAX_GUSTS && any).then(|| RandomForce { state: state.into(), terms })
    };
    states.into_iter().filter_map(on).collect()
}

/// True when terms explain more than turbulence in their place, by BIC. When a term acts was chosen among many times, which
/// BIC does not count: each costs twice the logarithm of their number (Zhang and Siegmund, Biometrics 63, 2007).
fn are_events(force: &RandomForce, selection: &Selection<'_, '_>) -> bool {
    let Some(calm) = selection.without(&force.terms, &[]) else { return false };
    let Some(turbulence) = turbulence(&calm.model, &calm.fit.values, &calm.fit.residual) else { return true };
    let data = selection.model.free_run.data;
    let bic = |s: &Selection<'_, '_>| Noise::fit(data, &s.fit.residual).bic(s.model.parameters());
    let looks: f64 =
        force.terms.iter().map(|term| 2.0 * selection.model.terms[*term].looks.max(1.0).ln()).sum();
    bic(&calm) - bic(selection) - looks > turbulence.delta_bic + MIN_BIC_GAIN
}

/// From when to when a push or a periodic force acts, s.
fn interval(candidate: &Candidate, values: &[f64], end_s: f64) -> (f64, f64) {
    let value = |name: &str| candidate.tunables.iter().position(|t| t.name == name).map(|i| values[i]);
    let from_s = value("at_s").unwrap_or(f64::NEG_INFINITY);
    match candidate.kind {
        Kind::PulseDisturbance => (from_s, from_s + value("duration_s").unwrap_or(0.0)),
        _ => (from_s, end_s),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::candidates::library::{Sizes, pulse, step, tone};
    use crate::data::flown::flown;
    use crate::model::fit::Model;
    use crate::model::free_run::FreeRun;
    use crate::search::acceptance::TermEvidence;
    use crate::search::selection::Accepted;
    use whirlstand_vehicle::{Effect, Vehicle};

    /// The number of random forces that these terms on one state are.
    fn random(of: impl Fn(&Sizes) -> Vec<Candidate>) -> usize {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let data = flown(&vehicle, vec![0.0; 2000 * vehicle.inputs.len()], 5);
        let free_run = FreeRun::new(&vehicle, &data);
        let nothing = Model { free_run: &free_run, free: &[], terms: Vec::new() };
        let mut selection = Selection::nothing(nothing, vec![0.0; 4]).unwrap();
        let terms = of(&Sizes::ones(&vehicle, 20.0, 0.01));
        selection.fit.values.extend(terms.iter().flat_map(|term| &term.starts[0]));
        selection.model.terms = terms;
        sums(&selection).len()
    }

    fn push(at_s: f64, duration_s: f64, sizes: &Sizes) -> Candidate {
        pulse("roll_rate", at_s, duration_s, 1.0, sizes, 1.0)
    }

    #[test]
    fn pushes_one_after_another_are_events_and_pushes_within_pushes_are_not() {
        assert_eq!(random(|s| vec![push(1.0, 0.5, s), push(4.0, 0.5, s), push(8.0, 0.5, s)]), 0);
        assert_eq!(random(|s| vec![push(1.0, 5.0, s), push(4.0, 0.5, s), push(8.0, 0.5, s)]), 1);
        assert_eq!(random(|s| vec![push(1.0, 5.0, s), push(4.0, 0.5, s)]), 0, "two");
        let wind = |s: &Sizes| step("roll_rate", 2.0, 1.0, s, 1.0);
        assert_eq!(random(|s| vec![push(1.0, 0.5, s), push(4.0, 0.5, s), wind(s)]), 0, "pushes in a wind");
        assert_eq!(random(|s| vec![push(1.0, 5.0, s), push(4.0, 0.5, s), wind(s)]), 1);
        let elsewhere = |s: &Sizes| pulse("pitch_rate", 4.0, 0.5, 1.0, s, 1.0);
        assert_eq!(random(|s| vec![push(1.0, 5.0, s), elsewhere(s), push(8.0, 0.5, s)]), 0);
    }

    #[test]
    fn a_tone_beside_pushes_is_one_of_its_own() {
        let hum = |f: f64, s: &Sizes| tone(Kind::PeriodicDisturbance, "roll_rate", (f, 1.0, 0.0), s, 1.0);
        assert_eq!(random(|s| vec![hum(5.0, s), push(4.0, 0.5, s), push(8.0, 0.5, s)]), 0);
        assert_eq!(random(|s| vec![hum(0.2, s), hum(0.3, s), push(8.0, 0.5, s)]), 1);
    }

    /// Whether three pushes at once explain more than turbulence does in a flight with these effects.
    fn likelier(effects: &[Effect]) -> bool {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let mut flying = vehicle.clone();
        effects.iter().for_each(|effect| flying.add_effect(effect.clone()).unwrap());
        let data = flown(&flying, vec![0.0; 1000 * vehicle.inputs.len()], 5);
        let free_run = FreeRun::new(&vehicle, &data);
        let model = Model { free_run: &free_run, free: &[], terms: Vec::new() };
        let mut selection = Selection::nothing(model, vec![0.0; 4]).unwrap();
        let sizes = Sizes::ones(&vehicle, 20.0, 0.02);
        let term = |(at_s, duration_s, size)| pulse("roll_rate", at_s, duration_s, size, &sizes, 1e4);
        selection.model.terms = PUSHES.map(term).to_vec();
        let mut values = vec![0.0; 4];
        values.extend(selection.model.terms.iter().flat_map(|term| &term.starts[0]));
        selection.fit = selection.model.fit(values, None, None).unwrap();
        let evidence = TermEvidence { delta_bic: 99.0, heldout: 9.0, p_value: 0.0, detectability: 99.0 };
        selection.accepted = vec![Accepted { evidence, rivals: Vec::new() }; 3];
        are_events(&sums(&selection)[0], &selection)
    }

    /// Times, durations and sizes of pushes.
    const PUSHES: [(f64, f64, f64); 3] = [(2.0, 4.0, 0.05), (4.0, 6.0, -0.05), (14.0, 3.0, 0.05)];

    #[test]
    fn pushes_at_once_are_events_where_they_explain_more_than_turbulence() {
        let effect = |kind, parameters: &[(&str, f64)]| Effect::new(kind, "roll_rate", parameters).unwrap();
        let push = |(at_s, duration_s, size)| {
            effect(Kind::PulseDisturbance, &[("at_s", at_s), ("duration_s", duration_s), ("magnitude", size)])
        };
        assert!(likelier(&PUSHES.map(push)));
        assert!(!likelier(&[effect(Kind::Turbulence, &[("std", 0.3), ("bandwidth_hz", 0.1)])]));
    }
}
