//! A random force on a state, which a search expands into pushes and periodic forces.

use whirlstand_vehicle::Kind;

use crate::candidates::library::Candidate;
use crate::search::selection::Selection;
use crate::thresholds::MAX_GUSTS;

/// A state on which a random force acts, and the terms into which it was expanded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RandomForce {
    /// Name of the state.
    pub state: String,
    /// Indices of the terms.
    pub terms: Vec<usize>,
}

/// Random forces among the terms of a selection: as many pushes and periodic forces as are looked for on one state, of which
/// two of a kind act at the same time. Any force is a sum of such terms (Karhunen and Loeve; Van Trees, Detection, Estimation
/// and Modulation Theory I, 1968, 3.4), and that they are events of their own is then no better than any other sum. Pushes
/// one after another are events.
pub fn random_forces(selection: &Selection<'_, '_>) -> Vec<RandomForce> {
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
    use whirlstand_vehicle::Vehicle;

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
        random_forces(&selection).len()
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
}
