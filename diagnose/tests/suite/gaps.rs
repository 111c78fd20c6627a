//! Diagnoses of records from which stretches are missing: a logger that lost its link, or its card.

use whirlstand_diagnose::Verdict;
use whirlstand_logs::Record;
use whirlstand_vehicle::{Effect, Kind, Vehicle};

use crate::support::{diagnosis, flight, named, with_gap};

/// A hovering helicopter, of which the vibration of its rotor is declared.
fn helicopter() -> Vehicle {
    Vehicle::builtin("helicopter-hover").unwrap()
}

/// A flight of a minute, with a receiver of ten positions and speeds a second whose last value is recorded until the next.
fn fly(vehicle: &Vehicle, seed: u64) -> Record {
    flight(vehicle, 60.0, &vec![0.0; vehicle.states.len()], 0.1, Some(seed))
}

/// The record without `lost_s` at the end of each `every_s`.
fn gappy(record: &Record, every_s: f64, lost_s: f64) -> Record {
    let ends = (1..(60.0 / every_s) as usize).map(|k| k as f64 * every_s);
    ends.fold(record.clone(), |record, end| with_gap(&record, end - lost_s, end))
}

/// Gaps through which the commands are known, gaps that cut the record, and many that cut it.
const GAPS: [(f64, f64); 4] = [(3.0, 0.1), (10.0, 1.2), (10.0, 0.4), (2.5, 0.4)];

/// A prediction that went on through gaps in which the stick had moved named a push at their ends. Positions of a receiver
/// whose rate the gaps hid were lost samples. After a cut, the offset of a position was slow noise, and the declared vibration
/// went on with a wrong phase.
#[test]
fn gaps_are_no_cause() {
    for (every_s, lost_s) in GAPS {
        let answer = diagnosis(gappy(&fly(&helicopter(), 1), every_s, lost_s), &helicopter());
        assert!(answer.causes.is_empty(), "{every_s} {lost_s}: {}", answer.text());
        assert_eq!(answer.verdict, Verdict::Consistent, "{every_s} {lost_s}: {}", answer.text());
    }
}

#[test]
fn a_cause_is_named_through_gaps() {
    let mut truth = helicopter();
    truth.add_effect(Effect::new(Kind::SensorScale, "roll_rate", &[("factor", 1.4)]).unwrap()).unwrap();
    for (every_s, lost_s) in GAPS {
        let answer = diagnosis(gappy(&fly(&truth, 2), every_s, lost_s), &helicopter());
        assert_eq!(named(&answer), [["sensor_scale(roll_rate)"]], "{every_s} {lost_s}: {}", answer.text());
        let factor = answer.causes[0].parameters["factor"].value;
        assert!((factor - 1.4).abs() < 0.08, "{every_s} {lost_s}: {}", answer.text());
    }
}
