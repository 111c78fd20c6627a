//! Diagnoses of hovers: a law holds an attitude against gusts, and its commands are little but the noise of the gyroscope
//! and the answer to the gusts. No noise is declared, and the vehicle file is right. An integrator of this file simulates
//! them.

use whirlstand_diagnose::{Options, Verdict, diagnose};
use whirlstand_logs::Record;
use whirlstand_vehicle::{Effect, Free, Kind, Matrix, Stream, Target, Vehicle};

use crate::support::{diagnosis, flight, named};

/// Torque to angular acceleration, 1/s^2.
const TORQUE: f64 = 120.0;
/// Damping, 1/s.
const DAMPING: f64 = -0.5;

fn axis() -> Vehicle {
    let text = format!(
        "name = \"axis\"\nA = [[0.0, 1.0], [0.0, {DAMPING:?}]]\nB = [[0.0], [{TORQUE:?}]]\nC = [[1.0, 0.0], [0.0, 1.0]]\n\
         states = [{{ name = \"roll\", unit = \"rad\" }}, {{ name = \"roll_rate\", unit = \"rad/s\" }}]\n\
         inputs = [{{ name = \"torque\", lower = -1.0, upper = 1.0 }}]\n\
         outputs = [{{ name = \"roll\", unit = \"rad\" }}, {{ name = \"roll_rate\", unit = \"rad/s\" }}]\n"
    );
    Vehicle::parse(&text, "axis.toml").unwrap()
}

/// A hover of 40 s under a cascade of two proportional laws with a loop of 4 ms, of which each fifth sample is recorded.
/// Gusts have a time constant of 1 s and a standard deviation of 0.1 rad/s^2.
fn fly(seed: u64) -> Record {
    const LOOP_S: f64 = 0.004;
    /// Fine enough for the error of the angle to be far below its noise.
    const FINE: u32 = 8;
    const FINE_S: f64 = LOOP_S / FINE as f64;
    let mut random = Stream::new(seed, "hover");
    let (mut roll, mut rate, mut gust, mut wander) = (0.0, 0.0, 0.0, 0.0);
    let (mut time, mut rows) = (Vec::new(), [const { Vec::new() }; 3]);
    for k in 0..10_000u32 {
        let now = f64::from(k) * LOOP_S;
        // The angle is that of an estimator: precise, and slow in its errors.
        wander = 0.98 * wander + 4e-6 * random.normal();
        let (angle, gyroscope) = (roll + wander, rate + 4e-3 * random.normal());
        let torque = 0.15 * (-6.0 * angle - gyroscope);
        if k % 5 == 0 {
            time.push(now);
            rows.iter_mut().zip([torque, angle, gyroscope]).for_each(|(row, value)| row.push(value));
        }
        for _ in 0..FINE {
            gust += -FINE_S * gust + 0.1 * (2.0 * FINE_S).sqrt() * random.normal();
            rate += FINE_S * (DAMPING * rate + TORQUE * torque + gust);
            roll += FINE_S * rate;
        }
    }
    let mut record = Record::new("hover.csv", time).unwrap();
    let names = [("torque", ""), ("roll", "rad"), ("roll_rate", "rad/s")];
    for ((name, unit), row) in names.into_iter().zip(rows) {
        record.push(name, unit, row).unwrap();
    }
    record
}

/// Commands that cancel gusts seem to move nothing, unless the force of the gusts is estimated beside them.
#[test]
fn commands_that_cancel_gusts_do_not_do_nothing() {
    for seed in 1..=8 {
        let answer = diagnosis(fly(seed), &axis());
        let names = named(&answer).concat();
        assert!(!names.iter().any(|name| name.starts_with("input_gain")), "{seed}: {}", answer.text());
        assert_ne!(answer.verdict, Verdict::Explained, "{seed}: {}", answer.text());
    }
}

/// The search follows these records with a long memory, under which the commands seem to do a twentieth to a third of what
/// they do. A refit is told as the likeliest filter finds it.
#[test]
fn a_refit_finds_what_commands_do_that_cancel_gusts() {
    let mut axis = axis();
    let free = |target, lower, upper| Free { target, lower, upper, start: None };
    axis.free = vec![
        free(Target::Entry(Matrix::A, 1, 1), -50.0, 5.0),
        free(Target::Entry(Matrix::B, 1, 0), 0.0, 1000.0),
    ];
    let options = Options { refit: Some(true), ..Options::default() };
    let mut ratios = Vec::new();
    for seed in 1..=8 {
        let answer = diagnose(vec![fly(seed)], &axis, &options).unwrap();
        if let Some(torque) = answer.refitted.iter().find(|r| r.parameter == "B[2,1]") {
            ratios.push(torque.value / TORQUE);
        }
    }
    ratios.sort_by(f64::total_cmp);
    assert!(ratios.len() >= 4, "{ratios:?}");
    assert!(ratios[0] > 0.5 && ratios[ratios.len() - 1] < 2.0, "{ratios:?}");
    assert!((0.8..1.25).contains(&ratios[ratios.len() / 2]), "{ratios:?}");
}

/// The outliers had changed the phase with which the declared vibration of the rotor was taken off, and what was left of it
/// was named as further vibrations.
#[test]
fn a_declared_vibration_beside_outliers_is_no_cause() {
    let mut helicopter = Vehicle::builtin("helicopter-hover").unwrap();
    helicopter.outputs.iter_mut().filter(|output| output.name == "pitch_rate").for_each(|o| o.noise /= 8.0);
    let mut truth = helicopter.clone();
    let outliers = [("fraction", 0.02), ("magnitude", 0.09)];
    truth.add_effect(Effect::new(Kind::Outliers, "pitch_rate", &outliers).unwrap()).unwrap();
    for seed in 1..=3 {
        let answer = diagnosis(flight(&truth, 30.0, &[0.0; 8], 0.1, Some(seed)), &helicopter);
        assert_eq!(named(&answer), [["outliers(pitch_rate)"]], "{}", answer.text());
        assert_eq!(answer.verdict, Verdict::Explained, "{}", answer.text());
    }
}
