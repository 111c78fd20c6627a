//! Tests of diagnoses of real records, each from a linear baseline identified by `identify`. The records are
//! in the folder WHIRLSTAND_DATA.

use std::path::PathBuf;

use whirlstand_diagnose::{Diagnosis, Options, diagnose, screen};
use whirlstand_ident::CompareOptions;
use whirlstand_ident::compare::compare;
use whirlstand_ident::identify::{self, Log, Noise, Nuisance, Segment, Source, identify};
use whirlstand_ident::watch::Watch;
use whirlstand_logs::{Mapping, Record, read};
use whirlstand_test_harness::{Missing, Outcome};
use whirlstand_vehicle::Vehicle;

fn data(name: &str) -> Result<Record, Missing> {
    Ok(read(whirlstand_test_harness::data()?.join(name), &[] as &[Mapping]).unwrap())
}

fn baseline(name: &str) -> Vehicle {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../examples/diagnose");
    Vehicle::load(folder.join(name).with_extension("toml")).unwrap()
}

/// Identifies the free parameters of a vehicle from a part of a record, by the output-error method.
fn identified(vehicle: &Vehicle, record: &Record, part: (f64, f64), period_s: Option<f64>) -> Vehicle {
    let segment = Segment::new(record, vehicle, period_s, (Some(part.0), Some(part.1))).unwrap();
    let source = Source { log: Log { file: record.origin.clone(), sha256: String::new() }, segment };
    let nuisance = Nuisance { initial_state: true, output_offsets: false };
    let options = identify::Options { nuisance, noise: Some(Noise::White), ..identify::Options::default() };
    *identify(vehicle, &[source], &[], &options, &Watch::default()).unwrap().fitted.unwrap()
}

fn diagnosed(record: Record, vehicle: &Vehicle, period_s: Option<f64>) -> Diagnosis {
    let options = Options { period_s, refit: Some(true), ..Options::default() };
    let answer = diagnose(vec![record], vehicle, &options).unwrap();
    println!("{}", answer.text());
    answer
}

/// A parameter of an effect that is named, or listed as indistinguishable in this record.
fn named(answer: &Diagnosis, effect: &str, place: &str, parameter: &str) -> f64 {
    for cause in &answer.causes {
        if cause.effect == effect && cause.place == place {
            return cause.parameters[parameter].value;
        }
        for other in &cause.indistinguishable {
            if other.effect == effect && other.place == place {
                return other.parameters[parameter];
            }
        }
    }
    panic!("{effect} on {place} is not named: {}", answer.summary)
}

/// Position error of a free simulation relative to the tracking error, in %.
fn position_error(vehicle: &Vehicle, record: &Record) -> f64 {
    let rmse =
        compare(record, vehicle, &CompareOptions::default()).unwrap().outputs["position"].rmse.unwrap();
    let signal = |name: &str| &record.signal(name).unwrap().values;
    let behind = signal("reference").iter().zip(signal("position"));
    let power = behind.map(|(r, y)| (r - y).powi(2)).sum::<f64>() / record.time.len() as f64;
    100.0 * rmse / power.sqrt()
}

fn the_axis_of_emps_has_friction() -> Outcome {
    let (mut train, test) = (data("emps/train.csv")?, data("emps/test.csv")?);
    let none = vec![0.0; train.time.len()];
    train.push("pulse_force", "N", none).unwrap();
    let linear = identified(&baseline("emps"), &train, (0.0, 30.0), None);
    let answer = diagnosed(train, &linear, Some(0.01));
    let level = named(&answer, "coulomb_friction", "speed", "level");
    // Published values: 20.4 N and 95.1 kg.
    assert!((level - 20.4 / 95.1).abs() < 0.02, "{level}");
    let extended = answer.extended.expect("a cause extends the vehicle");
    let (before, after) = (position_error(&linear, &test), position_error(&extended, &test));
    println!("test record: {before:.2} % before, {after:.2} % after");
    assert!(after < 3.5 && after < 0.75 * before, "{before} {after}");
    Ok(())
}

fn the_hair_dryer_has_a_dead_time() -> Outcome {
    let record = data("dryer/dryer.csv")?;
    let linear = identified(&baseline("dryer"), &record, (0.0, 40.0), None);
    let answer = diagnosed(record, &linear, None);
    // The delay is two samples and the hold, which discrete-time models count as three. In one channel the
    // delays of input and sensor are indistinguishable: the input's comes first, as the only cause.
    let first = &answer.causes[0];
    assert_eq!(first.effect, "input_delay", "{}", answer.summary);
    assert!(answer.causes.len() == 1 && first.indistinguishable.iter().any(|o| o.effect == "sensor_delay"));
    let delay = first.parameters["delay_s"].value;
    assert!((delay - 0.16).abs() < 0.01, "{}", answer.summary);
    Ok(())
}

fn a_roll_axis_of_given_gain_lags() -> Outcome {
    let record = data("crazyflie/roll_pitch.csv")?;
    let options = Options { period_s: Some(0.004), ..Options::default() };
    let answer = diagnose(vec![record], &baseline("crazyflie-roll"), &options).unwrap();
    println!("{}", answer.text());
    assert_eq!(
        (answer.causes[0].effect.as_str(), answer.causes[0].place.as_str()),
        ("actuator_lag", "u_roll")
    );
    let lag = answer.causes[0].parameters["time_constant_s"].value;
    // The published value is 0.072 s, for the motors together with all other delays.
    assert!((0.055..0.08).contains(&lag), "{lag}");
    Ok(())
}

fn a_helicopter_in_hover_shakes_and_has_offsets() -> Outcome {
    let record = data("trex550/hover.csv")?;
    let flight = record.between(3.0, 84.0);
    let linear = identified(&baseline("trex550"), &flight, (3.0, 60.0), None);
    let answer = diagnosed(flight, &linear, None);
    for rate in ["p", "q", "r"] {
        let f = named(&answer, "vibration", rate, "frequency_hz");
        assert!((f - 27.6).abs() < 0.4, "{rate}: {f}");
        let cause = answer.causes.iter().find(|c| c.effect == "vibration" && c.place == rate).unwrap();
        assert!(cause.notes.iter().any(|n| n.contains("72.")), "its alias: {:?}", cause.notes);
    }
    assert!(named(&answer, "sensor_bias", "q", "offset") < -0.02, "{}", answer.summary);
    let shaken = answer.extended.expect("an extended vehicle").outputs[0].vibration.clone().unwrap();
    assert!(shaken.flying > 0.1, "{shaken:?}");
    Ok(())
}

fn the_motors_of_a_crazyflie_lag() -> Outcome {
    let record = data("crazyflie/thrust.csv")?;
    // The vehicle stands on the ground before 3 s.
    let flight = record.between(3.0, 36.0);
    let linear = identified(&baseline("crazyflie-thrust"), &flight, (3.0, 19.0), Some(0.002));
    let answer = diagnosed(flight, &linear, Some(0.004));
    let lag = named(&answer, "actuator_lag", "u_thrust", "time_constant_s");
    assert!(lag > 0.05 && lag < 0.11, "{lag}");
    Ok(())
}

/// The screening before the search refuses no real record for its unit or vehicle, identified or not.
fn no_real_record_is_refused() -> Outcome {
    let records = [
        ("dryer", "dryer/dryer.csv"),
        ("emps", "emps/train.csv"),
        ("emps", "emps/test.csv"),
        ("crazyflie-thrust", "crazyflie/thrust.csv"),
        ("crazyflie-roll", "crazyflie/roll_pitch.csv"),
        ("trex550", "trex550/hover.csv"),
        ("silverbox-cubic", "silverbox/multisine.csv"),
        ("silverbox-cubic", "silverbox/arrow.csv"),
    ];
    for (vehicle, name) in records {
        let (mut record, vehicle) = (data(name)?, baseline(vehicle));
        if name == "emps/train.csv" {
            let none = vec![0.0; record.time.len()];
            record.push("pulse_force", "N", none).unwrap();
        }
        let record = [record];
        let units = screen::wrong_units(&record, &vehicle, None).unwrap();
        let stranger = screen::stranger(&record, &vehicle, &[], None).unwrap();
        assert!(units.is_empty() && stranger.is_none(), "{name}: {units:?} {stranger:?}");
    }
    Ok(())
}

whirlstand_test_harness::tests!(
    no_real_record_is_refused,
    the_axis_of_emps_has_friction,
    the_hair_dryer_has_a_dead_time,
    a_roll_axis_of_given_gain_lags,
    a_helicopter_in_hover_shakes_and_has_offsets,
    the_motors_of_a_crazyflie_lag
);
