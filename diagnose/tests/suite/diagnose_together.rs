//! Tests of two simultaneous causes, and of effects that resemble another cause.

use whirlstand_diagnose::{Diagnosis, Verdict};
use whirlstand_logs::Record;
use whirlstand_vehicle::{Effect, Kind, Simulator, Stream, Vehicle};

use crate::support::{changed, diagnosis, flight, named, pushed_flight};

fn builtin(name: &str) -> Vehicle {
    let mut vehicle = Vehicle::builtin(name).unwrap();
    vehicle.outputs.iter_mut().for_each(|o| o.vibration = None);
    vehicle
}

/// Kind, place and parameters.
type Fault<'a> = (Kind, &'a str, &'a [(&'a str, f64)]);

fn quadrotor(effects: &[Fault<'_>]) -> Vehicle {
    let mut vehicle = builtin("quadrotor");
    for (kind, place, parameters) in effects {
        vehicle.add_effect(Effect::new(*kind, place, parameters).unwrap()).unwrap();
    }
    vehicle
}

fn fly(vehicle: &Vehicle, seed: u64) -> Record {
    flight(vehicle, 25.0, &vec![0.0; vehicle.states.len()], 1.0, Some(seed))
}

#[track_caller]
fn names_both(answer: &Diagnosis, truths: [&str; 2]) {
    let named = named(answer);
    assert_eq!(named.len(), 2, "{}", answer.text());
    for truth in truths {
        assert!(named.iter().any(|n| n.iter().any(|n| n == truth)), "{truth}: {}", answer.text());
    }
}

#[test]
fn a_push_beside_a_gain_hides_neither() {
    let gust = [("at_s", 11.56), ("duration_s", 0.76), ("magnitude", -0.3)];
    let truth = quadrotor(&[
        (Kind::PulseDisturbance, "pitch_rate", &gust),
        (Kind::InputGain, "u_pitch", &[("factor", 0.91)]),
    ]);
    names_both(
        &diagnosis(fly(&truth, 1), &builtin("quadrotor")),
        ["pulse_disturbance(pitch_rate)", "input_gain(u_pitch)"],
    );
}

#[test]
fn a_transition_beside_a_changed_parameter_hides_neither() {
    let hover = builtin("helicopter-hover");
    let mut truth = hover.clone();
    truth.add_effect(Effect::mode_transition(18.16, "helicopter-longitudinal").unwrap()).unwrap();
    truth.add_effect(Effect::new(Kind::ParameterChange, "A[2,3]", &[("factor", 1.3)]).unwrap()).unwrap();
    let record = flight(&truth, 23.0, &vec![0.0; truth.states.len()], 0.03, Some(2));
    names_both(&diagnosis(record, &hover), ["mode_transition(vehicle)", "parameter_change(A[2,3])"]);
}

#[test]
fn the_length_of_a_push_is_found_between_the_lengths_that_are_tried() {
    for (seed, duration) in [(3, 0.23), (4, 0.349), (5, 0.53)] {
        let gust = [("at_s", 9.0), ("duration_s", duration), ("magnitude", 0.5)];
        let truth = quadrotor(&[(Kind::PulseDisturbance, "roll_rate", &gust)]);
        let answer = diagnosis(fly(&truth, seed), &builtin("quadrotor"));
        assert_eq!(named(&answer), [["pulse_disturbance(roll_rate)"]], "{}", answer.text());
        let found = &answer.causes[0].parameters["duration_s"];
        assert!((found.value - duration).abs() < 0.015, "{found:?}, in truth {duration}");
    }
}

#[test]
fn a_coarse_sensor_is_no_noisy_one() {
    let own = builtin("quadrotor").outputs[2].noise;
    let truth = quadrotor(&[(Kind::Quantization, "pitch", &[("step", 10.0 * own)])]);
    let answer = diagnosis(fly(&truth, 6), &builtin("quadrotor"));
    assert_eq!(named(&answer), [["quantization(pitch)"]], "{}", answer.text());
    // Of four channels, each in units of its noise, one is rounded: of its own power that is 100 / 12 of 100 / 12 + 1.
    let share = answer.causes[0].evidence.share_of_residual;
    assert!((share - 0.893 / 4.0).abs() < 0.03, "{share}");
    assert_eq!(answer.verdict, Verdict::Explained, "{}", answer.text());
}

#[test]
fn three_wild_values_are_outliers() {
    let vehicle = builtin("quadrotor");
    let wild = |k: usize, v: f64| match k {
        410 | 2007 => v + 20.0 * vehicle.outputs[0].noise,
        1203 => v - 20.0 * vehicle.outputs[0].noise,
        _ => v,
    };
    let record = changed(&fly(&vehicle, 7), "roll", wild);
    assert_eq!(named(&diagnosis(record, &vehicle)), [["outliers(roll)"]]);
}

#[test]
fn one_value_that_stands_far_out_is_an_outlier() {
    let vehicle = builtin("quadrotor");
    let noise = vehicle.outputs[0].noise;
    let with = |size: f64| {
        let record = fly(&vehicle, 7);
        changed(&record, "roll", |k, v| if k == 1203 { v - size * noise } else { v })
    };
    let answer = diagnosis(with(25.0), &vehicle);
    assert_eq!(named(&answer), [["outliers(roll)"]]);
    let fraction = &answer.causes[0].parameters["fraction"];
    assert!((fraction.value - 1.0 / 2500.0).abs() < 1e-6, "{fraction:?}");
    // A deviation that noise reaches now and then is no outlier.
    assert!(diagnosis(with(4.0), &vehicle).causes.is_empty());
}

/// An 18 s record holds only three periods of the turbulence bandwidth; the little that it shows must be
/// used.
#[test]
fn slow_turbulence_is_sized_in_a_short_record() {
    let gusts = [("std", 0.1), ("bandwidth_hz", 0.17)];
    let truth = quadrotor(&[(Kind::Turbulence, "roll_rate", &gusts)]);
    let (mut inside, mut values) = (0, 0);
    for seed in [13, 14] {
        let answer = diagnosis(flight(&truth, 18.0, &[0.0; 4], 1.0, Some(seed)), &builtin("quadrotor"));
        assert_eq!(named(&answer), [["turbulence(roll_rate)"]], "seed {seed}: {}", answer.text());
        for (name, value) in gusts {
            let found = &answer.causes[0].parameters[name];
            values += 1;
            inside += usize::from(found.low <= value && value <= found.high);
            println!("seed {seed}: {name} {value} in truth, {found:?}");
        }
    }
    // Of four 95 % intervals, two miss the truth in one case of seventy.
    assert!(inside + 1 >= values, "{inside} of {values} inside their intervals");
}

/// A few iterations from the initial values of a changed entry do not reach the gain that its signature
/// predicts; a gain of the whole input, which is linear, must not be preferred for that reason.
#[test]
fn a_small_change_of_an_entry_is_not_taken_for_a_gain() {
    let nominal = builtin("helicopter-longitudinal");
    let mut truth = nominal.clone();
    truth.add_effect(Effect::new(Kind::ParameterChange, "B[2,1]", &[("factor", 0.95)]).unwrap()).unwrap();
    for seed in [19, 20, 21] {
        let record = flight(&truth, 20.0, &vec![0.0; truth.states.len()], 0.2, Some(seed));
        let answer = diagnosis(record, &nominal);
        let named = named(&answer);
        assert_eq!(named.len(), 1, "seed {seed}: {}", answer.text());
        assert!(named[0].contains(&"parameter_change(B[2,1])".into()), "seed {seed}: {}", answer.text());
    }
}

/// A noise model of high order fits a drift as well as the drift itself does; the drift is the simpler
/// explanation.
#[test]
fn a_drift_beside_coloured_noise_is_no_colour() {
    let vehicle = builtin("quadrotor");
    for seed in [22, 23, 24] {
        let mut record = flight(&vehicle, 15.0, &[0.0; 4], 1.0, None);
        for output in &vehicle.outputs {
            let mut stream = Stream::new(seed, &output.name);
            let mut now = 0.0;
            let noise: Vec<f64> = std::iter::repeat_with(|| {
                now = 0.9 * now + (1.0f64 - 0.81).sqrt() * stream.normal();
                output.noise * now
            })
            .take(record.len())
            .collect();
            let drift = if output.name == "pitch" { 4.0 * output.noise / 15.0 } else { 0.0 };
            record = changed(&record, &output.name, |k, v| v + noise[k] + drift * 0.01 * k as f64);
        }
        let answer = diagnosis(record, &vehicle);
        assert_eq!(named(&answer), [["sensor_drift(pitch)"]], "seed {seed}: {}", answer.text());
    }
}

#[test]
fn a_force_that_follows_the_states_is_no_turbulence() {
    let vehicle = builtin("quadrotor");
    // The force on the roll rate is the product of roll rate and roll.
    let push = |x: &[f64]| vec![0.0, 4.0 * x[1] * x[0], 0.0, 0.0];
    for seed in [8, 9] {
        let record = pushed_flight(&vehicle, 25.0, &[0.0; 4], 3.0, Some(seed), push);
        let answer = diagnosis(record, &vehicle);
        assert!(answer.causes.is_empty(), "{}", answer.text());
        assert_eq!(answer.verdict, Verdict::Unexplained, "{}", answer.text());
    }
}

/// The gain of the pitch axis was withdrawn for a force on the roll axis, which moves nothing that it explains.
#[test]
fn a_force_outside_the_table_hides_no_gain_of_another_axis() {
    let mut vehicle = builtin("quadrotor");
    for entry in [(1, 2), (3, 0), (3, 1)] {
        vehicle.a[entry] = 0.0;
    }
    vehicle.b[(3, 0)] = 0.0;
    let mut truth = vehicle.clone();
    truth.add_effect(Effect::new(Kind::InputGain, "u_pitch", &[("factor", 0.97)]).unwrap()).unwrap();
    for seed in [8, 9] {
        let push = |x: &[f64]| vec![0.0, 0.4 * x[1] * x[0], 0.0, 0.0];
        let record = pushed_flight(&truth, 25.0, &[0.0; 4], 2.0, Some(seed), push);
        let answer = diagnosis(record, &vehicle);
        // Where u_pitch drives nothing else, its gain is that entry.
        let of_pitch = |place: &str| ["u_pitch", "B[4,2]"].contains(&place);
        let named: Vec<&str> = answer.causes.iter().map(|cause| cause.place.as_str()).collect();
        assert!(named.len() == 1 && of_pitch(named[0]), "{}", answer.text());
        assert_eq!(answer.verdict, Verdict::PartlyExplained, "{}", answer.text());
        let told = answer.unexplained.description;
        assert!(told.contains("force on roll_rate that follows roll times roll_rate"), "{told}");
    }
}

/// A tone or an event explains a part of any force. Without a declared level of noise it seemed to be all of it, and what
/// it leaves to be noise.
#[test]
fn a_force_outside_the_table_is_no_event_where_noise_is_unknown() {
    let vehicle = builtin("quadrotor");
    let mut silent = vehicle.clone();
    silent.outputs.iter_mut().for_each(|o| o.noise = 0.0);
    // The force on the roll rate is the product of roll rate and roll, or follows the magnitude of the roll rate.
    let forces: [fn(&[f64]) -> f64; 2] = [|x| 0.4 * x[1] * x[0], |x| 0.05 * x[1].abs()];
    for force in forces {
        for seed in [8, 9] {
            let push = |x: &[f64]| vec![0.0, force(x), 0.0, 0.0];
            let record = pushed_flight(&vehicle, 25.0, &[0.0; 4], 2.0, Some(seed), push);
            let answer = diagnosis(record, &silent);
            assert!(answer.causes.is_empty(), "{}", answer.text());
            assert_eq!(answer.verdict, Verdict::Unexplained, "{}", answer.text());
        }
    }
}

#[test]
fn wild_values_within_the_reach_of_a_noise_that_swings_are_outliers() {
    let vehicle = builtin("quadrotor");
    let std = vehicle.outputs[0].noise;
    // Noise with a resonance at a fifth of the sampling rate: neighbouring samples differ by as much as the
    // outliers.
    let mut stream = Stream::new(11, "resonant");
    let (mut one, mut two) = (0.0, 0.0);
    let mut noise = || {
        let now = 2.0 * 0.95 * (0.4 * std::f64::consts::PI).cos() * one - 0.95 * 0.95 * two + stream.normal();
        (two, one) = (one, now);
        0.3 * std * now
    };
    let quiet = flight(&vehicle, 25.0, &[0.0; 4], 1.0, None);
    let swinging: Vec<f64> = quiet.signal("roll").unwrap().values.iter().map(|v| v + noise()).collect();
    let with = |size: f64| {
        let record = fly(&vehicle, 10);
        changed(&record, "roll", |k, _| match k {
            700 | 1900 => swinging[k] + size,
            1305 => swinging[k] - size,
            _ => swinging[k],
        })
    };
    let largest = swinging.iter().zip(&quiet.signal("roll").unwrap().values);
    let largest = largest.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let answer = diagnosis(with(largest), &vehicle);
    assert_eq!(named(&answer), [["outliers(roll)"]], "{}", answer.text());
    let size = &answer.causes[0].parameters["magnitude"];
    assert!((size.value / largest - 1.0).abs() < 0.2, "{size:?}, in truth {largest}");
    let answer = diagnosis(with(0.0), &vehicle);
    assert!(answer.causes.is_empty(), "{}", answer.text());
}

#[test]
fn a_relay_in_an_input_is_no_gain_with_play() {
    let vehicle = builtin("quadrotor");
    // Doublets of one height; the relay holds the last side until the input changes sign.
    let input = |k: usize| -> f64 {
        match k % 800 {
            100..200 => 0.6,
            200..300 => -0.6,
            _ => 0.0,
        }
    };
    let doublets = |relay: f64| {
        let mut simulator = Simulator::new(&vehicle, 0.01, 12).unwrap();
        let mut side = 0.0;
        let rows: Vec<Vec<f64>> = (0..2500)
            .map(|k| {
                let u = input(k);
                side = if u == 0.0 { side } else { u.signum() };
                simulator.apply(&[u + relay * side, 0.0]);
                let y = simulator.measure().to_vec();
                simulator.advance();
                y
            })
            .collect();
        let mut record =
            Record::new("flight.csv", (0..rows.len()).map(|k| 0.01 * k as f64).collect()).unwrap();
        for (j, own) in vehicle.inputs.iter().enumerate() {
            let values = (0..rows.len()).map(|k| if j == 0 { input(k) } else { 0.0 }).collect();
            record.push(&own.name, own.unit.si_symbol(), values).unwrap();
        }
        for (i, own) in vehicle.outputs.iter().enumerate() {
            record.push(&own.name, own.unit.si_symbol(), rows.iter().map(|y| y[i]).collect()).unwrap();
        }
        record
    };
    let answer = diagnosis(doublets(0.15), &vehicle);
    assert!(answer.causes.is_empty(), "{}", answer.text());
    assert_eq!(answer.verdict, Verdict::Unexplained, "{}", answer.text());
    let answer = diagnosis(doublets(0.0), &vehicle);
    assert_ne!(answer.verdict, Verdict::Unexplained, "{}", answer.text());
}

/// An autoregressive noise model absorbs an offset at little cost; the declared noise shows that the offset
/// is no noise.
#[test]
fn an_offset_is_no_noise_that_wanders() {
    let vehicle = builtin("quadrotor");
    let mut record = fly(&quadrotor(&[(Kind::SensorBias, "pitch", &[("offset", -0.035)])]), 11);
    for (output, seed) in vehicle.outputs.iter().zip(0..) {
        let mut stream = Stream::new(seed, "wander");
        let wander: Vec<f64> = (0..2500)
            .scan(0.0, |at, _| {
                *at = 0.995 * *at + 0.07 * output.noise * stream.normal();
                Some(*at)
            })
            .collect();
        record = changed(&record, &output.name, |k, v| v + wander.get(k).unwrap_or(&0.0));
    }
    let answer = diagnosis(record, &vehicle);
    assert!(named(&answer)[0].iter().any(|n| n == "sensor_bias(pitch)"), "{}", answer.text());
    assert_eq!(answer.causes.len(), 1, "{}", answer.text());
}
