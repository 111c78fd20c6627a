//! Tests of random effects against the statistics that their definitions imply, and of closed forms.

use std::f64::consts::TAU;

use whirlstand_vehicle::{Effect, Kind, Vehicle};

use crate::commands::Commands;
use crate::hidden::Hidden;
use crate::motion::{Motion, fly};
use crate::out_of_library::{OutOfLibrary, OutOfLibraryEffect};
use crate::sense::sense;
use crate::truth_model::TruthModel;
use crate::turbulence::Spectrum;

const PERIOD: f64 = 0.01;

fn first_order() -> Vehicle {
    let text = "A = [[-2.0]]\nB = [[3.0]]\nstates = [{ name = \"x\" }]\ninputs = [{ name = \"u\" }]\n\
                outputs = [{ name = \"x\", noise = 0.1 }]\n";
    Vehicle::parse(text, "first order").unwrap()
}

fn hidden(effects: &[Effect]) -> Hidden<'_> {
    Hidden { effects, outside: None, expected: false, spectrum: Spectrum::FirstOrder, trial: 11 }
}

/// The record of a sensor whose input is constantly 1.
fn of_one(effect: Effect, samples: usize) -> Vec<f64> {
    let motion = Motion { samples, states: vec![1.0; samples], sensed: vec![1.0; samples] };
    sense(&first_order(), &motion, None, PERIOD, hidden(&[effect])).unwrap()
}

#[test]
fn outliers_come_as_often_as_they_should_to_both_sides() {
    let n = 100_000;
    let effect = Effect::new(Kind::Outliers, "x", &[("fraction", 0.02), ("magnitude", 5.0)]).unwrap();
    let record = of_one(effect, n);
    let (up, down) =
        (record.iter().filter(|y| **y == 6.0).count(), record.iter().filter(|y| **y == -4.0).count());
    assert_eq!(up + down + record.iter().filter(|y| **y == 1.0).count(), n);
    // 1000 are expected on each side, +- 32 (std).
    assert!(up.abs_diff(1000) < 160 && down.abs_diff(1000) < 160, "{up} {down}");
}

#[test]
fn dropouts_hold_the_sample_before() {
    let n = 100_000;
    let sensed: Vec<f64> = (0..n).map(|k| k as f64).collect();
    let motion = Motion { samples: n, states: sensed.clone(), sensed };
    let effect = Effect::new(Kind::Dropouts, "x", &[("fraction", 0.1)]).unwrap();
    let record = sense(&first_order(), &motion, None, PERIOD, hidden(&[effect])).unwrap();
    let mut dropped = 0;
    for (k, pair) in record.windows(2).enumerate() {
        if pair[1] == pair[0] {
            dropped += 1;
        } else {
            assert_eq!(pair[1], (k + 1) as f64);
        }
    }
    assert!(f64::from(dropped) > 9500.0 && f64::from(dropped) < 10_500.0, "{dropped}");
}

#[test]
fn added_noise_has_its_size() {
    let effect = Effect::new(Kind::Noise, "x", &[("std", 0.3)]).unwrap();
    let record = of_one(effect, 100_000);
    let variance = record.iter().map(|y| (y - 1.0).powi(2)).sum::<f64>() / 1e5;
    assert!((variance / 0.09 - 1.0).abs() < 0.023, "{variance}");
}

#[test]
fn turbulence_moves_a_vehicle_as_its_spectrum_says() {
    // First-order noise through a first-order lag has variance std^2 / (a (a + w)), from the Lyapunov
    // equation.
    let (std, bandwidth, samples) = (0.7, 0.5, 400_000);
    let effect = Effect::new(Kind::Turbulence, "x", &[("std", std), ("bandwidth_hz", bandwidth)]).unwrap();
    let commands = Commands { period_s: PERIOD, inputs: vec![vec![0.0; samples]] };
    let effects = [effect];
    let model = TruthModel::new(&first_order(), &commands, hidden(&effects)).unwrap();
    let motion = fly(&model, &[0.0], PERIOD, samples).unwrap();
    let variance = motion.sensed.iter().map(|x| x * x).sum::<f64>() / samples as f64;
    let expected = std * std / (2.0 * (2.0 + TAU * bandwidth));
    // With 4000 s and a correlation time below 1 s, five standard errors are below 12 %.
    assert!((variance / expected - 1.0).abs() < 0.12, "{variance} {expected}");
}

#[test]
fn a_step_response_is_its_exponential() {
    let samples = 300;
    let commands = Commands { period_s: PERIOD, inputs: vec![vec![1.0; samples]] };
    let delay = [Effect::new(Kind::InputDelay, "u", &[("delay_s", 0.1234)]).unwrap()];
    let model = TruthModel::new(&first_order(), &commands, hidden(&delay)).unwrap();
    let motion = fly(&model, &[0.0], PERIOD, samples).unwrap();
    for (k, x) in motion.sensed.iter().enumerate() {
        let t = (k as f64 * PERIOD - 0.1234).max(0.0);
        assert!((x - 1.5 * (1.0 - (-2.0 * t).exp())).abs() < 1e-10, "{k}");
    }
}

#[test]
fn friction_stops_a_coasting_body_where_it_should() {
    // dx/dt = -2 x - 0.5 from 1 gives x = 1.25 exp(-2 t) - 0.25 until t = ln(5)/2, then rest.
    let samples = 200;
    let commands = Commands { period_s: PERIOD, inputs: vec![vec![0.0; samples]] };
    let friction = [Effect::new(Kind::CoulombFriction, "x", &[("level", 0.5)]).unwrap()];
    let model = TruthModel::new(&first_order(), &commands, hidden(&friction)).unwrap();
    let motion = fly(&model, &[1.0], PERIOD, samples).unwrap();
    for (k, x) in motion.sensed.iter().enumerate() {
        let expected = (1.25 * (-2.0 * k as f64 * PERIOD).exp() - 0.25).max(0.0);
        assert!((x - expected).abs() < 1e-9, "{k} {x} {expected}");
    }
}

#[test]
fn every_effect_outside_the_table_changes_the_record() {
    let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
    vehicle.outputs.iter_mut().for_each(|o| o.vibration = None);
    let samples = 2000;
    let input: Vec<f64> = (0..samples).map(|k| 5.0 * (0.01 * f64::from(k) * 2.0).sin()).collect();
    let commands = Commands { period_s: PERIOD, inputs: vec![input.clone(), input] };
    let record = |outside: Option<&OutOfLibraryEffect>| -> Vec<f64> {
        let hidden =
            Hidden { effects: &[], outside, expected: true, spectrum: Spectrum::FirstOrder, trial: 1 };
        let model = TruthModel::new(&vehicle, &commands, hidden).unwrap();
        let motion = fly(&model, &[0.0; 4], PERIOD, samples as usize).unwrap();
        sense(&vehicle, &motion, None, PERIOD, hidden).unwrap()
    };
    let nominal = record(None);
    for kind in OutOfLibrary::ALL {
        let outside = OutOfLibraryEffect {
            kind,
            input: 0,
            other_input: 1,
            output: 0,
            states: (0, 1),
            onto: 1,
            size: 0.2,
            scale: 0.01,
            dead_time_s: 0.5,
        };
        let changed = record(Some(&outside));
        let most = changed.iter().zip(&nominal).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(most > 1e-5, "{} changes {most}", kind.name());
        assert_eq!(OutOfLibrary::from_name(kind.name()), Some(kind));
    }
}
