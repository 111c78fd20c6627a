//! Drafts of tables that a test fills by itself: what is at rest, too slow, or held.

use std::path::PathBuf;

use whirlstand_test_harness::noise;
use whirlstand_vehicle::Vehicle;

use super::parameter;
use crate::draft::{Choice, Names, draft};

/// A record of two columns, written by `value(k)`.
fn table(value: impl Fn(usize) -> (f64, f64), period_s: f64) -> (tempfile::TempDir, PathBuf) {
    table_of(2000, value, period_s)
}

fn table_of(rows: usize, value: impl Fn(usize) -> (f64, f64), period_s: f64) -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("log.csv");
    let mut csv = "t,u_roll,p[rad/s]\n".to_string();
    for k in 0..rows {
        let (u, p) = value(k);
        csv.push_str(&format!("{},{u},{p}\n", k as f64 * period_s));
    }
    std::fs::write(&path, csv).unwrap();
    (dir, path)
}

fn refusal(value: impl Fn(usize) -> (f64, f64), period_s: f64) -> String {
    let (_dir, path) = table(value, period_s);
    draft(&[&path], &Names::default(), (None, None), &|_| ()).unwrap_err().to_string()
}

#[test]
fn rest_and_slow_logs_are_refused_with_the_reason() {
    let (a, b) = (noise(2000, 1), noise(2000, 2));
    let still = refusal(|k| (0.2, a[k]), 0.01);
    assert!(still.contains("at rest: no input changes (u_roll)"), "{still}");
    let quiet = refusal(|k| (b[k], 0.002 * a[k]), 0.01);
    assert!(quiet.contains("at rest: roll_rate"), "{quiet}");
    let slow = refusal(|k| (b[k], a[k]), 0.1);
    assert!(slow.contains("too slowly") && slow.contains("u_roll every 100 ms"), "{slow}");
    assert!(!slow.contains("--time"), "{slow}");
    // The sensor is read ten times a second, and its value repeated.
    let repeated = refusal(|k| (b[k], a[k / 10]), 0.01);
    assert!(repeated.contains("too slowly") && repeated.contains("p every 100 ms"), "{repeated}");
    let in_microseconds = refusal(|k| (b[k], a[k]), 10_000.0);
    assert!(in_microseconds.contains("10000 s apart") && in_microseconds.contains("--time COLUMN[us]"));
    let (_dir, path) = table(|k| (b[k], a[k]), 0.01);
    let names =
        Names { choice: Choice { inputs: vec!["u_rol".into()], outputs: Vec::new() }, ..Names::default() };
    let error = draft(&[&path], &names, (None, None), &|_| ()).unwrap_err().to_string();
    assert!(error.contains("--input u_rol: the log has no signal"), "{error}");
    let short = draft(&[&path], &Names::default(), (Some(0.0), Some(1.0)), &|_| ()).unwrap_err().to_string();
    assert!(short.contains("too short"), "{short}");
}

/// Without any force, the true model has no process noise either: its filter would never find the offset that the means of a
/// finite record leave. A model with a lag, whose noise follows any offset, is no better for that.
#[test]
fn a_quiet_record_has_no_lag_that_does_not_exist() {
    let (stick, sensor) = (noise(2000, 71), noise(2000, 72));
    let (mut rate, decay) = (0.0, (-4.0f64 * 0.01).exp());
    let rows: Vec<(f64, f64)> = (0..2000)
        .map(|k| {
            let (u, shown) = (stick[k / 40], rate + 0.0005 * sensor[k]);
            rate = decay * rate + (1.0 - decay) * u;
            (u, shown)
        })
        .collect();
    let (_dir, path) = table(|k| rows[k], 0.01);
    let found = draft(&[&path], &Names::default(), (None, None), &|_| ()).unwrap();
    assert_eq!(found.axes[0].words, "first order", "{}", found.text());
    let (pole, gain) = (parameter(&found, "A[1,1]"), parameter(&found, "B[1,1]"));
    assert!((pole + 4.0).abs() < 0.02 && (gain - 4.0).abs() < 0.02, "{}", found.text());
}

/// A stand is pushed three times at the beginning, and swings for the rest of the record. In blocks of a twelfth of it, all pushes
/// were in one third of the blocks; what the others told of their effect was worth nothing, and was counted against it.
/// And what swings with its motor off was taken for what stands on the ground.
#[test]
fn a_few_pushes_and_their_ringing_give_a_model() {
    const ROWS: usize = 6000;
    const PERIOD_S: f64 = 0.01;
    let (mut angle, mut rate) = (0.0, 0.0);
    let rows: Vec<(f64, f64)> = (0..ROWS)
        .map(|k| {
            let is_pushed = (40..440).contains(&k) && (k - 40) / 80 % 2 == 0;
            // An encoder of 0.01 rad.
            let (u, shown) = (if is_pushed { 5.0 } else { 0.0 }, f64::round(100.0 * angle) / 100.0);
            for _ in 0..20 {
                rate += PERIOD_S / 20.0 * (-16.0 * angle - 0.05 * rate + u);
                angle += PERIOD_S / 20.0 * rate;
            }
            (u, shown)
        })
        .collect();
    let (_dir, path) = table_of(ROWS, |k| rows[k], PERIOD_S);
    let found = draft(&[&path], &Names::default(), (None, None), &|_| ()).unwrap();
    assert!(found.flown.is_none(), "{}", found.text());
    let of_rounding = 0.01 / 12f64.sqrt();
    let stand = Vehicle::parse(&found.toml, "stand.toml").unwrap();
    let (noise, step) = (stand.outputs[0].noise, stand.outputs[0].quantization);
    assert!(
        (0.9 * of_rounding..3.0 * of_rounding).contains(&noise),
        "an encoder has the noise of its steps: {noise}"
    );
    assert!((step - 0.01).abs() < 1e-9, "{step}");
    let [stiffness, gain] = ["A[2,1]", "B[2,1]"].map(|name| parameter(&found, name));
    assert!((stiffness + 16.0).abs() < 0.3 && (gain - 1.0).abs() < 0.1, "{}", found.text());
}

/// What `blackbox_decode` writes: the time is its second column, in microseconds, and names have blanks before them.
#[test]
fn a_decoded_blackbox_is_known_by_its_names() {
    const PERIOD_US: usize = 2000;
    let (bits, sensor) = (noise(2000, 91), noise(2000, 92));
    let mut csv =
        "loopIteration, time (us), setpoint[0], setpoint[1], motor[0], gyroADC[0], gyroADC[1]\n".to_string();
    let mut rate = 0.0;
    for k in 0..2000 {
        let asked = f64::round(60.0 * bits[k / 40]);
        csv.push_str(&format!(
            "  {k}, {}, {asked}, 0, {}, {:.0}, 0\n",
            k * PERIOD_US,
            500 + k % 7,
            rate + 0.3 * sensor[k]
        ));
        rate += 20.0 * (asked - rate) * 1e-6 * PERIOD_US as f64;
    }
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("log.01.csv");
    std::fs::write(&path, csv).unwrap();
    let found = draft(&[&path], &Names::default(), (None, None), &|_| ()).unwrap();
    let [pole, gain] = ["A[1,1]", "B[1,1]"].map(|name| parameter(&found, name));
    // The setpoint is in rad/s, as the rate is.
    assert!((pole + 20.0).abs() < 1.0 && (gain - 20.0).abs() < 1.0, "{}", found.text());
    assert!(
        found.text().contains("u_roll = setpoint[0][deg/s]  recognised by name (Betaflight, decoded)"),
        "{}",
        found.text()
    );
}

/// A binary sequence is the same in many rows of a table; and ten samples a second suffice for an aeroplane.
#[test]
fn held_commands_and_slow_vehicles_are_not_logged_too_slowly() {
    let (bits, sensor) = (noise(2000, 61), noise(2000, 62));
    for (pole, hold, period_s) in [(-8.0f64, 7, 0.01), (-0.8, 20, 0.1)] {
        let (mut rate, decay) = (0.0, (pole * period_s).exp());
        let rows: Vec<(f64, f64)> = (0..2000)
            .map(|k| {
                let (u, shown) = (0.3 * bits[k / hold].signum(), rate + 0.005 * sensor[k]);
                rate = decay * rate + (1.0 - decay) * 3.0 * u;
                (u, shown)
            })
            .collect();
        let (_dir, path) = table(|k| rows[k], period_s);
        let found = draft(&[&path], &Names::default(), (None, None), &|_| ()).unwrap();
        assert_eq!(found.axes[0].intersample, "zoh", "{}", found.text());
        assert!((parameter(&found, "A[1,1]") / pole - 1.0).abs() < 0.1, "{}", found.text());
        assert!((parameter(&found, "B[1,1]") / (-3.0 * pole) - 1.0).abs() < 0.1, "{}", found.text());
    }
}

/// A surface whose position is measured moves on between its samples: taken for held, it would be half a step late.
#[test]
fn an_input_that_moves_between_its_samples_is_told() {
    const FINE: usize = 50;
    let (period_s, pole, sensor) = (0.02, -8.0f64, noise(2000, 63));
    let motion = |t: f64| {
        [(1.7, 0.0), (4.1, 1.0), (9.3, 2.0), (14.9, 3.0)].map(|(w, p)| (w * t + p).sin()).iter().sum::<f64>()
    };
    let (mut rate, dt) = (0.0, period_s / FINE as f64);
    let rows: Vec<(f64, f64)> = (0..2000)
        .map(|k| {
            let start = k as f64 * period_s;
            let row = (motion(start), rate + 0.005 * sensor[k]);
            for part in 0..FINE {
                rate += dt * (pole * rate + 24.0 * motion(start + (part as f64 + 0.5) * dt));
            }
            row
        })
        .collect();
    let (_dir, path) = table(|k| rows[k], period_s);
    let found = draft(&[&path], &Names::default(), (None, None), &|_| ()).unwrap();
    assert_eq!(
        (found.axes[0].intersample, found.axes[0].words.as_str()),
        ("foh", "first order"),
        "{}",
        found.text()
    );
    assert!(found.toml.contains("intersample = \"foh\""), "{}", found.toml);
    assert!((parameter(&found, "A[1,1]") / pole - 1.0).abs() < 0.05, "{}", found.text());
    assert!((parameter(&found, "B[1,1]") / 24.0 - 1.0).abs() < 0.05, "{}", found.text());
}

/// A vehicle that swings about its rest on a stand, turned by slow motors: its rate does not stay, so that no structure of a
/// rate has it, and the gyroscope is poor. Without a unit, an angle of up to 40 is one in degrees.
#[test]
fn an_angle_is_modelled_where_its_rate_is_not() {
    const STEPS: usize = 12_000;
    let (command, sensor, gyroscope) = (noise(STEPS, 81), noise(STEPS, 82), noise(STEPS, 83));
    let (dt, mut angle, mut rate, mut thrust) = (0.01, 0.0f64, 0.0, 0.0);
    let mut csv = "t,u_pitch,pitch,pitch_rate[rad/s]\n".to_string();
    for k in 0..STEPS {
        // Moved for six of every seventeen seconds.
        let u = if k % 1700 < 600 { command[k / 30] } else { 0.0 };
        let (shown, turned) = (angle.to_degrees() + 0.02 * sensor[k], rate + 2.5 * gyroscope[k]);
        csv.push_str(&format!("{},{u},{shown},{turned}\n", k as f64 * dt));
        for _ in 0..10 {
            thrust += 0.1 * dt * (u - thrust) / 0.2;
            rate += 0.1 * dt * (12.0 * thrust - 36.0 * angle - 1.2 * rate);
            angle += 0.1 * dt * rate;
        }
    }
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("stand.csv");
    std::fs::write(&path, csv).unwrap();
    let found = draft(&[&path], &Names::default(), (None, None), &|_| ()).unwrap();
    assert_eq!(found.axes[0].output, "pitch", "{}", found.text());
    assert!(found.toml.contains("\"pitch[deg]\""), "{}", found.toml);
    let left_out = &found.left_out[0];
    assert!(left_out.output == "pitch_rate" && left_out.why.contains("its angle"), "{left_out:?}");
    // Held-out parts begin in the middle of a motion, with the motor at a thrust that no output shows: a filter that does not
    // know it forecasts badly with the true structure, and well with a delay that does not exist.
    assert_eq!(found.axes[0].words, "second order with lag", "{}", found.text());
    assert_eq!(found.axes[0].intersample, "zoh", "a command that changes in steps is held: {}", found.text());
    let (stiffness, gain) = (parameter(&found, "A[2,1]"), parameter(&found, "B[2,1]"));
    assert!((stiffness / -36.0 - 1.0).abs() < 0.01 && (gain / 12.0 - 1.0).abs() < 0.02, "{}", found.text());
    assert!((parameter(&found, "actuator_lag") / 0.2 - 1.0).abs() < 0.03, "{}", found.text());
}
