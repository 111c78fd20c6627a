//! The mirror beside flights in closed loop.

use allocation_counter::measure;
use whirlstand_mirror::{Finding, Mirror, Options, Sample, Stage};
use whirlstand_vehicle::{Effect, Engine, Kind, Vehicle, builtin_names};

use crate::support::Flight;

const PERIOD_S: f64 = 0.005;

fn mirror(vehicle: &Vehicle) -> Mirror {
    Mirror::new(vehicle, PERIOD_S, &Options::new(Engine::Flying, false, PERIOD_S)).unwrap()
}

fn fly(vehicle: &Vehicle, seed: u64, seconds: f64, effect: Option<(&Effect, u64)>) -> Vec<Finding> {
    let mut flight = Flight::new(vehicle, PERIOD_S, seed, effect);
    let mut mirror = mirror(vehicle);
    let steps = (seconds / PERIOD_S) as u64;
    (0..steps)
        .filter_map(|_| {
            flight.fly();
            mirror.observe(&flight.sample())
        })
        .collect()
}

#[test]
fn an_hour_of_clean_flight_has_no_finding() {
    for name in builtin_names() {
        let findings = fly(&Vehicle::builtin(name).unwrap(), 1, 3600.0, None);
        assert!(findings.is_empty(), "{name}: {findings:?}");
    }
}

#[test]
fn a_change_is_told_then_named_with_its_size() {
    let vehicle = Vehicle::builtin("quadrotor").unwrap();
    let rate = vehicle.outputs[vehicle.output_index("roll_rate").unwrap()].noise;
    for (kind, place, parameter, value) in [
        (Kind::InputGain, "u_roll", "factor", 0.7),
        (Kind::InputDelay, "u_pitch", "delay_s", 0.06),
        (Kind::SensorBias, "pitch", "offset", 0.005),
        (Kind::Noise, "roll_rate", "std", 2.5 * rate),
        (Kind::CoulombFriction, "pitch_rate", "level", 0.1),
    ] {
        let effect = Effect::new(kind, place, &[(parameter, value)]).unwrap();
        let onset = 2000;
        let findings = fly(&vehicle, 3, 20.0, Some((&effect, onset)));
        let first = findings.first().unwrap_or_else(|| panic!("{kind}: nothing was found"));
        assert_eq!(first.stage, Stage::Wrong, "{kind}");
        assert!((onset..onset + 600).contains(&first.step), "{kind}: told at step {}", first.step);
        let cause =
            findings.iter().rev().find_map(|f| f.cause.as_ref()).unwrap_or_else(|| panic!("{kind}: no name"));
        assert_eq!((cause.effect.kind(), cause.effect.place()), (kind, place), "{findings:#?}");
        let told = cause.values[0];
        assert!(told.low < told.value && told.value < told.high, "{kind}: {told:?}");
        // What is told after a hundred samples is known no better than its interval says: half of it is two standard deviations.
        let (error, half) = ((told.value - value).abs(), 0.5 * (told.high - told.low));
        let is_known = half < 0.25 * value.abs() && error < 1.5 * half;
        assert!(is_known || error < 0.1 * value.abs(), "{kind}: {told:?}, not {value}");
    }
}

#[test]
fn what_remembers_its_input_is_named_whatever_moment_its_begin_is_taken_for() {
    let vehicle = Vehicle::builtin("quadrotor").unwrap();
    // Prediction becomes wrong with the setpoint after the begin, when the input has moved far.
    for (kind, place, parameter, value, onset, seed) in [
        (Kind::ActuatorLag, "u_roll", "time_constant_s", 0.0766, 2130, 91_000_013),
        (Kind::ActuatorLag, "u_roll", "time_constant_s", 0.1924, 1841, 91_000_002),
        (Kind::ActuatorLag, "u_pitch", "time_constant_s", 0.1204, 2004, 91_000_018),
        (Kind::ActuatorLag, "u_roll", "time_constant_s", 0.0392, 2481, 91_000_022),
    ] {
        let effect = Effect::new(kind, place, &[(parameter, value)]).unwrap();
        let findings = fly(&vehicle, seed, PERIOD_S * (onset + 2000) as f64, Some((&effect, onset)));
        let last = findings.iter().rfind(|f| f.stage != Stage::Over).and_then(|f| f.cause.as_ref());
        let cause = last.unwrap_or_else(|| panic!("{kind} {value}: no name: {findings:#?}"));
        assert_eq!((cause.effect.kind(), cause.effect.place()), (kind, place), "{findings:#?}");
        assert!((cause.values[0].value / value - 1.0).abs() < 0.03, "{kind}: {:?}", cause.values);
    }
}

#[test]
fn a_gap_in_the_measurements_is_no_change() {
    let vehicle = Vehicle::builtin("quadrotor").unwrap();
    let mut flight = Flight::new(&vehicle, PERIOD_S, 5, None);
    let mut mirror = mirror(&vehicle);
    for step in 0..12_000u64 {
        flight.fly();
        // Single steps and a whole second are missing now and then, and single sensors have nothing new.
        let missing = step % 977 == 0 || (6000..6200).contains(&step);
        let fresh = if step % 31 == 0 { flight.fresh & 5 } else { flight.fresh };
        let sample = Sample { fresh, ..flight.sample() };
        let finding = if missing { None } else { mirror.observe(&sample) };
        assert_eq!(finding, None, "step {step}");
    }
}

#[test]
fn a_cause_is_named_although_the_data_after_its_onset_say_more_than_one_thing() {
    let vehicle = Vehicle::builtin("quadrotor").unwrap();
    let effect = Effect::new(Kind::InputGain, "u_roll", &[("factor", 0.7)]).unwrap();
    let mut flight = Flight::new(&vehicle, PERIOD_S, 7, Some((&effect, 2000)));
    let mut mirror = mirror(&vehicle);
    let mut findings = Vec::new();
    for step in 0..12_000u64 {
        flight.fly();
        // Something passes that no single effect of the table explains: a gyroscope that is wrong to and fro.
        if (2050..2100).contains(&step) {
            flight.y[3] += [0.2, -0.3, 0.5, -0.1, 0.4][step as usize % 5];
            flight.y[0] -= [0.01, 0.0, 0.03][step as usize % 3];
        }
        findings.extend(mirror.observe(&flight.sample()));
    }
    let cause = findings.iter().rev().find_map(|f| f.cause.as_ref());
    let cause = cause.unwrap_or_else(|| panic!("no name: {findings:#?}"));
    assert_eq!((cause.effect.kind(), cause.effect.place()), (Kind::InputGain, "u_roll"), "{findings:#?}");
    assert!((cause.values[0].value - 0.7).abs() < 0.02, "{:?}", cause.values);
    assert!(findings.iter().all(|f| f.number == 1), "{findings:#?}");
}

#[test]
fn what_is_over_is_told_and_nothing_is_allocated_while_nothing_changes() {
    let vehicle = Vehicle::builtin("quadrotor").unwrap();
    let mut flight = Flight::new(&vehicle, PERIOD_S, 9, None);
    let mut mirror = mirror(&vehicle);
    let mut stages = Vec::new();
    let mut allocated = 0;
    for step in 0..8000u64 {
        flight.fly();
        // A sensor is askew for three seconds.
        let askew = if (2000..2600).contains(&step) { 0.01 } else { 0.0 };
        flight.y[0] += askew;
        let sample = flight.sample();
        let mut finding = None;
        let counted = measure(|| finding = mirror.observe(&sample));
        if step < 1990 {
            allocated += counted.count_total;
        }
        stages.extend(finding.map(|f| f.stage));
    }
    assert_eq!(allocated, 0);
    assert_eq!((stages.first(), stages.last()), (Some(&Stage::Wrong), Some(&Stage::Over)), "{stages:?}");
}
