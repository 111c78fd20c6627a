//! Comparisons of simulated flights whose truth is known.

use whirlstand_ident::{CompareError, CompareOptions, Comparison, compare};
use whirlstand_logs::Record;
use whirlstand_vehicle::Vehicle;

use crate::support::{self, flight};

fn vehicle(name: &str) -> Vehicle {
    Vehicle::builtin(name).unwrap()
}

fn without_vibration(name: &str) -> Vehicle {
    let mut vehicle = vehicle(name);
    vehicle.outputs.iter_mut().for_each(|o| o.vibration = None);
    vehicle
}

#[test]
fn the_true_model_without_noise_fits_completely_and_gives_the_initial_state_back() {
    for (name, gain, initial) in [
        ("quadrotor", 1.0, vec![0.1, -0.2, 0.05, 0.3]),
        ("helicopter-hover", 0.1, vec![0.02, 0.01, -0.01, 0.0, 0.5, -0.4, 3.0, -2.0]),
    ] {
        let vehicle = vehicle(name);
        let c = compare(&flight(&vehicle, 40.0, &initial, gain, None), &vehicle, &CompareOptions::default())
            .unwrap();
        for (output, o) in c.ordered() {
            assert!(o.fit.unwrap() > 99.999, "{name} {output}: {:?}", o.fit);
            assert!(o.horizon_fit.unwrap() > 99.9, "{name} {output}: {:?}", o.horizon_fit);
        }
        for (state, x0) in vehicle.states.iter().zip(&initial) {
            let found = c.initial_state[&state.name];
            assert!((found - x0).abs() < 1e-5, "{name} {}: {found} {x0}", state.name);
        }
        assert!(c.verdict.starts_with("The simulation agrees"), "{}", c.verdict);
    }
}

#[test]
fn the_true_model_with_noise_leaves_only_the_declared_noise() {
    for (name, gain) in [("quadrotor", 1.0), ("helicopter-hover", 0.05), ("helicopter-lateral", 0.05)] {
        let vehicle = without_vibration(name);
        let initial = vec![0.0; vehicle.states.len()];
        let record = flight(&vehicle, 60.0, &initial, gain, Some(3));
        let c = compare(&record, &vehicle, &CompareOptions::default()).unwrap();
        for (output, o) in c.ordered() {
            let ratio = o.rmse.unwrap() / o.declared_noise;
            assert!((0.9..1.1).contains(&ratio), "{name} {output}: {ratio}");
            assert!(o.bias.unwrap().abs() < 0.2 * o.declared_noise, "{name} {output}");
            assert!(o.lines.is_empty(), "{name} {output}: {:?}", o.lines);
        }
        assert!(c.agrees() && c.verdict.contains("down to the declared noise"), "{}", c.verdict);
    }
}

#[test]
fn a_wrong_parameter_is_seen_where_it_is() {
    let truth = without_vibration("quadrotor");
    let record = flight(&truth, 60.0, &[0.0; 4], 1.0, Some(3));
    let mut wrong = truth.clone();
    // Pitch control half as strong: roll knows nothing of it.
    wrong.b[(3, 1)] *= 0.5;
    let c = compare(&record, &wrong, &CompareOptions::default()).unwrap();
    let fit = |name: &str| c.outputs[name].fit.unwrap();
    assert!(fit("roll") > 95.0 && fit("pitch") < 80.0, "{} {}", fit("roll"), fit("pitch"));
    assert!(c.outputs["pitch"].rmse.unwrap() > 5.0 * c.outputs["pitch"].declared_noise);
    assert!(c.verdict.starts_with("The simulation differs") && c.verdict.contains("pitch"), "{}", c.verdict);
    let profile = &c.outputs["pitch"].quadratic_error;
    assert_eq!(profile.len(), 20);
    let mean = profile.iter().map(|i| i.mean_square).sum::<f64>() / 20.0;
    assert!((mean.sqrt() / c.outputs["pitch"].rmse.unwrap() - 1.0).abs() < 0.01);
}

#[test]
fn offset_tone_and_a_late_change_are_each_described() {
    let vehicle = without_vibration("quadrotor");
    let record = flight(&vehicle, 60.0, &[0.0; 4], 1.0, Some(5));
    let (time, signals) = record.into_signals();
    let mut changed = Record::new("changed.csv", time.clone()).unwrap();
    for mut s in signals {
        for (v, t) in s.values.iter_mut().zip(&time) {
            match s.name.as_str() {
                "roll" => *v += 0.05,
                "pitch_rate" => *v += 0.2 * (std::f64::consts::TAU * 7.3 * t).sin(),
                "pitch" if *t > 55.0 => *v += 0.01 * (t - 55.0),
                _ => {}
            }
        }
        changed.push(s.name, s.unit, s.values).unwrap();
    }
    let c = compare(&changed, &vehicle, &CompareOptions::default()).unwrap();
    let o = |name: &str| &c.outputs[name];
    assert!((o("roll").bias.unwrap() - 0.05).abs() < 0.005, "{:?}", o("roll").bias);
    assert!(o("roll").fit_bias_removed.unwrap() > o("roll").fit.unwrap() + 10.0);
    let line = o("pitch_rate").lines[0];
    assert!((line.frequency_hz - 7.3).abs() < 0.02 && (line.amplitude / 0.2 - 1.0).abs() < 0.1, "{line:?}");
    assert!(line.share > 0.9);
    assert!(
        o("pitch").growth.unwrap() > 3.0 && o("pitch").worst.unwrap().until_s > 59.0,
        "{:?}",
        o("pitch").worst
    );

    let json = serde_json::to_value(&c).unwrap();
    assert_eq!(json["schema"], "whirlstand.comparison.v1");
    assert!(json.get("series").is_none());
    let back: Comparison = serde_json::from_value(json).unwrap();
    assert_eq!(back.outputs, c.outputs);
    let text = c.text();
    assert!(text.lines().count() <= 15 && text.ends_with('\n'), "{text}");
    println!("{text}");
}

#[test]
fn an_unstable_vehicle_is_judged_by_its_short_predictions() {
    let stable = without_vibration("quadrotor");
    let mut vehicle = stable.clone();
    // Roll falls over within half a second; feedback flies it, and the record holds what feedback asked for.
    vehicle.a[(1, 0)] = 4.0;
    let mut simulator = whirlstand_vehicle::Simulator::new(&vehicle, 0.01, 9).unwrap();
    let b = vehicle.b[(1, 0)];
    let time: Vec<f64> = (0..6000).map(|k| k as f64 * 0.01).collect();
    let mut columns = vec![Vec::new(); 6];
    for t in &time {
        let y = simulator.measure().to_vec();
        let u = [(-12.0 * y[0] - 4.0 * y[1]) / b + 4.0 * support::stick(*t, 0), 0.3 * support::stick(*t, 1)];
        // A log has so many digits: with every bit of the inputs, a simulation from rest would stay with the flight.
        let logged = u.map(|u| (1e6 * u).round() / 1e6);
        columns.iter_mut().zip(y.iter().chain(&logged)).for_each(|(c, v)| c.push(*v));
        simulator.step(&u);
    }
    let mut record = Record::new("unstable.csv", time).unwrap();
    let names = ["roll", "roll_rate", "pitch", "pitch_rate", "u_roll", "u_pitch"];
    for (name, values) in names.iter().zip(columns) {
        record.push(*name, "", values).unwrap();
    }
    let options = CompareOptions { horizon_s: 0.5, ..CompareOptions::default() };
    let c = compare(&record, &vehicle, &options).unwrap();
    assert!(c.diverged && c.outputs["roll"].fit.is_none(), "{}", c.verdict);
    assert!(c.verdict.contains("diverges"), "{}", c.verdict);
    let truth = c.outputs["roll"].horizon_fit.unwrap();
    let wrong = compare(&record, &stable, &options).unwrap().outputs["roll"].horizon_fit.unwrap();
    assert!(truth > 85.0 && wrong < truth - 15.0, "{truth} {wrong}");
    // What is left is the noise of the sensor, and a little of that in the state that was fitted to 0.5 s.
    let left = c.outputs["roll"].horizon_rmse.unwrap() / c.outputs["roll"].declared_noise;
    assert!((0.95..1.2).contains(&left), "{left}");
}

#[test]
fn what_is_missing_is_named_beside_what_is_there() {
    let vehicle = vehicle("quadrotor");
    let time: Vec<f64> = (0..100).map(|k| k as f64 * 0.01).collect();
    let mut record = Record::new("other.csv", time).unwrap();
    record.push("in_lat", "", vec![0.0; 100]).unwrap();
    let text = |r: &Record| compare(r, &vehicle, &CompareOptions::default()).unwrap_err().to_string();
    assert!(text(&record).contains("u_roll") && text(&record).contains("in_lat"), "{}", text(&record));
    record.push("u_roll", "", vec![0.0; 100]).unwrap();
    record.push("u_pitch", "", vec![0.0; 100]).unwrap();
    let missing = text(&record);
    assert!(
        missing.contains("roll_rate") && missing.contains("in_lat") && missing.contains("--map"),
        "{missing}"
    );
    record.push("roll", "rad", vec![f64::NAN; 100]).unwrap();
    assert!(matches!(
        compare(&record, &vehicle, &CompareOptions::default()),
        Err(CompareError::NoValue { .. })
    ));
    let short = record.between(0.0, 0.1);
    assert!(matches!(
        compare(&short, &vehicle, &CompareOptions::default()),
        Err(CompareError::TooShort { .. })
    ));
}

#[test]
fn another_period_leaves_the_noise_that_its_resampling_leaves() {
    let vehicle = without_vibration("quadrotor");
    let record = flight(&vehicle, 60.0, &[0.0; 4], 1.0, Some(3));
    // Of white noise at 10 ms. 7 ms: interpolation with weights a and 1 - a, a even over 0 to 1, leaves
    // sqrt(2/3). 20 ms: a half, a whole and a half sample, over two. 50 ms: five samples.
    let cases =
        [(0.01, 1.0), (0.007, (2f64 / 3.0).sqrt()), (0.02, 1.5f64.sqrt() / 2.0), (0.05, 0.2f64.sqrt())];
    for (period_s, left) in cases {
        let options = CompareOptions { period_s: Some(period_s), ..CompareOptions::default() };
        let c = compare(&record, &vehicle, &options).unwrap();
        for (name, o) in c.ordered() {
            let ratio = o.rmse.unwrap() / o.declared_noise;
            assert!((ratio / left - 1.0).abs() < 0.05, "{period_s} {name}: {ratio} {left}");
        }
    }
}

#[test]
fn inputs_in_another_unit_are_suspected() {
    let vehicle = without_vibration("quadrotor");
    let record = flight(&vehicle, 60.0, &[0.0; 4], 1.0, Some(3));
    assert!(compare(&record, &vehicle, &CompareOptions::default()).unwrap().remarks.is_empty());
    let (time, signals) = record.into_signals();
    let mut scaled = Record::new("percent.csv", time).unwrap();
    for s in signals {
        let factor = if s.name.starts_with("u_") { 0.01 } else { 1.0 };
        scaled.push(s.name, s.unit, s.values.iter().map(|v| factor * v).collect()).unwrap();
    }
    let c = compare(&scaled, &vehicle, &CompareOptions::default()).unwrap();
    assert!(c.remarks.iter().any(|r| r.contains("unit") && r.contains("input_gain")), "{:?}", c.remarks);
}
