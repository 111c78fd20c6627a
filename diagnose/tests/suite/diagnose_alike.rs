//! Tests of effects that resemble simpler ones or combinations: forces that depend on a state, and modes of
//! an actuator.

use std::cell::RefCell;
use std::collections::VecDeque;

use whirlstand_diagnose::{Diagnosis, Verdict};
use whirlstand_logs::Record;
use whirlstand_vehicle::{Effect, Kind, Vehicle};

use crate::support::{diagnosis, flight, named, pushed_flight, steered_flight, stick};

const PERIOD_S: f64 = 0.01;

fn quadrotor() -> Vehicle {
    let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
    vehicle.outputs.iter_mut().for_each(|o| o.vibration = None);
    vehicle
}

/// Kind, place and parameters.
type Fault<'a> = (Kind, &'a str, &'a [(&'a str, f64)]);

fn with(effects: &[Fault<'_>]) -> Vehicle {
    let mut vehicle = quadrotor();
    for (kind, place, parameters) in effects {
        vehicle.add_effect(Effect::new(*kind, place, parameters).unwrap()).unwrap();
    }
    vehicle
}

#[track_caller]
fn is_described(answer: &Diagnosis, like: &str) {
    assert!(answer.causes.is_empty(), "{}", answer.text());
    assert_eq!(answer.verdict, Verdict::Unexplained, "{}", answer.text());
    assert!(answer.unexplained.description.to_lowercase().contains(like), "{like}: {}", answer.text());
}

/// A flight with a delayed relay force on the pitch rate that opposes the pitch.
fn relayed(size: f64, threshold: f64, late_s: f64, seed: u64) -> Record {
    let late = (late_s / PERIOD_S) as usize;
    let (side, waiting) = (RefCell::new(0.0), RefCell::new(VecDeque::from(vec![0.0; late])));
    let push = |x: &[f64]| {
        let mut side = side.borrow_mut();
        if x[2].abs() > threshold {
            *side = -x[2].signum();
        }
        let mut waiting = waiting.borrow_mut();
        waiting.push_back(*side);
        vec![0.0, 0.0, 0.0, size * waiting.pop_front().unwrap()]
    };
    pushed_flight(&quadrotor(), 18.0, &[0.0; 4], 0.3, Some(seed), push)
}

#[test]
fn a_limit_cycle_is_neither_turbulence_nor_a_row_of_pushes() {
    for (seed, size, threshold, late_s) in
        [(31, 0.1, 0.002, 0.5), (32, 0.15, 0.005, 0.37), (33, 0.3, 0.01, 0.23)]
    {
        let answer = diagnosis(relayed(size, threshold, late_s, seed), &quadrotor());
        is_described(&answer, "a force on pitch_rate that switches with pitch");
    }
}

#[test]
fn a_spring_that_goes_in_waves_is_no_turbulence() {
    for (seed, size) in [(34, 0.1), (35, 0.3)] {
        let push = |x: &[f64]| vec![0.0, 0.0, 0.0, size * (40.0 * x[3]).sin()];
        let record = pushed_flight(&quadrotor(), 18.0, &[0.0; 4], 1.0, Some(seed), push);
        is_described(&diagnosis(record, &quadrotor()), "a force on pitch_rate that");
    }
}

/// A mode imitates a gain and a lag together, with an indeterminate damping: it must not displace these
/// causes.
#[test]
fn a_gain_and_a_lag_of_one_input_are_both_named() {
    for (seed, factor, lag) in [(36, 1.05, 0.038), (37, 0.92, 0.034)] {
        let truth = with(&[
            (Kind::ActuatorLag, "u_roll", &[("time_constant_s", lag)]),
            (Kind::InputGain, "u_roll", &[("factor", factor)]),
        ]);
        let answer = diagnosis(flight(&truth, 18.0, &[0.0; 4], 1.0, Some(seed)), &quadrotor());
        let named = named(&answer);
        assert_eq!(named.len(), 2, "seed {seed}: {}", answer.text());
        for truth in ["actuator_lag(u_roll)", "input_gain(u_roll)"] {
            let found = named.iter().any(|names| names.iter().any(|name| name == truth));
            assert!(found, "seed {seed}, {truth}: {}", answer.text());
        }
    }
}

#[test]
fn a_mode_with_a_gain_is_one_cause_where_a_delay_and_a_gain_do_no_better() {
    let mode = [("frequency_hz", 1.07), ("damping_ratio", 0.7), ("gain", 0.93)];
    let truth = with(&[(Kind::UnmodelledMode, "u_roll", &mode)]);
    for seed in [38, 39] {
        let answer = diagnosis(flight(&truth, 18.0, &[0.0; 4], 1.0, Some(seed)), &quadrotor());
        assert_eq!(named(&answer), [["unmodelled_mode(u_roll)"]], "seed {seed}: {}", answer.text());
        for (name, value) in mode {
            let found = &answer.causes[0].parameters[name];
            assert!((found.value / value - 1.0).abs() < 0.3, "{name}: {found:?}");
        }
    }
}

/// A mode of gain 1 is found first, and then a gain beside it: together they are one mode of another gain.
#[test]
fn a_gain_beside_a_mode_of_gain_one_is_a_mode_of_that_gain() {
    let mode = [("frequency_hz", 2.83), ("damping_ratio", 0.04), ("gain", 0.83)];
    let truth = with(&[(Kind::UnmodelledMode, "u_roll", &mode)]);
    for seed in [42, 43] {
        let answer = diagnosis(flight(&truth, 18.0, &[0.0; 4], 1.0, Some(seed)), &quadrotor());
        assert_eq!(named(&answer), [["unmodelled_mode(u_roll)"]], "seed {seed}: {}", answer.text());
        let gain = &answer.causes[0].parameters["gain"];
        assert!(gain.low < 0.83 && 0.83 < gain.high, "{}", answer.text());
    }
}

/// Of a mode above the excited frequencies, the record shows little more than its gain.
#[test]
fn a_fast_mode_is_listed_beside_the_gain_that_it_looks_like() {
    let mode = [("frequency_hz", 6.0), ("damping_ratio", 0.1), ("gain", 1.06)];
    let truth = with(&[(Kind::UnmodelledMode, "u_roll", &mode)]);
    for seed in [40, 41] {
        let answer = diagnosis(flight(&truth, 18.0, &[0.0; 4], 0.3, Some(seed)), &quadrotor());
        let named = named(&answer);
        assert_eq!(named.len(), 1, "seed {seed}: {}", answer.text());
        assert!(named[0].contains(&"unmodelled_mode(u_roll)".into()), "seed {seed}: {}", answer.text());
    }
}

/// The sole cause or one that the record does not distinguish from it.
#[track_caller]
fn is_named(answer: &Diagnosis, cause: &str) {
    let all = named(answer);
    assert!(all.len() == 1 && all[0].iter().any(|name| name == cause), "{cause}: {}", answer.text());
}

/// Onto an input that the record does not move, no more than a thousandth of a command was taken to be possible: the
/// coupling was a changed entry of B alone.
#[test]
fn a_coupling_onto_an_input_at_rest_is_named() {
    let truth = with(&[(Kind::InputCoupling, "u_roll->u_pitch", &[("coefficient", -0.07)])]);
    for seed in [5, 6] {
        let steer = |t: f64, j: usize| if j == 0 { 3.0 * stick(t, j) } else { 0.0 };
        let record = steered_flight(&truth, 20.0, &[0.0; 4], Some(seed), steer, |x| vec![0.0; x.len()]);
        is_named(&diagnosis(record, &quadrotor()), "input_coupling(u_roll->u_pitch)");
    }
}
