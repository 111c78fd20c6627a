//! Diagnoses of flights with a sensor or an actuator that errs in a way which no effect of the table describes.

use std::cell::Cell;

use whirlstand_diagnose::{Diagnosis, Verdict};
use whirlstand_logs::Record;
use whirlstand_vehicle::{Stream, Vehicle};

use crate::support::{changed, diagnosis, flight, steered_flight, stick};

const PERIOD_S: f64 = 0.01;

fn quadrotor() -> Vehicle {
    let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
    vehicle.outputs.iter_mut().for_each(|output| output.vibration = None);
    vehicle
}

/// The record with the noise of the sensors.
fn noisy(record: &Record, seed: u64) -> Record {
    quadrotor().outputs.iter().fold(record.clone(), |record, output| {
        let mut random = Stream::new(seed, &output.name);
        let noise: Vec<f64> = record.time.iter().map(|_| output.noise * random.normal()).collect();
        changed(&record, &output.name, |k, value| value + noise[k])
    })
}

/// Diagnoses of flights in which the sensor of roll shows what `sensor` makes of the roll angle, whose peak is 1.
fn with_sensor(sensor: impl Fn(f64) -> f64) -> Vec<Diagnosis> {
    let record = flight(&quadrotor(), 20.0, &[0.0; 4], 3.0, None);
    let roll = &record.signals().iter().find(|signal| signal.name == "roll").unwrap().values;
    let peak = roll.iter().fold(0.0f64, |most, roll| most.max(roll.abs()));
    let shown: Vec<f64> = roll.iter().map(|roll| peak * sensor(roll / peak)).collect();
    let record = changed(&record, "roll", |k, _| shown[k]);
    (1..=3).map(|seed| diagnosis(noisy(&record, seed), &quadrotor())).collect()
}

#[track_caller]
fn are_described(answers: Vec<Diagnosis>, like: &str) {
    for answer in answers {
        assert!(answer.causes.is_empty(), "{}", answer.text());
        assert_eq!(answer.verdict, Verdict::Unexplained, "{}", answer.text());
        assert!(answer.unexplained.description.to_lowercase().contains(like), "{}", answer.text());
    }
}

/// A smaller scale explains most of it.
#[test]
fn a_curved_sensor_is_not_one_of_another_scale() {
    are_described(with_sensor(|y| y - 0.2 * y.powi(3)), "an error of the sensor of roll that follows roll");
}

/// The lag of the creep and its gain do not belong together: no lag of the sensor explains it.
#[test]
fn a_sensor_that_creeps_is_no_lag() {
    let crept = Cell::new(0.0);
    let creeping = |y: f64| {
        crept.set(crept.get() + (y - crept.get()) * PERIOD_S / 2.0);
        y + 0.3 * crept.get()
    };
    are_described(with_sensor(creeping), "an error of the sensor of roll that makes roll creep");
}

/// It is late where the angle changes fast, and only there.
#[test]
fn a_sensor_of_limited_rate_is_no_lag() {
    let shown = Cell::new(0.0);
    let limited = |y: f64| {
        shown.set(shown.get() + (y - shown.get()).clamp(-0.006, 0.006));
        shown.get()
    };
    are_described(with_sensor(limited), "an error of the sensor of roll that limits the rate of roll");
}

/// Backlash trails the command by half of its width; a stuck actuator jumps onto it. The commands are within their limits.
#[test]
fn an_actuator_that_sticks_is_no_backlash() {
    let held = [const { Cell::new(0.0) }; 2];
    let steer = |t: f64, j: usize| {
        let command = stick(t, j);
        if j == 1 || (command - held[j].get()).abs() >= 0.7 {
            held[j].set(command);
        }
        held[j].get()
    };
    let record = steered_flight(&quadrotor(), 20.0, &[0.0; 4], None, steer, |x| vec![0.0; x.len()]);
    let record = changed(&record, "u_roll", |k, _| stick(k as f64 * PERIOD_S, 0));
    let answers = (1..=3).map(|seed| diagnosis(noisy(&record, seed), &quadrotor()));
    are_described(answers.collect(), "a signal added to u_roll that makes u_roll stick");
}
