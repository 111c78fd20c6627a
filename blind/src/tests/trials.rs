//! Tests of trials from draw to score.

use std::collections::BTreeMap;
use std::time::Instant;

use serde_json::{Value, json};

use crate::{Case, Diagnosis, Generator, Loops, Outcome, Plan, Scored, Setting, Tally, Trial};

fn drawn(case: Case, count: usize) -> Vec<Trial> {
    let plans = (9_000_000..)
        .map(|number| Plan::new(number, Generator::Reference, Loops::Open))
        .filter(|p| p.case == case);
    plans.filter_map(|p| Trial::draw(&p, &Setting::default()).unwrap()).take(count).collect()
}

/// A diagnosis that names exactly the truth, with intervals of plus and minus a tenth of each value.
fn perfect(trial: &Trial) -> Value {
    let causes: Vec<Value> = trial
        .answer
        .effects
        .iter()
        .map(|t| {
            let mut parameters: BTreeMap<String, Value> = BTreeMap::new();
            for (name, v) in &t.parameters {
                let half = 0.1 * v.abs();
                parameters.insert(name.clone(), json!({ "value": v, "low": v - half, "high": v + half }));
            }
            json!({ "effect": t.effect, "where": t.place, "parameters": parameters, "to": t.to })
        })
        .collect();
    json!({ "verdict": "explained", "causes": causes })
}

fn score(trial: &Trial, diagnosis: Value) -> Scored {
    let diagnosis: Diagnosis = serde_json::from_value(diagnosis).unwrap();
    Scored::new(trial, &diagnosis, "seal".into(), 0.1).unwrap()
}

#[test]
fn every_effect_can_be_hidden_and_shows_in_a_wide_range() {
    let mut missing = Vec::new();
    let mut lambdas = Vec::new();
    for number in 4_000_000..4_000_075 {
        let plan = Plan::new(number, Generator::Reference, Loops::Open);
        let start = Instant::now();
        let trial = Trial::draw(&plan, &Setting::default()).unwrap();
        let seconds = start.elapsed().as_secs_f64();
        let Some(trial) = trial else {
            println!("{number} {:?} {:?} {:?}: none, {seconds:.2} s", plan.case, plan.effects, plan.outside);
            missing.push(number);
            continue;
        };
        let a = &trial.answer;
        println!(
            "{number} {:<8} {:<22} {:<10} {:>4.0} s {:>3.0} Hz {:<10} {}  drawn in {seconds:.2} s",
            plan.case.name(),
            a.vehicle,
            a.excitation.name(),
            a.duration_s,
            a.rate_hz,
            a.noise.name(),
            a.effects
                .iter()
                .map(|t| format!("{}({}) {:?} lambda {:.0}", t.effect, t.place, t.parameters, t.lambda))
                .collect::<Vec<_>>()
                .join(" + "),
        );
        if plan.case == Case::Single {
            lambdas.push(a.effects[0].lambda);
        }
        assert!(trial.csv().lines().count() > 1000);
    }
    lambdas.sort_by(f64::total_cmp);
    println!("lambda {lambdas:.0?}");
    assert!(missing.len() <= 3, "{missing:?}");
    assert!(lambdas[lambdas.len() / 10] < 100.0 && lambdas[lambdas.len() / 2] < 3e4);
}

#[test]
fn a_trial_is_the_same_whenever_it_is_drawn() {
    let plan = Plan::new(5_000_007, Generator::Reference, Loops::Open);
    let draw = || Trial::draw(&plan, &Setting::default()).unwrap().unwrap();
    let (a, b) = (draw(), draw());
    assert_eq!(a.answer_json(), b.answer_json());
    assert_eq!(a.csv(), b.csv());
}

#[test]
fn the_truth_scores_as_right_and_anything_else_does_not() {
    let trials = drawn(Case::Single, 12);
    let mut scored = Vec::new();
    for trial in &trials {
        let right = score(trial, perfect(trial));
        assert_eq!(right.outcome, Outcome::Right, "{:?}", trial.answer.effects);
        assert_eq!(right.wrong_names, 0);
        assert!(right.parameters.iter().all(|p| p.inside == Some(true)), "{:?}", right.parameters);
        let mut shifted = perfect(trial);
        for p in shifted["causes"][0]["parameters"].as_object_mut().unwrap().values_mut() {
            for key in ["value", "low", "high"] {
                p[key] = json!(1.2 * p[key].as_f64().unwrap());
            }
        }
        let off = score(trial, shifted);
        assert!(off.parameters.iter().all(|p| p.inside == Some(false) || p.truth == 0.0), "{off:?}");
        assert!(off.parameters.iter().filter_map(|p| p.relative_error).all(|e| (e - 0.2).abs() < 1e-9));
        let wrong =
            json!({ "verdict": "explained", "causes": [{ "effect": "sensor_bias", "where": "nowhere" }] });
        let wrong = score(trial, wrong);
        assert_eq!((wrong.outcome, wrong.wrong_names), (Outcome::Wrong, 1));
        let missed = score(trial, json!({ "verdict": "unexplained", "causes": [] }));
        assert_eq!(missed.outcome, Outcome::Missed);
        scored.extend([right, missed]);
    }
    let tally = Tally::new("test".into(), scored, 0);
    let counted = trials.iter().filter(|t| t.answer.effects[0].lambda > 30.0).count();
    assert_eq!((tally.goals[0].hits, tally.goals[0].of), (Some(counted), 2 * counted));
    assert_eq!(tally.goals[0].met, Some(false));
    assert!(tally.text().contains("missed"));
    let read: Tally = serde_json::from_str(&serde_json::to_string(&tally).unwrap()).unwrap();
    assert_eq!(read.goals, tally.goals);
}

#[test]
fn clean_records_and_effects_outside_the_table_are_right_when_nothing_is_named() {
    for trial in drawn(Case::Clean, 3).iter().chain(&drawn(Case::Outside, 3)) {
        assert_eq!(score(trial, json!({ "verdict": "consistent" })).outcome, Outcome::Right);
        let named =
            json!({ "verdict": "explained", "causes": [{ "effect": "input_gain", "where": "u_roll" }] });
        assert_eq!(score(trial, named).outcome, Outcome::Wrong);
    }
}

#[test]
fn pairs_count_when_both_are_named_in_any_order() {
    for trial in &drawn(Case::Pair, 4) {
        assert!(trial.answer.effects.iter().all(|t| t.lambda >= 30.0));
        let mut both = perfect(trial);
        both["causes"].as_array_mut().unwrap().reverse();
        assert_eq!(score(trial, both.clone()).outcome, Outcome::Right, "{:?}", trial.answer.effects);
        both["causes"].as_array_mut().unwrap().pop();
        assert_eq!(score(trial, both).outcome, Outcome::Half);
    }
}

#[test]
fn a_listing_counts_only_where_the_records_are_alike() {
    // On the quadrotor, u_pitch acts on pitch_rate only: its gain is B[4,2].
    let vehicle = whirlstand_vehicle::Vehicle::builtin("quadrotor").unwrap();
    let mut vehicle = vehicle;
    vehicle.free.clear();
    vehicle.outputs.iter_mut().for_each(|o| o.vibration = None);
    let setting = Setting { vehicle: Some(vehicle), ..Setting::default() };
    let gain = |p: &Plan| p.case == Case::Single && p.effects == [whirlstand_vehicle::Kind::InputGain];
    let trial = (7_000_000..)
        .map(|number| Plan::new(number, Generator::Reference, Loops::Open))
        .filter(gain)
        .filter_map(|p| Trial::draw(&p, &setting).unwrap())
        .find(|t| t.answer.effects[0].place == "u_pitch")
        .unwrap();
    let factor = trial.answer.effects[0].parameters["factor"];
    let listed = |named: &str, parameter: Value| {
        let cause = json!({ "effect": "parameter_change", "where": named, "parameters": { "factor": parameter },
            "indistinguishable": [{ "effect": "input_gain", "where": "u_pitch" }] });
        score(&trial, json!({ "verdict": "explained", "causes": [cause] }))
    };
    let same = listed("B[4,2]", json!({ "value": factor }));
    assert_eq!(same.outcome, Outcome::Listed);
    assert!(same.kappa.unwrap() > 0.9999);
    let other = listed("A[4,4]", json!({ "value": 1.2 }));
    assert_eq!((other.outcome, other.wrong_names), (Outcome::Wrong, 1), "{:?}", other.kappa);
}

#[test]
fn what_is_outside_the_table_is_alike_only_under_a_name_that_does_the_same() {
    // The square of an input that changes from one side to the other is constant during that time.
    let setting =
        Setting { lengths_s: Some((15.0, 45.0)), rates_hz: Some(vec![50.0, 100.0]), ..Setting::default() };
    let trial =
        Trial::draw(&Plan::new(2_000_021, Generator::Reference, Loops::Open), &setting).unwrap().unwrap();
    assert_eq!(trial.answer.effects[0].effect, "squared_input");
    let pulse = |magnitude: f64, at: f64| {
        let parameters = json!({ "at_s": { "value": at }, "duration_s": { "value": 7.6 },
            "magnitude": { "value": magnitude } });
        let cause = json!({ "effect": "pulse_disturbance", "where": "roll_rate", "parameters": parameters });
        score(&trial, json!({ "verdict": "explained", "causes": [cause] }))
    };
    let same = pulse(-0.0139, 1.12);
    assert_eq!((same.outcome, same.wrong_names), (Outcome::Alike, 0), "{:?}", same.kappa);
    let other = pulse(-0.0139, 4.0);
    assert_eq!((other.outcome, other.wrong_names), (Outcome::Wrong, 1), "{:?}", other.kappa);
}

/// Self-excitation as in van der Pol's oscillator is, on a single state, a smaller damping and a cubic one. Several pushes could
/// be made into anything: they are no such effect.
#[test]
fn effects_that_are_together_what_was_hidden_are_alike() {
    let setting =
        Setting { lengths_s: Some((12.0, 24.0)), rates_hz: Some(vec![40.0, 50.0]), ..Setting::default() };
    let plan = Plan::new(20_261_247_000_746, Generator::Shifted, Loops::Both);
    let trial = Trial::draw(&plan, &setting).unwrap().unwrap();
    let hidden = &trial.answer.effects[0];
    assert_eq!(hidden.effect, "self_excitation");
    let vehicle = &trial.experiment.nominal.vehicle;
    let onto = hidden.place.rsplit(' ').next().unwrap();
    let i = vehicle.states.iter().position(|state| state.name == onto).unwrap();
    let (size, scale) = (hidden.parameters["size"], hidden.parameters["scale"]);
    let cause = |effect: &str, place: String, parameter: &str, value: f64| {
        let parameters = json!({ parameter: { "value": value } });
        json!({ "effect": effect, "where": place, "parameters": parameters })
    };
    let entry = format!("A[{},{}]", i + 1, i + 1);
    let damping = cause("parameter_change", entry, "value", vehicle.a[(i, i)] + size);
    let place = format!("{onto}->{onto}");
    let cubic = cause("cubic_stiffness", place, "coefficient", size / (scale * scale));
    let outcome = |causes: Vec<&Value>| {
        let scored = score(&trial, json!({ "verdict": "explained", "causes": causes }));
        (scored.outcome, scored.wrong_names)
    };
    assert_eq!(outcome(vec![&damping, &cubic]), (Outcome::Alike, 0));
    let push = json!({ "effect": "step_disturbance", "where": onto,
        "parameters": { "at_s": { "value": 3.0 }, "magnitude": { "value": 1e-9 } } });
    assert_eq!(outcome(vec![&damping, &cubic, &push]), (Outcome::Wrong, 3));
}
