//! Tests of diagnoses of records with a known fault, and of unusable records.

use std::f64::consts::TAU;

use whirlstand_diagnose::{Diagnosis, Options, Verdict, diagnose};
use whirlstand_logs::Record;
use whirlstand_vehicle::{Effect, Free, Kind, Matrix, Target, Vehicle, Window};

use crate::support::{changed, flight, steered_flight, with_gap};

/// The quadrotor without vibration, with white sensor noise.
fn quadrotor() -> Vehicle {
    let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
    vehicle.outputs.iter_mut().for_each(|o| o.vibration = None);
    vehicle
}

fn with(kind: Kind, place: &str, parameters: &[(&str, f64)]) -> Vehicle {
    let mut vehicle = quadrotor();
    vehicle.add_effect(Effect::new(kind, place, parameters).unwrap()).unwrap();
    vehicle
}

fn fly(vehicle: &Vehicle, seed: u64) -> Record {
    flight(vehicle, 30.0, &[0.0; 4], 3.0, Some(seed))
}

fn diagnosis(record: Record) -> Diagnosis {
    diagnose(vec![record], &quadrotor(), &Options::default()).unwrap()
}

#[track_caller]
fn names(answer: &Diagnosis, effect: &str, place: &str) {
    assert_eq!(answer.verdict, Verdict::Explained, "{}", answer.text());
    assert_eq!(answer.causes.len(), 1, "{}", answer.text());
    assert_eq!((answer.causes[0].effect.as_str(), answer.causes[0].place.as_str()), (effect, place));
}

#[track_caller]
fn holds(answer: &Diagnosis, parameter: &str, truth: f64, within: f64) {
    let estimate = &answer.causes[0].parameters[parameter];
    // The tolerance is three times the half width: a test of five seeds must not fail by chance.
    let reach = 1.5 * (estimate.high - estimate.low);
    assert!((estimate.value - truth).abs() <= reach, "{parameter}: {estimate:?}, in truth {truth}");
    assert!((estimate.value / truth - 1.0).abs() < within, "{parameter}: {estimate:?}, in truth {truth}");
}

#[test]
fn a_clean_record_is_consistent() {
    for seed in 1..=3 {
        let answer = diagnosis(fly(&quadrotor(), seed));
        assert_eq!(answer.verdict, Verdict::Consistent, "{}", answer.text());
        assert!(answer.causes.is_empty() && answer.extended.is_none());
    }
}

#[test]
fn a_late_command_and_a_slow_actuator_are_told_apart() {
    let delayed = diagnosis(fly(&with(Kind::InputDelay, "u_roll", &[("delay_s", 0.06)]), 1));
    names(&delayed, "input_delay", "u_roll");
    holds(&delayed, "delay_s", 0.06, 0.05);
    let slow = diagnosis(fly(&with(Kind::ActuatorLag, "u_pitch", &[("time_constant_s", 0.08)]), 2));
    names(&slow, "actuator_lag", "u_pitch");
    holds(&slow, "time_constant_s", 0.08, 0.05);
}

#[test]
fn a_rate_limit_is_found_on_a_stick_that_never_moves_fast() {
    let slow = |t: f64, j: usize| {
        let f = 0.13 + 0.04 * j as f64;
        6.0 * (TAU * f * t).sin() + 3.0 * (TAU * 1.7 * f * t + 1.0).sin()
    };
    for seed in 1..=3 {
        let limited = with(Kind::RateLimit, "u_roll", &[("limit_per_s", 4.0)]);
        let record = steered_flight(&limited, 30.0, &[0.0; 4], Some(seed), slow, |x| vec![0.0; x.len()]);
        let answer = diagnosis(record);
        names(&answer, "rate_limit", "u_roll");
        holds(&answer, "limit_per_s", 4.0, 0.05);
    }
}

/// A limit that begins beyond the commands of its side does not act, and no step of a fit moves it.
#[test]
fn limits_that_lie_unevenly_are_both_found_when_the_stick_does_so_too() {
    let stick = |t: f64, j: usize| {
        let f = 0.23 + 0.11 * j as f64;
        0.5 + 0.8 * (TAU * f * t).sin() + 0.5 * (TAU * 2.3 * f * t + 1.0).sin()
    };
    let limits = [("lower", -0.45), ("upper", 1.3)];
    for seed in 1..=3 {
        let limited = with(Kind::InputSaturation, "u_pitch", &limits);
        let record = steered_flight(&limited, 12.0, &[0.0; 4], Some(seed), stick, |x| vec![0.0; x.len()]);
        let answer = diagnosis(record);
        names(&answer, "input_saturation", "u_pitch");
        limits.iter().for_each(|(limit, truth)| holds(&answer, limit, *truth, 0.1));
    }
}

/// A stick that stays above -0.3 shows the upper limit and nothing of the lower one: that is anywhere below.
#[test]
fn a_limit_that_the_record_does_not_reach_is_anywhere_beyond_it() {
    let stick = |t: f64, j: usize| {
        let f = 0.23 + 0.11 * j as f64;
        0.5 + 0.5 * (TAU * f * t).sin() + 0.3 * (TAU * 2.3 * f * t + 1.0).sin()
    };
    let limited = with(Kind::InputSaturation, "u_pitch", &[("lower", -2.0), ("upper", 0.9)]);
    let record = steered_flight(&limited, 12.0, &[0.0; 4], Some(1), stick, |x| vec![0.0; x.len()]);
    let answer = diagnosis(record);
    names(&answer, "input_saturation", "u_pitch");
    holds(&answer, "upper", 0.9, 0.05);
    let lower = &answer.causes[0].parameters["lower"];
    let file = quadrotor().inputs[quadrotor().input_index("u_pitch").unwrap()].lower;
    assert_eq!(lower.low, file.max(-1e3), "{lower:?}");
    assert!((-0.4..0.1).contains(&lower.high), "{lower:?}");
}

/// Of a push that is over before the vehicle answers only the area is known: what is long and weak is as likely as what
/// is short and strong, and the intervals say so.
#[test]
fn a_push_shorter_than_the_response_is_not_known_better_than_its_area() {
    let mut inside = 0;
    for seed in 1..=5 {
        let push = [("at_s", 12.0), ("magnitude", 3.0), ("duration_s", 0.04)];
        let answer = diagnosis(fly(&with(Kind::PulseDisturbance, "pitch_rate", &push), seed));
        names(&answer, "pulse_disturbance", "pitch_rate");
        let [size, duration] = ["magnitude", "duration_s"].map(|name| &answer.causes[0].parameters[name]);
        let area = size.value * duration.value;
        assert!((area / 0.12 - 1.0).abs() < 0.1, "{area}");
        assert!(duration.low < 0.03 && size.high > 1.2 * size.value, "{duration:?}, {size:?}");
        let both = [(size, 3.0), (duration, 0.04)];
        inside += usize::from(both.iter().all(|(e, truth)| e.low <= *truth && *truth <= e.high));
    }
    assert!(inside >= 4, "{inside} of 5");
}

#[test]
fn a_single_spike_is_no_silent_loss() {
    let record = changed(&fly(&quadrotor(), 21), "pitch_rate", |k, v| if k == 1234 { v + 2.0 } else { v });
    let answer = diagnosis(record);
    let named = answer.causes.iter().any(|c| c.effect == "outliers" && c.place == "pitch_rate");
    let told = answer.data.iter().any(|f| f.kind == "outliers" && f.text.contains("12.340 s"));
    assert!(named || told, "{}", answer.text());
    assert!(answer.causes.iter().all(|c| c.effect == "outliers"), "{}", answer.text());
}

#[test]
fn a_bias_a_tone_and_a_gust_are_found_where_they_are() {
    let biased = diagnosis(fly(&with(Kind::SensorBias, "pitch", &[("offset", 0.01)]), 3));
    names(&biased, "sensor_bias", "pitch");
    holds(&biased, "offset", 0.01, 0.1);
    let tone = [("frequency_hz", 12.3), ("amplitude", 0.01), ("phase_rad", 0.5)];
    let shaken = diagnosis(fly(&with(Kind::Vibration, "roll_rate", &tone), 4));
    names(&shaken, "vibration", "roll_rate");
    holds(&shaken, "frequency_hz", 12.3, 1e-3);
    let gust = [("at_s", 12.0), ("magnitude", 0.3), ("duration_s", 0.5)];
    let pushed = diagnosis(fly(&with(Kind::PulseDisturbance, "pitch_rate", &gust), 5));
    names(&pushed, "pulse_disturbance", "pitch_rate");
    holds(&pushed, "at_s", 12.0, 0.02);
}

#[test]
fn turbulence_is_sized() {
    let stormy =
        diagnosis(fly(&with(Kind::Turbulence, "roll_rate", &[("std", 0.3), ("bandwidth_hz", 1.0)]), 6));
    names(&stormy, "turbulence", "roll_rate");
    holds(&stormy, "std", 0.3, 0.4);
}

#[test]
fn the_transition_between_flight_modes_is_dated() {
    let hover = || {
        let mut vehicle = Vehicle::builtin("helicopter-hover").unwrap();
        vehicle.outputs.iter_mut().for_each(|o| o.vibration = None);
        vehicle
    };
    let mut truth = hover();
    truth.add_effect(Effect::mode_transition(21.0, "helicopter-longitudinal").unwrap()).unwrap();
    let record = flight(&truth, 30.0, &vec![0.0; truth.states.len()], 0.01, Some(7));
    let answer = diagnose(vec![record], &hover(), &Options::default()).unwrap();
    names(&answer, "mode_transition", "vehicle");
    assert_eq!(answer.causes[0].text.as_deref(), Some("helicopter-longitudinal"));
    holds(&answer, "at_s", 21.0, 0.01);
}

#[test]
fn a_flight_in_another_mode_than_the_files_is_told_by_that_modes_name() {
    let still = |name: &str| {
        let mut vehicle = Vehicle::builtin(name).unwrap();
        vehicle.outputs.iter_mut().for_each(|o| o.vibration = None);
        vehicle
    };
    for (mode, seed) in [("helicopter-longitudinal", 9), ("helicopter-lateral", 10)] {
        let flown = still(mode);
        let record = flight(&flown, 30.0, &vec![0.0; flown.states.len()], 0.01, Some(seed));
        let answer = diagnose(vec![record], &still("helicopter-hover"), &Options::default()).unwrap();
        names(&answer, "mode_transition", "vehicle");
        assert_eq!(answer.causes[0].text.as_deref(), Some(mode));
        assert!(answer.causes[0].parameters["at_s"].value < 1.0, "{}", answer.text());
    }
}

#[test]
fn a_tone_that_stops_with_the_engine_is_the_engines() {
    let tone = [("frequency_hz", 17.0), ("amplitude", 0.004), ("phase_rad", 0.0)];
    let shaken = with(Kind::Vibration, "pitch_rate", &tone);
    // On the ground nothing moves: only sensors vibrate.
    let ground = |vehicle: &Vehicle, seed| flight(vehicle, 10.0, &[0.0; 4], 0.0, Some(seed));
    let options = Options {
        engine_on: Some(ground(&shaken, 1)),
        engine_off: Some(ground(&quadrotor(), 2)),
        ..Options::default()
    };
    let answer = diagnose(vec![fly(&shaken, 8)], &quadrotor(), &options).unwrap();
    names(&answer, "vibration", "pitch_rate");
    let notes = answer.causes[0].notes.join(" ");
    assert!(notes.contains("engine"), "{notes}");
}

#[test]
fn several_flights_are_one_question() {
    let late = with(Kind::InputDelay, "u_roll", &[("delay_s", 0.04)]);
    let records = vec![fly(&late, 9), flight(&late, 20.0, &[0.05, 0.0, 0.0, 0.0], 2.0, Some(10))];
    let answer = diagnose(records, &quadrotor(), &Options::default()).unwrap();
    names(&answer, "input_delay", "u_roll");
    holds(&answer, "delay_s", 0.04, 0.05);
}

#[test]
fn the_extended_vehicle_flies_as_the_record_did() {
    let truth = with(Kind::DeadZone, "u_pitch", &[("width", 1.0)]);
    let record = fly(&truth, 11);
    let answer = diagnosis(record.clone());
    names(&answer, "dead_zone", "u_pitch");
    let extended = Vehicle::parse(&answer.extended.unwrap().to_toml(), "extended").unwrap();
    let again = diagnose(vec![record], &extended, &Options::default()).unwrap();
    assert_eq!(again.verdict, Verdict::Consistent, "{}", again.text());
    let simulated = fly(&extended, 12);
    let answer = diagnose(vec![simulated], &truth, &Options::default()).unwrap();
    assert_eq!(answer.verdict, Verdict::Consistent, "{}", answer.text());
}

#[track_caller]
fn says(answer: &Diagnosis, kind: &str, channel: &str) {
    let found = answer.data.iter().any(|d| d.kind == kind && d.place.contains(channel));
    assert!(found, "{kind} of {channel} in {:?}\n{}", answer.data, answer.text());
    assert!(answer.causes.is_empty(), "{}", answer.text());
}

/// Entries of the quadrotor that are free, and their factors in another vehicle of its kind.
const OTHERS: [(Matrix, usize, usize, f64); 6] = [
    (Matrix::A, 1, 0, 1.5),
    (Matrix::A, 1, 1, 1.6),
    (Matrix::B, 1, 0, 0.6),
    (Matrix::A, 3, 2, 0.7),
    (Matrix::A, 3, 3, 1.4),
    (Matrix::B, 3, 1, 0.8),
];

/// A file whose parameters were fitted to some flight, without declared noise.
fn fitted_file() -> Vehicle {
    let mut vehicle = quadrotor();
    vehicle.outputs.iter_mut().for_each(|output| output.noise = 0.0);
    let free = |(matrix, i, j, _)| Free {
        target: Target::Entry(matrix, i, j),
        lower: -2000.0,
        upper: 2000.0,
        start: None,
    };
    vehicle.free = OTHERS.map(free).into();
    vehicle
}

/// What was fitted beside the causes is told, and the extended vehicle has the causes that the answer names.
#[test]
fn parameters_fitted_anew_are_told_and_the_extended_vehicle_is_what_the_answer_says() {
    let given = fitted_file();
    let mut truth = with(Kind::InputDelay, "u_roll", &[("delay_s", 0.06)]);
    for (free, (.., factor)) in given.free.iter().zip(OTHERS) {
        let value = factor * given.free_value(&free.target);
        truth.set_free(&free.target, value).unwrap();
    }
    let options = Options { refit: Some(true), ..Options::default() };
    let answer = diagnose(vec![fly(&truth, 1)], &given, &options).unwrap();
    names(&answer, "input_delay", "u_roll");
    assert_eq!(answer.refitted.len(), OTHERS.len(), "{}", answer.text());
    let extended = answer.extended.as_ref().unwrap();
    for ((refitted, free), (.., factor)) in answer.refitted.iter().zip(&given.free).zip(OTHERS) {
        let ratio = refitted.value / refitted.given / factor;
        assert!((0.9..1.1).contains(&ratio), "{refitted:?}: {factor}\n{}", answer.text());
        assert_eq!(extended.free_value(&free.target), refitted.value);
    }
    assert!(
        answer.text().contains("fitted anew: ") && answer.text().contains("A[2,1] "),
        "{}",
        answer.text()
    );
    let delay = extended.effects.iter().find(|e| e.kind() == Kind::InputDelay).unwrap();
    assert_eq!(delay.parameter("delay_s"), Some(answer.causes[0].parameters["delay_s"].value));
}

/// A file was fitted to one flight, and in the next an actuator is weaker: its fitted values hold, and that is named.
#[test]
fn a_refit_does_not_hide_what_changed_since_the_file_was_fitted() {
    let options = Options { refit: Some(true), ..Options::default() };
    for (kind, place, parameter, value) in [
        (Kind::InputGain, "u_roll", "factor", 0.7),
        (Kind::InputGain, "u_pitch", "factor", 1.3),
        (Kind::InputDelay, "u_pitch", "delay_s", 0.05),
    ] {
        for seed in 1..=3 {
            let truth = with(kind, place, &[(parameter, value)]);
            let answer = diagnose(vec![fly(&truth, seed)], &fitted_file(), &options).unwrap();
            assert_eq!(answer.verdict, Verdict::Explained, "{}", answer.text());
            let [cause] = &answer.causes[..] else { panic!("{}", answer.text()) };
            let alike = cause.indistinguishable.iter().map(|a| (a.effect.as_str(), a.place.as_str()));
            let mut named = alike.chain([(cause.effect.as_str(), cause.place.as_str())]);
            assert!(named.any(|name| name == (kind.name(), place)), "{}", answer.text());
        }
    }
    let unchanged = diagnose(vec![fly(&quadrotor(), 4)], &fitted_file(), &options).unwrap();
    assert_eq!(unchanged.verdict, Verdict::Consistent, "{}", unchanged.text());
}

#[test]
fn wrong_wiring_and_wrong_units_are_told_and_no_cause_is_named() {
    let record = fly(&quadrotor(), 13);
    says(&diagnosis(changed(&record, "roll", |_, v| -v)), "sign", "roll");
    says(&diagnosis(changed(&record, "pitch", |_, v| v.to_degrees())), "unit", "pitch");
    let pitch = record.signal("pitch").unwrap().values.clone();
    let roll = record.signal("roll").unwrap().values.clone();
    let swapped = changed(&changed(&record, "roll", |k, _| pitch[k]), "pitch", |k, _| roll[k]);
    says(&diagnosis(swapped), "swapped", "roll");
}

#[test]
fn gaps_stuck_sensors_and_missing_values_do_no_harm() {
    let record = fly(&quadrotor(), 14);
    let frozen = record.signal("roll_rate").unwrap().values[900];
    says(
        &diagnosis(changed(&record, "roll_rate", |k, v| if (900..1500).contains(&k) { frozen } else { v })),
        "stuck",
        "roll_rate",
    );
    let holes = diagnosis(changed(&record, "pitch", |k, v| if k % 97 < 3 { f64::NAN } else { v }));
    assert_eq!(holes.verdict, Verdict::Consistent, "{}", holes.text());
    let keep = |k: usize| !(1200..1400).contains(&k);
    let mut gap =
        Record::new("gap.csv", (0..record.time.len()).filter(|k| keep(*k)).map(|k| record.time[k]).collect())
            .unwrap();
    for signal in record.signals() {
        let values = (0..record.time.len()).filter(|k| keep(*k)).map(|k| signal.values[k]).collect();
        gap.push(&signal.name, &signal.unit, values).unwrap();
    }
    let answer = diagnosis(gap);
    assert!(answer.causes.is_empty(), "{}", answer.text());
}

#[test]
fn without_excitation_or_length_nothing_is_claimed() {
    let still = diagnosis(flight(&quadrotor(), 30.0, &[0.0; 4], 0.0, Some(15)));
    assert!(still.causes.is_empty(), "{}", still.text());
    assert!(still.data.iter().any(|d| d.kind == "no_excitation"), "{:?}", still.data);
    let short = flight(&quadrotor(), 0.3, &[0.0; 4], 3.0, Some(16));
    let error = diagnose(vec![short], &quadrotor(), &Options::default()).unwrap_err().to_string();
    assert!(error.contains("30") && error.contains("64"), "{error}");
}

#[test]
fn an_effect_of_the_file_acts_when_it_says_in_every_part_of_a_record() {
    let mut known = quadrotor();
    let half = Effect::new(Kind::InputGain, "u_roll", &[("factor", 0.5)]).unwrap();
    known.add_effect(half.during(Window { from_s: Some(25.0), until_s: None }).unwrap()).unwrap();
    let record = with_gap(&flight(&known, 50.0, &[0.0; 4], 3.0, Some(1)), 15.0, 22.0);
    let answer = diagnose(vec![record], &known, &Options::default()).unwrap();
    assert_eq!(answer.verdict, Verdict::Consistent, "{}", answer.text());
}

#[test]
fn the_time_of_a_push_counts_from_the_beginning_of_the_whole_record() {
    let push = [("at_s", 32.0), ("duration_s", 1.0), ("magnitude", 8.0)];
    let whole = flight(&with(Kind::PulseDisturbance, "roll_rate", &push), 50.0, &[0.0; 4], 3.0, Some(1));
    let answer = diagnosis(whole.between(20.0, 50.0));
    names(&answer, "pulse_disturbance", "roll_rate");
    holds(&answer, "at_s", 32.0, 0.01);
}
