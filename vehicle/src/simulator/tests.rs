//! Effects in the simulator, against SciPy's solution of their definitions and against closed forms.

use std::f64::consts::TAU;

use nalgebra::DMatrix;
use serde_json::Value;

use crate::discretise::discretise;
use crate::effects::{Effect, Kind};
use crate::model::{Engine, Vehicle};
use crate::simulator::Simulator;

const PERIOD: f64 = 0.01;

/// Kind, place and parameters of an effect.
type Extra<'a> = (Kind, &'a str, &'a [(&'a str, f64)]);

/// A double integrator with a position and a velocity sensor, and nothing else.
fn cart() -> Vehicle {
    let text = r#"
        A = [[0.0, 1.0], [0.0, 0.0]]
        B = [[0.0], [1.0]]
        states = [{ name = "p", unit = "m" }, { name = "v", unit = "m/s" }]
        inputs = [{ name = "u" }]
    "#;
    Vehicle::parse(text, "cart").unwrap()
}

fn with(mut vehicle: Vehicle, effects: &[Extra<'_>]) -> Vehicle {
    for (kind, place, parameters) in effects {
        vehicle.add_effect(Effect::new(*kind, place, parameters).unwrap()).unwrap();
    }
    vehicle
}

/// Measured output `index` over `steps` steps with the input at rest.
fn measured(vehicle: &Vehicle, start: &[f64], index: usize, steps: usize) -> Vec<f64> {
    let mut simulator = Simulator::new(vehicle, PERIOD, 1).unwrap();
    simulator.set_state(start);
    (0..steps)
        .map(|_| {
            simulator.apply(&vec![0.0; vehicle.inputs.len()]);
            let y = simulator.measure()[index];
            simulator.advance();
            y
        })
        .collect()
}

#[test]
fn effects_are_scipys_solution_of_their_definitions() {
    let table: Value = serde_json::from_str(include_str!("../../reference/effects.json")).unwrap();
    let rows = |v: &Value| -> Vec<Vec<f64>> {
        let row = |r: &Value| r.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
        v.as_array().unwrap().iter().map(row).collect()
    };
    let text = format!(
        "A = {}\nB = {}\nC = {}\nD = {}\n{}",
        table["A"],
        table["B"],
        table["C"],
        table["D"],
        r#"
        states = [{ name = "p" }, { name = "v" }]
        inputs = [{ name = "u1" }, { name = "u2" }]
        outputs = [{ name = "p" }, { name = "v" }, { name = "a" }]
        "#
    );
    let plant = Vehicle::parse(&text, "plant").unwrap();
    let (inputs, start) = (rows(&table["u"]), rows(&Value::Array(vec![table["x0"].clone()])).remove(0));
    let cases = table["cases"].as_array().unwrap();
    assert!(cases.len() >= 28);
    let mut failed = Vec::new();
    for case in cases {
        let mut vehicle = plant.clone();
        for effect in case["effects"].as_array().unwrap() {
            vehicle.add_effect(serde_json::from_value(effect.clone()).unwrap()).unwrap();
        }
        let mut simulator = Simulator::new(&vehicle, table["period_s"].as_f64().unwrap(), 1).unwrap();
        simulator.set_state(&start);
        let (mut worst, mut compared) = (0f64, 0);
        for (u, expected) in inputs.iter().zip(case["y"].as_array().unwrap()) {
            simulator.apply(u);
            let y = simulator.measure();
            for (y, expected) in y.iter().zip(expected.as_array().into_iter().flatten()) {
                if let Some(expected) = expected.as_f64() {
                    worst = worst.max((y - expected).abs());
                    compared += 1;
                }
            }
            simulator.advance();
        }
        let tolerance = case["tolerance"].as_f64().unwrap();
        println!("{:9.1e} of {tolerance:7.0e}  {}", worst, case["effects"]);
        if compared < 110 || worst > tolerance {
            failed.push(format!("{}: {worst:e} > {tolerance:e}", case["effects"]));
        }
    }
    assert!(failed.is_empty(), "{}", failed.join("\n"));
}

#[test]
fn friction_holds_what_it_can_hold_and_no_more() {
    let held = with(cart(), &[(Kind::CoulombFriction, "v", &[("level", 0.5)])]);
    let mut simulator = Simulator::new(&held, PERIOD, 1).unwrap();
    for _ in 0..100 {
        simulator.step(&[0.499]);
    }
    assert_eq!(simulator.state()[1], 0.0);
    assert!(simulator.state()[0].abs() < 1e-15);
    for _ in 0..100 {
        simulator.step(&[0.7]);
    }
    assert!((simulator.state()[1] - 0.2).abs() < 1e-9);
    // Down from 0.2 at (0.5 + 0.1) per second: at rest after a third of a second, and it stays there.
    for _ in 0..50 {
        simulator.step(&[-0.1]);
    }
    assert_eq!(simulator.state()[1], 0.0);
    let travelled = 0.5 * 0.2 * 1.0 + 0.5 * 0.2 * (0.2 / 0.6);
    assert!((simulator.state()[0] - travelled).abs() < 1e-5, "{}", simulator.state()[0]);
}

#[test]
fn a_mode_transition_continues_with_the_other_matrices() {
    let mut vehicle = Vehicle::builtin("helicopter-hover").unwrap();
    let next = Vehicle::builtin("helicopter-longitudinal").unwrap();
    let start = [0.1, 0.0, -0.05, 0.1, 1.0, 0.5, 0.0, 0.0];
    let u = [2.0, -1.0];
    for at_s in [0.4, 0.4137] {
        vehicle.effects.clear();
        vehicle.add_effect(Effect::mode_transition(at_s, "helicopter-longitudinal").unwrap()).unwrap();
        let mut simulator = Simulator::new(&vehicle, PERIOD, 1).unwrap();
        simulator.set_state(&start);
        for _ in 0..100 {
            simulator.step(&u);
        }
        let column = |v: &[f64]| DMatrix::from_column_slice(v.len(), 1, v);
        let (phi, gamma) = discretise(&vehicle.a, &vehicle.b, at_s).unwrap();
        let middle = phi * column(&start) + gamma * column(&u);
        let (phi, gamma) = discretise(&next.a, &next.b, 1.0 - at_s).unwrap();
        let end = phi * middle + gamma * column(&u);
        for (x, expected) in simulator.state().iter().zip(end.iter()) {
            assert!((x - expected).abs() < 1e-11 * (1.0 + expected.abs()), "{at_s}: {x} {expected}");
        }
    }
    let error =
        vehicle.add_effect(Effect::mode_transition(1.0, "quadrotor").unwrap()).unwrap_err().to_string();
    assert!(error.contains("has different states"), "{error}");
}

#[test]
fn deterministic_sensor_effects_are_their_formulas() {
    let start = [2.003, 0.5];
    let motion = |k: usize| 2.003 + 0.5 * PERIOD * k as f64;
    let check = |effects: &[Extra<'_>], formula: &dyn Fn(f64, f64) -> f64| {
        let y = measured(&with(cart(), effects), &start, 0, 200);
        for (k, y) in y.iter().enumerate() {
            let expected = formula(motion(k), PERIOD * k as f64);
            assert!((y - expected).abs() < 1e-11, "{effects:?} at {k}: {y} {expected}");
        }
    };
    check(&[(Kind::SensorBias, "p", &[("offset", 0.3)])], &|y, _| y + 0.3);
    check(&[(Kind::SensorDrift, "p", &[("rate_per_s", -0.02)])], &|y, t| y - 0.02 * t);
    check(&[(Kind::SensorScale, "p", &[("factor", 1.1)])], &|y, _| 1.1 * y);
    let tone: &[(&str, f64)] = &[("frequency_hz", 7.3), ("amplitude", 0.2), ("phase_rad", 0.4)];
    check(&[(Kind::Vibration, "p", tone)], &|y, t| y + 0.2 * (TAU * 7.3 * t + 0.4).sin());
    check(&[(Kind::Quantization, "p", &[("step", 0.25)])], &|y, _| (y / 0.25).round() * 0.25);
    check(&[(Kind::OutputSaturation, "p", &[("lower", 2.1), ("upper", 2.6)])], &|y, _| y.clamp(2.1, 2.6));
    // Order: scale, bias, drift, rounding, limits, whatever the order in the file.
    check(
        &[
            (Kind::OutputSaturation, "p", &[("lower", -9.0), ("upper", 2.3)]),
            (Kind::Quantization, "p", &[("step", 0.1)]),
            (Kind::SensorDrift, "p", &[("rate_per_s", 0.03)]),
            (Kind::SensorBias, "p", &[("offset", -0.4)]),
            (Kind::SensorScale, "p", &[("factor", 1.2)]),
        ],
        &|y, t| (((1.2 * y - 0.4 + 0.03 * t) / 0.1).round() * 0.1).min(2.3),
    );
}

#[test]
fn misalignment_turns_angles_and_their_rates() {
    let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
    for output in &mut vehicle.outputs {
        (output.noise, output.vibration) = (0.0, None);
    }
    let turned = with(vehicle, &[(Kind::Misalignment, "roll,pitch", &[("angle_rad", 0.3)])]);
    let mut simulator = Simulator::new(&turned, PERIOD, 1).unwrap();
    let x = [0.1, 0.7, -0.2, 0.4];
    simulator.set_state(&x);
    let (s, c) = 0.3f64.sin_cos();
    let expected = [c * x[0] + s * x[2], c * x[1] + s * x[3], c * x[2] - s * x[0], c * x[3] - s * x[1]];
    for (y, expected) in simulator.measure().iter().zip(expected) {
        assert!((y - expected).abs() < 1e-15);
    }
}

#[test]
fn noise_has_its_deviation_and_adds_to_the_declared() {
    let mut vehicle = cart();
    vehicle.outputs[0].noise = 0.03;
    let vehicle = with(vehicle, &[(Kind::Noise, "p", &[("std", 0.04)])]);
    let n = 100_000;
    let y = measured(&vehicle, &[0.0, 0.0], 0, n);
    let variance = y.iter().map(|v| v * v).sum::<f64>() / n as f64;
    // Five standard errors of a variance: 5 sqrt(2/n).
    assert!((variance / 0.0025 - 1.0).abs() < 5.0 * (2.0 / n as f64).sqrt(), "{variance}");
}

#[test]
fn dropouts_repeat_and_outliers_jump() {
    let n = 100_000;
    let bound = |p: f64| 5.0 * (p * (1.0 - p) / n as f64).sqrt();
    let dropped = with(cart(), &[(Kind::Dropouts, "p", &[("fraction", 0.2)])]);
    let y = measured(&dropped, &[0.0, 1.0], 0, n);
    let repeated = y.windows(2).filter(|w| w[0] == w[1]).count() as f64 / n as f64;
    assert!((repeated - 0.2).abs() < bound(0.2), "{repeated}");
    let jumping = with(cart(), &[(Kind::Outliers, "p", &[("fraction", 0.05), ("magnitude", 3.0)])]);
    let y = measured(&jumping, &[0.0, 0.0], 0, n);
    let share = |value: f64| y.iter().filter(|v| **v == value).count() as f64 / n as f64;
    assert!((share(3.0) - 0.025).abs() < bound(0.025) && (share(-3.0) - 0.025).abs() < bound(0.025));
    assert!((share(3.0) + share(-3.0) + share(0.0) - 1.0).abs() < 1e-12);
}

#[test]
fn turbulence_acts_and_is_published() {
    let vehicle = with(cart(), &[(Kind::Turbulence, "v", &[("std", 0.5), ("bandwidth_hz", 2.0)])]);
    let mut simulator = Simulator::new(&vehicle, PERIOD, 4).unwrap();
    let mut speed = 0.0;
    for _ in 0..1000 {
        speed += PERIOD * simulator.disturbance()[1];
        simulator.step(&[0.0]);
        assert!((simulator.state()[1] - speed).abs() < 1e-12);
    }
    assert!(speed != 0.0);
    let mut calm = Simulator::expected(&vehicle, PERIOD).unwrap();
    calm.step(&[0.0]);
    assert_eq!(calm.state(), [0.0, 0.0]);
}

#[test]
fn vibration_follows_the_engine() {
    let mut vehicle = Vehicle::builtin("helicopter-hover").unwrap();
    for output in &mut vehicle.outputs {
        output.noise = 0.0;
    }
    let declared = vehicle.outputs[0].vibration.clone().unwrap();
    let mut simulator = Simulator::new(&vehicle, PERIOD, 1).unwrap();
    for engine in [Engine::Off, Engine::On, Engine::Flying] {
        simulator.set_engine(engine);
        for _ in 0..50 {
            let t = simulator.time_s();
            let expected: f64 = declared
                .harmonics
                .iter()
                .zip(1u32..)
                .map(|(r, h)| {
                    r * (f64::from(h) * (TAU * declared.frequency_hz * t + declared.phase_rad)).sin()
                })
                .sum();
            let y = simulator.measure()[0];
            assert!((y - declared.amplitude(engine) * expected).abs() < 1e-14);
            simulator.step(&[0.0, 0.0]);
        }
    }
}

#[test]
fn a_divider_repeats_stale_values() {
    let mut vehicle = cart();
    vehicle.outputs[0].every = 3;
    let mut simulator = Simulator::new(&vehicle, PERIOD, 1).unwrap();
    simulator.set_state(&[0.0, 1.0]);
    for k in 0..30u32 {
        let position = simulator.measure()[0];
        assert_eq!(simulator.fresh(), [k % 3 == 0, true]);
        assert!((position - f64::from(k / 3 * 3) * PERIOD).abs() < 1e-12);
        simulator.step(&[0.0]);
    }
}

#[test]
fn one_more_sensor_leaves_the_noise_of_others_as_it_is() {
    let mut few = cart();
    few.outputs[0].noise = 0.1;
    let text = few.to_toml() + "\n[[outputs]]\nname = \"p\"\nnoise = 0.1\n";
    let both = text.clone() + "\n[[outputs]]\nname = \"v\"\nnoise = 0.2\n";
    let strip = |text: &str| {
        let end = text.find("\n[[outputs]]").unwrap();
        text[..end].to_string()
    };
    let head = strip(&few.to_toml());
    let one = Vehicle::parse(&(head.clone() + &text[few.to_toml().len()..]), "one").unwrap();
    let two = Vehicle::parse(&(head + &both[few.to_toml().len()..]), "two").unwrap();
    assert_eq!((one.outputs.len(), two.outputs.len()), (1, 2));
    assert_eq!(measured(&one, &[0.0, 0.0], 0, 50), measured(&two, &[0.0, 0.0], 0, 50));
    let noisier = with(
        two,
        &[
            (Kind::Noise, "v", &[("std", 1.0)]),
            (Kind::Outliers, "v", &[("fraction", 0.5), ("magnitude", 1.0)]),
        ],
    );
    assert_eq!(measured(&one, &[0.0, 0.0], 0, 50), measured(&noisier, &[0.0, 0.0], 0, 50));
}

#[test]
fn commands_never_pass_the_limits() {
    let mut vehicle = cart();
    (vehicle.inputs[0].lower, vehicle.inputs[0].upper) = (-1.0, 2.0);
    let mut simulator = Simulator::new(&vehicle, PERIOD, 1).unwrap();
    for (u, applied, at_limit) in [
        (0.5, 0.5, false),
        (f64::NAN, 0.5, false),
        (f64::INFINITY, 2.0, true),
        (f64::NEG_INFINITY, -1.0, true),
        (f64::NAN, -1.0, true),
        (-3.0, -1.0, true),
        (0.0, 0.0, false),
    ] {
        simulator.step(&[u]);
        assert_eq!(simulator.applied(), [applied]);
        assert_eq!(simulator.saturated(), at_limit);
    }
    vehicle.inputs[0].rate_limit = 10.0;
    let mut slow = Simulator::new(&vehicle, PERIOD, 1).unwrap();
    let mut last = 0.0;
    for _ in 0..40 {
        slow.step(&[2.0]);
        assert!(slow.applied()[0] - last <= 0.1 + 1e-15);
        last = slow.applied()[0];
    }
    assert_eq!(last, 2.0);
}

#[test]
fn a_disturbance_from_outside_acts_until_it_is_taken_back() {
    for vehicle in [cart(), with(cart(), &[(Kind::InputDelay, "u", &[("delay_s", 0.013)])])] {
        let mut simulator = Simulator::new(&vehicle, PERIOD, 1).unwrap();
        simulator.disturb(&[0.0, 2.0]);
        assert_eq!(simulator.disturbance(), [0.0, 2.0]);
        for _ in 0..100 {
            simulator.step(&[0.0]);
        }
        simulator.disturb(&[0.0, 0.0]);
        for _ in 0..100 {
            simulator.step(&[0.0]);
        }
        assert!((simulator.state()[1] - 2.0).abs() < 1e-12);
        assert!((simulator.state()[0] - 3.0).abs() < 1e-12);
    }
}

#[test]
fn a_record_from_the_middle_of_a_motion_holds_its_first_command() {
    let late = [
        (Kind::InputDelay, "u", &[("delay_s", 0.025)] as &[(&str, f64)]),
        (Kind::ActuatorLag, "u", &[("time_constant_s", 0.1)]),
        (Kind::Backlash, "u", &[("width", 0.2)]),
    ];
    let speeds = |mut simulator: Simulator| -> Vec<f64> {
        let step = |_| {
            simulator.step(&[2.0]);
            simulator.state()[1]
        };
        (0..50).map(step).collect()
    };
    // The command was 2 before and stays: the force is constant, with the backlash taken up.
    let vehicle = with(cart(), &late);
    let held = speeds(Simulator::expected_from(&vehicle, PERIOD, &[2.0]).unwrap());
    let mut again = Simulator::expected_from(&vehicle, PERIOD, &[-1.0]).unwrap();
    again.rest_at(&[2.0]);
    assert_eq!(held, speeds(again));
    let force = held[0] / PERIOD;
    assert!((1.85..=2.0).contains(&force), "{force}");
    for (k, v) in held.iter().enumerate() {
        assert!((v - force * PERIOD * (k + 1) as f64).abs() < 1e-9, "{k}: {v}");
    }
    // From rest, nothing acts at first; a command that is not finite stands for rest.
    let rest = speeds(Simulator::expected(&vehicle, PERIOD).unwrap());
    assert_eq!(rest[..2], [0.0, 0.0]);
    assert_eq!(rest, speeds(Simulator::expected_from(&vehicle, PERIOD, &[f64::NAN]).unwrap()));
}
