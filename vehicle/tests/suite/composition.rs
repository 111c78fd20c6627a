//! Any set of valid effects builds, runs, stays finite and is the same twice; and survives being written to a file.

use proptest::prelude::*;
use whirlstand_vehicle::{
    Effect, FieldValue, Kind, PlaceKind, Requirement, SPECS, Scale, Simulator, Spec, Vehicle, builtin_names,
};

/// A place of the right kind in `vehicle`, chosen by a number.
fn place(vehicle: &Vehicle, kind: PlaceKind, pick: usize) -> String {
    let state = |k: usize| vehicle.states[k % vehicle.states.len()].name.clone();
    let input = |k: usize| vehicle.inputs[k % vehicle.inputs.len()].name.clone();
    let output = |k: usize| vehicle.outputs[k % vehicle.outputs.len()].name.clone();
    match kind {
        PlaceKind::Input => input(pick),
        PlaceKind::InputPair => format!("{}->{}", input(pick), input(pick + 1)),
        PlaceKind::Output => output(pick),
        PlaceKind::OutputPair => format!("{},{}", output(pick), output(pick + 1)),
        PlaceKind::State => state(pick),
        PlaceKind::StatePair => format!("{}->{}", state(pick), state(pick / 7)),
        PlaceKind::Entry => {
            format!("A[{},{}]", 1 + pick % vehicle.a.nrows(), 1 + pick / 3 % vehicle.a.nrows())
        }
        PlaceKind::Vehicle => "vehicle".into(),
    }
}

/// A parameter's value in its range, spread by `x` in 0..1.
fn value(name: &str, scale: Scale, lower: f64, upper: f64, x: f64) -> f64 {
    match (name, scale) {
        ("lower", _) => -x,
        ("upper", _) => x,
        ("level", _) => 0.5 + x,
        ("asymmetry", _) => x - 0.5,
        ("coefficient", Scale::Drag | Scale::Cubic) => 3.0 * x,
        (_, Scale::Time) => 0.7 * x,
        (_, Scale::Frequency) => (10.0 * x).max(lower),
        _ => (2.0 * x - 1.0).clamp(lower.max(-1.0), upper.min(1.0)),
    }
}

fn effect(vehicle: &Vehicle, spec: &Spec, pick: usize, x: &[f64]) -> Effect {
    let mut fields: Vec<(&str, FieldValue)> = Vec::new();
    for (p, x) in spec.parameters.iter().zip(x) {
        if p.requirement != Requirement::OneOf || fields.is_empty() {
            fields.push((p.name, FieldValue::Number(value(p.name, p.scale, p.lower, p.upper, *x))));
        }
    }
    match spec.kind {
        Kind::ModeTransition => {
            let to = if vehicle.states.len() == 8 { "helicopter-lateral" } else { "quadrotor" };
            fields.push(("to", FieldValue::Text(to.into())));
        }
        Kind::Vibration => fields.push(("source", FieldValue::Text("a \"rotor\"".into()))),
        _ => {}
    }
    Effect::from_fields(spec.kind, &place(vehicle, spec.place, pick), fields)
        .unwrap_or_else(|e| panic!("{e}"))
}

prop_compose! {
    fn extended()(name in 0usize..4, chosen in prop::collection::vec((0..SPECS.len(), 0usize..64, prop::array::uniform3(0f64..1.0)), 0..10)) -> Vehicle {
        let mut vehicle = Vehicle::builtin(builtin_names().nth(name).unwrap()).unwrap();
        for (spec, pick, x) in chosen {
            let effect = effect(&vehicle, &SPECS[spec], pick, &x);
            vehicle.add_effect(effect).unwrap_or_else(|e| panic!("{e}"));
        }
        vehicle
    }
}

fn fly(vehicle: &Vehicle, period_s: f64) -> Vec<u64> {
    let mut simulator = Simulator::new(vehicle, period_s, 9).unwrap();
    let mut seen = Vec::new();
    for k in 0..120 {
        let stick = (f64::from(k) * 0.1).sin();
        simulator.apply(&vec![3.0 * stick; vehicle.inputs.len()]);
        seen.extend(simulator.measure().iter().map(|y| y.to_bits()));
        assert!(simulator.measure().iter().all(|y| y.is_finite()), "step {k}: {:?}", vehicle.effects);
        simulator.advance();
        seen.extend(simulator.state().iter().chain(simulator.disturbance()).map(|x| x.to_bits()));
        assert!(simulator.state().iter().all(|x| x.is_finite()), "step {k}: {:?}", vehicle.effects);
    }
    seen
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, ..ProptestConfig::default() })]

    #[test]
    fn any_effects_compose(vehicle in extended(), period_s in 0.001f64..0.05) {
        let first = fly(&vehicle, period_s);
        prop_assert_eq!(&first, &fly(&vehicle, period_s));
        // The order in the file does not matter between different effects.
        let mut sorted = vehicle.clone();
        sorted.effects.sort_by_key(Effect::kind);
        prop_assert_eq!(first, fly(&sorted, period_s));
    }

    #[test]
    fn an_extended_vehicle_survives_its_file(vehicle in extended()) {
        let text = vehicle.to_toml();
        prop_assert!(text.starts_with(&vehicle.source_text), "the file is kept and continued");
        let read = Vehicle::parse(&text, &vehicle.name).unwrap_or_else(|e| panic!("{e}"));
        prop_assert_eq!(&read.effects, &vehicle.effects);
        prop_assert_eq!(&read.a, &vehicle.a);
        // Without the text to continue, everything is written anew, and nothing is lost either.
        let bare = Vehicle { source_text: String::new(), ..vehicle.clone() };
        let written = bare.to_toml();
        let again = Vehicle::parse(&written, &vehicle.name).unwrap_or_else(|e| panic!("{e}\n{written}"));
        prop_assert_eq!(Vehicle { source_text: String::new(), ..again }, bare);
    }
}
