//! Tests of the screening before the search: columns in a wrong unit, and records of another vehicle.

use whirlstand_diagnose::data::record::Data;
use whirlstand_diagnose::{Options, Verdict, diagnose, screen};
use whirlstand_logs::Record;
use whirlstand_test_harness::noise;
use whirlstand_vehicle::{Effect, Kind, Vehicle};

use crate::support::{changed, flight};

/// The quadrotor without vibration, with white sensor noise.
fn quadrotor() -> Vehicle {
    let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
    vehicle.outputs.iter_mut().for_each(|o| o.vibration = None);
    vehicle
}

fn scaled(record: &Record, channels: &[&str], ratio: f64) -> Record {
    channels.iter().fold(record.clone(), |record, channel| changed(&record, channel, |_, v| ratio * v))
}

const OUTPUTS: [&str; 4] = ["roll", "roll_rate", "pitch", "pitch_rate"];
const INPUTS: [&str; 2] = ["u_roll", "u_pitch"];

#[test]
fn every_ratio_of_units_is_told_on_every_column() {
    let record = flight(&quadrotor(), 30.0, &[0.0; 4], 3.0, Some(3));
    let alone: Vec<Vec<&str>> = OUTPUTS.iter().chain(&INPUTS).map(|name| vec![*name]).collect();
    let together =
        [OUTPUTS.to_vec(), INPUTS.to_vec(), vec!["roll", "pitch"], vec!["roll_rate", "pitch_rate"]];
    for ratio in [180.0 / std::f64::consts::PI, 9.80665, 1000.0, 3.6] {
        for ratio in [ratio, 1.0 / ratio] {
            for columns in alone.iter().chain(&together) {
                let record = scaled(&record, columns, ratio);
                let found = screen::wrong_units(&[record], &quadrotor(), None).unwrap();
                let told: Vec<(&str, &str)> =
                    found.iter().map(|f| (f.kind.as_str(), f.place.as_str())).collect();
                assert_eq!(told, [("unit", columns.join(",").as_str())], "{ratio}: {found:?}");
            }
        }
    }
}

/// A single column, or an angle with its rate, whose axis points the other way.
#[test]
fn a_turned_sign_is_told_on_every_column() {
    for seed in 0..4 {
        let record = flight(&quadrotor(), 30.0, &[0.0; 4], 3.0, Some(seed));
        let alone = OUTPUTS.iter().chain(&INPUTS).map(|name| vec![*name]);
        for columns in alone.chain([vec!["roll", "roll_rate"], vec!["pitch", "pitch_rate"]]) {
            let record = scaled(&record, &columns, -1.0);
            let answer = diagnose(vec![record], &quadrotor(), &Options::default()).unwrap();
            let told: Vec<(&str, &str)> =
                answer.data.iter().map(|f| (f.kind.as_str(), f.place.as_str())).collect();
            assert_eq!(told, [("sign", columns.join(",").as_str())], "{}", answer.text());
            assert_eq!(answer.verdict, Verdict::Inconclusive, "{}", answer.text());
            for column in columns {
                assert!(answer.summary.contains(&format!("--map {column}=-{column}")), "{}", answer.summary);
            }
        }
    }
}

#[test]
fn a_wrong_unit_ends_the_diagnosis_and_says_what_to_write() {
    let record = flight(&quadrotor(), 30.0, &[0.0; 4], 3.0, Some(4));
    for (columns, says) in
        [(&OUTPUTS[..], "--map pitch_rate=pitch_rate[deg/s]"), (&INPUTS[..], "input_gain of 0.0175")]
    {
        let record = scaled(&record, columns, 180.0 / std::f64::consts::PI);
        let answer = diagnose(vec![record], &quadrotor(), &Options::default()).unwrap();
        assert_eq!(answer.verdict, Verdict::Inconclusive, "{}", answer.text());
        assert!(answer.causes.is_empty(), "{}", answer.text());
        assert!(
            answer.summary.contains("57.3 times too large") && answer.summary.contains(says),
            "{}",
            answer.summary
        );
    }
}

/// Kind of effect, place and parameters.
type Fault = (Kind, &'static str, &'static [(&'static str, f64)]);

#[test]
fn a_strong_fault_is_no_unit_and_no_other_vehicle() {
    let faults: [Fault; 8] = [
        (Kind::InputDelay, "u_roll", &[("delay_s", 0.15)]),
        (Kind::ActuatorLag, "u_roll", &[("time_constant_s", 0.2)]),
        (Kind::InputGain, "u_roll", &[("factor", 0.3)]),
        (Kind::InputGain, "u_pitch", &[("factor", 1.7)]),
        (Kind::InputGain, "u_pitch", &[("factor", 0.0)]),
        (Kind::SensorScale, "roll", &[("factor", 0.3)]),
        (Kind::SensorScale, "pitch_rate", &[("factor", 1.7)]),
        (Kind::SensorScale, "pitch_rate", &[("factor", 0.0)]),
    ];
    for seed in 0..4 {
        for (kind, place, parameters) in &faults {
            let mut truth = quadrotor();
            truth.add_effect(Effect::new(*kind, place, parameters).unwrap()).unwrap();
            let record = [flight(&truth, 30.0, &[0.0; 4], 3.0, Some(seed))];
            let units = screen::wrong_units(&record, &quadrotor(), None).unwrap();
            let stranger = screen::stranger(&record, &quadrotor(), &[], None).unwrap();
            assert!(
                units.is_empty() && stranger.is_none(),
                "{kind:?} {parameters:?}: {units:?} {stranger:?}"
            );
        }
    }
}

/// A wrong vehicle has many wrong gains, one of which may be near a ratio of units by chance.
#[test]
fn the_record_of_another_vehicle_is_no_unit() {
    let helicopters = ["helicopter-hover", "helicopter-lateral", "helicopter-longitudinal"];
    for seed in 0..4 {
        for flown in helicopters {
            let vehicle = Vehicle::builtin(flown).unwrap();
            let record = [flight(&vehicle, 60.0, &[0.0; 8], 2.0, Some(seed))];
            for assumed in helicopters.into_iter().filter(|name| *name != flown) {
                let units = screen::wrong_units(&record, &Vehicle::builtin(assumed).unwrap(), None).unwrap();
                assert!(units.is_empty(), "{flown} read as {assumed}: {units:?}");
            }
        }
    }
}

/// Products of several unit ratios come near any number: 30 is near 9.81 times 3.6.
#[test]
fn a_gain_that_no_unit_has_is_no_pair_of_units() {
    for (factor, seed) in [(30.0, 1), (6.0, 2), (0.045, 3)] {
        let mut truth = quadrotor();
        truth.add_effect(Effect::new(Kind::InputGain, "u_roll", &[("factor", factor)]).unwrap()).unwrap();
        let record = [flight(&truth, 30.0, &[0.0; 4], 3.0, Some(seed))];
        let units = screen::wrong_units(&record, &quadrotor(), None).unwrap();
        assert!(units.is_empty(), "{factor}: {units:?}");
    }
}

/// A fault of the vehicle does not hide a wrong unit.
#[test]
fn a_unit_is_told_beside_a_strong_fault() {
    let faults: [Fault; 4] = [
        (Kind::InputDelay, "u_roll", &[("delay_s", 0.15)]),
        (Kind::ActuatorLag, "u_roll", &[("time_constant_s", 0.2)]),
        (Kind::InputGain, "u_pitch", &[("factor", 0.7)]),
        (Kind::SensorScale, "pitch_rate", &[("factor", 1.3)]),
    ];
    for (kind, place, parameters) in &faults {
        let mut truth = quadrotor();
        truth.add_effect(Effect::new(*kind, place, parameters).unwrap()).unwrap();
        let record = flight(&truth, 30.0, &[0.0; 4], 3.0, Some(2));
        let record = [scaled(&record, &OUTPUTS, 180.0 / std::f64::consts::PI)];
        let units = screen::wrong_units(&record, &quadrotor(), None).unwrap();
        let told: Vec<&str> = units.iter().map(|f| f.place.as_str()).collect();
        assert_eq!(told, [OUTPUTS.join(",").as_str()], "{kind:?} {parameters:?}: {units:?}");
    }
}

#[test]
fn a_record_with_the_commands_of_another_flight_is_refused() {
    let record = flight(&quadrotor(), 40.0, &[0.0; 4], 3.0, Some(5));
    let mut other = record.clone();
    for (seed, name) in INPUTS.iter().enumerate() {
        let steps = noise(record.len() / 50 + 1, seed as u64);
        other = changed(&other, name, |k, _| 5.0 * steps[k / 50]);
    }
    let answer = diagnose(vec![other], &quadrotor(), &Options::default()).unwrap();
    assert_eq!(answer.verdict, Verdict::Inconclusive, "{}", answer.text());
    assert!(answer.data.iter().any(|f| f.kind == "vehicle" && f.blocking), "{}", answer.text());
}

/// A freely rotating body with motor lags of 50 ms under an oscillating load, with attitude control: the
/// commands mostly cancel the disturbance.
fn under_a_swinging_load() -> Record {
    let (period_s, steps) = (0.005, 6000);
    let (pushes, sensor, hand) = (noise(steps, 11), noise(steps, 12), noise(steps, 13));
    let (mut commands, mut rates) = (Vec::new(), Vec::new());
    let (mut angle, mut rate, mut torque) = (0.0, 0.0, 0.0);
    let (mut load, mut swing) = (0.0, 0.0);
    for k in 0..steps {
        let measured = rate + 0.005 * sensor[k];
        let wanted = if k % 200 < 100 { 0.02 * hand[k / 100 * 100] } else { 0.0 };
        let command = 0.6 * (wanted - angle) - 0.08 * measured;
        commands.push(command);
        rates.push(measured);
        swing += period_s * (-100.0 * load - 1.0 * swing + 400.0 * pushes[k]);
        load += period_s * swing;
        rate += period_s * (60.0 * torque + 0.5 * load);
        angle += period_s * rate;
        torque += period_s / 0.05 * (command - torque);
    }
    let mut record = Record::new("load", (0..steps).map(|k| k as f64 * period_s).collect()).unwrap();
    record.push("u_roll", "", commands).unwrap();
    record.push("roll_rate", "rad/s", rates).unwrap();
    record
}

#[test]
fn commands_that_mostly_cancel_a_disturbance_are_those_of_the_vehicle() {
    let text = "A = [[0.0]]\nB = [[60.0]]\nstates = [{ name = 'roll_rate', unit = 'rad/s' }]\n\
                inputs = [{ name = 'u_roll' }]\noutputs = [{ name = 'roll_rate', unit = 'rad/s', noise = 0.005 }]";
    let vehicle = Vehicle::parse(text, "body.toml").unwrap();
    let stranger = screen::stranger(&[under_a_swinging_load()], &vehicle, &[], None).unwrap();
    assert!(stranger.is_none(), "{stranger:?}");
}

#[test]
fn only_a_model_of_the_vehicle_tells_what_comes() {
    let text = "A = [[-2.0]]\nB = [[1.0]]\nstates = [{ name = 'rate', unit = 'rad/s' }]\n\
                inputs = [{ name = 'u' }]\noutputs = [{ name = 'rate', unit = 'rad/s' }]";
    let vehicle = Vehicle::parse(text, "axis.toml").unwrap();
    let (steps, sensor, hand) = (3000, noise(3000, 21), noise(3000, 22));
    // An axis of the same gain, a weaker one, and one of opposite sign.
    for (gain, foreseen) in [(1.0, true), (0.7, true), (-1.0, false)] {
        let (mut rate, mut commands, mut rates) = (0.0, Vec::new(), Vec::new());
        for k in 0..steps {
            let command = hand[k / 70];
            commands.push(command);
            rates.push(rate + 0.02 * sensor[k]);
            rate += 0.01 * (-2.0 * rate + gain * command);
        }
        let mut record = Record::new("axis", (0..steps).map(|k| k as f64 * 0.01).collect()).unwrap();
        record.push("u", "", commands).unwrap();
        record.push("rate", "rad/s", rates).unwrap();
        let data = Data::join(&[record], &vehicle, None).unwrap();
        let found = screen::foresight(&vehicle, &data, 2000, true);
        assert_eq!((found.some, found.contradicted.is_empty()), (foreseen, foreseen), "{gain}");
    }
}
