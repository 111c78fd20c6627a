//! Drafts of simulated records whose true structure is known.

use std::path::PathBuf;

use whirlstand_test_harness::noise;
use whirlstand_vehicle::{Matrix, Simulator, Target, Vehicle};

use super::{Draft, DraftError, Names, draft};

mod several;
mod tables;

const PERIOD_S: f64 = 0.01;

/// Writes 60 s at 100 Hz of a roll rate that responds to u_roll according to `model`, with process noise and
/// a controller in the loop.
fn flight(dir: &tempfile::TempDir, model: &str, acting: bool) -> PathBuf {
    flight_at(dir, model, acting, PERIOD_S)
}

/// As [`flight`], at another rate, with at most 15,000 steps.
fn flight_at(dir: &tempfile::TempDir, model: &str, acting: bool, period_s: f64) -> PathBuf {
    let text = format!(
        "{model}\ninputs = [{{ name = \"u_roll\" }}]\noutputs = [{{ name = \"roll_rate\", unit = \"rad/s\" }}]\n"
    );
    let vehicle = Vehicle::parse(&text, "true.toml").unwrap();
    let mut simulator = Simulator::expected(&vehicle, period_s).unwrap();
    let steps = 15_000.min((60.0 / period_s) as usize);
    let (often, share) = ((0.4 / period_s).round() as usize, (period_s / PERIOD_S).sqrt());
    let (gusts, sensor, stick) = (noise(steps, 1), noise(steps, 2), noise(steps, 3));
    let mut csv = "t,u_roll,roll_rate[rad/s]\n".to_string();
    let (mut wanted, mut y) = (0.0, 0.0);
    let n = vehicle.states.len();
    for k in 0..steps {
        if k % often == 0 {
            wanted = 0.6 * stick[k];
        }
        let u = 0.3 * (wanted - y) + 0.02 * stick[steps - 1 - k];
        simulator.apply(&[if acting { u } else { 0.0 }]);
        y = simulator.measure()[0] + 0.01 * sensor[k];
        csv.push_str(&format!("{},{u},{y}\n", k as f64 * period_s));
        simulator.advance();
        let mut gust = vec![0.0; n];
        gust[n - 1] = 0.02 * share * gusts[k] * if n == 2 { 10.0 } else { 1.0 };
        simulator.correct(&gust);
    }
    let path = dir.path().join("flight.csv");
    std::fs::write(&path, csv).unwrap();
    path
}

const FIRST: &str = "A = [[-8.0]]\nB = [[24.0]]\nstates = [{ name = \"roll_rate\", unit = \"rad/s\" }]";
const SECOND: &str = "A = [[0.0, 1.0], [-200.0, -12.0]]\nB = [[0.0], [400.0]]\nstates = [{ name = \"roll_rate\", unit = \"rad/s\" }, { name = \"slope\", unit = \"rad/s^2\" }]\nC = [[1.0, 0.0]]";

fn effect(kind: &str, parameter: &str, value: f64) -> String {
    format!("effects = [{{ effect = \"{kind}\", where = \"u_roll\", {parameter} = {value:?} }}]")
}

fn drafted(model: &str) -> Draft {
    let dir = tempfile::tempdir().unwrap();
    draft(&[flight(&dir, model, true)], &Names::default(), (None, None), &|_| ()).unwrap()
}

fn parameter(draft: &Draft, name: &str) -> f64 {
    let found = draft.axes[0].parameters.iter().find(|p| p.name.starts_with(name));
    found.unwrap_or_else(|| panic!("no {name} in {}", draft.text())).value
}

#[test]
fn a_first_order_axis_is_found_as_one() {
    let found = drafted(FIRST);
    let axis = &found.axes[0];
    assert_eq!(axis.words, "first order", "{}", found.text());
    assert!((parameter(&found, "A[1,1]") + 8.0).abs() < 1.0, "{}", found.text());
    assert!((parameter(&found, "B[1,1]") - 24.0).abs() < 2.0, "{}", found.text());
    assert!(axis.heldout.fit > axis.heldout.own_past_fit + 5.0, "{}", found.text());
    let vehicle = Vehicle::parse(&found.toml, "flight.toml").unwrap();
    // Sample-to-sample gusts look like sensor noise too.
    assert!(vehicle.inputs[0].upper.is_finite() && (0.008..0.03).contains(&vehicle.outputs[0].noise));
    assert!(found.toml.starts_with("# A first vehicle file"), "{}", found.toml);
}

#[test]
fn an_output_that_stands_still_is_left_out_as_such() {
    let dir = tempfile::tempdir().unwrap();
    let path = flight(&dir, FIRST, true);
    let text = std::fs::read_to_string(&path).unwrap();
    let mut lines = text.lines();
    let mut csv = format!("{},pitch_rate[rad/s]\n", lines.next().unwrap());
    lines.for_each(|line| csv.push_str(&format!("{line},0\n")));
    std::fs::write(&path, csv).unwrap();
    let found = draft(&[&path], &Names::default(), (None, None), &|_| ()).unwrap();
    let left_out: Vec<_> = found.left_out.iter().map(|l| (l.output.as_str(), l.why.as_str())).collect();
    assert_eq!(left_out, [("pitch_rate", "it does not change")]);
}

#[test]
fn a_delay_is_found_with_its_length() {
    let found = drafted(&format!("{FIRST}\n{}", effect("input_delay", "delay_s", 0.05)));
    assert!(found.axes[0].structure.delay && found.axes[0].structure.order == 1, "{}", found.text());
    assert!((parameter(&found, "input_delay") - 0.05).abs() < 0.006, "{}", found.text());
}

#[test]
fn a_lag_is_found_with_its_time_constant() {
    let found = drafted(&format!("{FIRST}\n{}", effect("actuator_lag", "time_constant_s", 0.06)));
    let axis = &found.axes[0];
    // A second-order motion with two real poles has the same response.
    assert!(axis.structure.lag || axis.structure.order == 2, "{}", found.text());
    if axis.structure.lag {
        assert!((parameter(&found, "actuator_lag") - 0.06).abs() < 0.02, "{}", found.text());
    }
}

#[test]
fn a_motion_that_rings_is_of_second_order() {
    let found = drafted(SECOND);
    assert_eq!(found.axes[0].structure.order, 2, "{}", found.text());
    assert!((parameter(&found, "A[2,1]") + 200.0).abs() < 40.0, "{}", found.text());
}

#[test]
fn actuators_that_do_nothing_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = flight(&dir, SECOND, false);
    let error = draft(&[&path], &Names::default(), (None, None), &|_| ()).unwrap_err();
    assert!(matches!(error, DraftError::Unexplained { .. }), "{error}");
    assert!(error.to_string().contains("the record shows no effect of the actuators"), "{error}");
}

/// A rate whose disturbances grow, driven by a motor with a lag of 50 ms, held by a law that sees it 200 times a second.
fn unstable(dir: &tempfile::TempDir, growth: f64) -> PathBuf {
    const FINE: usize = 5;
    let (period_s, steps, lag_s) = (0.005, 6000, 0.05);
    let (gusts, sensor, stick) = (noise(steps, 31), noise(steps, 32), noise(steps, 33));
    let mut csv = "t,u_roll,roll_rate[rad/s]\n".to_string();
    let (mut rate, mut torque, mut wanted) = (0.0, 0.0, 0.0);
    for k in 0..steps {
        if k % 100 == 0 {
            wanted = 0.5 * stick[k];
        }
        let y = rate + 0.005 * sensor[k];
        // The law knows its motor: without its lead an axis that doubles within 60 ms could not be held.
        let u = 1.5 * (wanted - y) - 0.5 * torque;
        csv.push_str(&format!("{},{u},{y}\n", k as f64 * period_s));
        for _ in 0..FINE {
            let dt = period_s / FINE as f64;
            torque += dt / lag_s * (u - torque);
            rate += dt * (growth * rate + 40.0 * torque + 0.5 * gusts[k]);
        }
    }
    let path = dir.path().join("unstable.csv");
    std::fs::write(&path, csv).unwrap();
    path
}

/// The fastest growth that a draft may find is 10 1/s: an axis beyond it is told with that value, and not by a structure
/// that predicts it worse and stays within bounds.
#[test]
fn an_unstable_axis_is_drafted_with_its_motor() {
    let dir = tempfile::tempdir().unwrap();
    for (growth, within) in [(3.0, 2.4..3.6), (12.0, 9.0..10.0 + 1e-9)] {
        let found = draft(&[unstable(&dir, growth)], &Names::default(), (None, None), &|_| ()).unwrap();
        assert!(found.axes[0].structure.lag, "{growth}: {}", found.text());
        assert!(within.contains(&parameter(&found, "A[1,1]")), "{growth}: {}", found.text());
        let lag_s = parameter(&found, "actuator_lag");
        assert!((0.04..0.06).contains(&lag_s), "{growth}: {}", found.text());
    }
}

/// A recorder that loses 4 to 20 samples 200 times in 30 s: no stretch between two gaps is long.
#[test]
fn lost_samples_are_no_end_of_a_record() {
    let dir = tempfile::tempdir().unwrap();
    let path = flight_at(&dir, FIRST, true, 0.002);
    let text = std::fs::read_to_string(&path).unwrap();
    let (lengths, starts) = (noise(200, 41), noise(200, 42));
    let lost = |k: usize| {
        let (gap, at) = (k / 75, k % 75);
        let from = (20.0 + 10.0 * starts[gap % 200].clamp(-1.5, 1.5)) as usize;
        (from..from + (12.0 + 4.0 * lengths[gap % 200].clamp(-2.0, 2.0)) as usize).contains(&at)
    };
    let kept = text.lines().enumerate().filter(|(k, _)| *k == 0 || !lost(*k)).map(|(_, line)| line);
    let gappy = dir.path().join("gappy.csv");
    std::fs::write(&gappy, kept.collect::<Vec<_>>().join("\n")).unwrap();
    for path in [path, gappy] {
        let found = draft(&[&path], &Names::default(), (None, None), &|_| ()).unwrap();
        // Averaged to coarser steps, a lost sample may leave a pole as fast as those beside the true one.
        let vehicle = Vehicle::parse(&found.toml, "true.toml").unwrap();
        let slowest = vehicle.poles().unwrap()[0].re;
        assert!((slowest + 8.0).abs() < 1.2, "{}", found.text());
        let settled = -(&vehicle.c * vehicle.a.clone().try_inverse().unwrap() * &vehicle.b)[(0, 0)];
        assert!((settled - 3.0).abs() < 0.3, "{settled}: {}", found.text());
    }
}

/// A body that turns freely in gusts with a spectrum of their own, held by a law, with a motor of 60 ms; it is turned to
/// another angle from time to time. Where the motor does not act, the body swings back by itself.
fn in_gusts(dir: &tempfile::TempDir, acting: bool, seed: u64) -> PathBuf {
    const FINE: usize = 5;
    let (period_s, steps) = (0.01, 6000);
    let (gusts, sensor, wanted) =
        (noise(FINE * steps, seed), noise(steps, seed + 1), noise(steps / 200, seed + 2));
    let mut csv = "t,u_roll,roll_rate[rad/s]\n".to_string();
    let (mut rate, mut angle, mut torque, mut gust, mut change) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for k in 0..steps {
        let aim = if k % 200 < 80 { 0.1 * wanted[k / 200] } else { 0.0 };
        let u: f64 = 0.6 * (aim - angle) - 0.12 * rate;
        csv.push_str(&format!("{},{u},{}\n", k as f64 * period_s, rate + 0.003 * sensor[k]));
        for part in 0..FINE {
            let dt = period_s / FINE as f64;
            torque += dt / 0.06 * (u - torque);
            change += dt * (-60.0 * gust - 6.0 * change) + dt.sqrt() * 60.0 * gusts[FINE * k + part];
            gust += dt * change;
            rate +=
                dt * if acting { -rate + 60.0 * torque + gust } else { -4.0 * rate - 20.0 * angle + gust };
            angle += dt * rate;
        }
    }
    let path = dir.path().join("gusts.csv");
    std::fs::write(&path, csv).unwrap();
    path
}

/// The past of the output foretells the gusts, which the model's forces do not: alone, the right model predicts less than
/// that past. And a third of the flight has too few manoeuvres to tell what the input does.
#[test]
fn an_input_that_acts_in_gusts_is_told_from_one_that_does_not() {
    let dir = tempfile::tempdir().unwrap();
    let found = draft(&[in_gusts(&dir, true, 51)], &Names::default(), (None, None), &|_| ()).unwrap();
    let held_out = &found.axes[0].heldout;
    assert!(held_out.completed_fit > held_out.own_past_fit.max(held_out.fit), "{}", found.text());
    assert!(found.axes[0].structure.lag, "{}", found.text());
    assert!((54.0..66.0).contains(&parameter(&found, "B[1,1]")), "{}", found.text());
    assert!((0.05..0.075).contains(&parameter(&found, "actuator_lag")), "{}", found.text());
    let error = draft(&[in_gusts(&dir, false, 51)], &Names::default(), (None, None), &|_| ()).unwrap_err();
    assert!(matches!(error, DraftError::Unexplained { .. }), "{error}");
}

/// A freely rotating body (torque over inertia, motors with a lag of 50 ms) with a swinging load below it,
/// and an attitude controller that reacts to the load: most of the input cancels the disturbance.
fn under_a_swinging_load(dir: &tempfile::TempDir, acting: bool) -> PathBuf {
    let period_s = 0.005;
    let steps = 6000;
    let (pushes, sensor, hand) = (noise(steps, 11), noise(steps, 12), noise(steps, 13));
    let mut csv = "t,u_roll,roll_rate[rad/s]\n".to_string();
    let (mut angle, mut rate, mut torque) = (0.0, 0.0, 0.0);
    let (mut load, mut swing) = (0.0, 0.0);
    for k in 0..steps {
        let y = rate + 0.005 * sensor[k];
        let wanted = if k % 200 < 100 { 0.02 * hand[k / 100 * 100] } else { 0.0 };
        let u = 0.6 * (wanted - angle) - 0.08 * y;
        csv.push_str(&format!("{},{u},{y}\n", k as f64 * period_s));
        // The load swings at 1.6 Hz, lightly damped, excited by the air.
        swing += period_s * (-100.0 * load - 1.0 * swing + 400.0 * pushes[k]);
        load += period_s * swing;
        let acts = if acting { 60.0 * torque } else { -20.0 * angle - 4.0 * rate };
        rate += period_s * (acts + 0.5 * load);
        angle += period_s * rate;
        torque += period_s / 0.05 * (u - torque);
    }
    let path = dir.path().join("load.csv");
    std::fs::write(&path, csv).unwrap();
    path
}

#[test]
fn an_input_that_mostly_cancels_a_disturbance_acts() {
    let dir = tempfile::tempdir().unwrap();
    let path = under_a_swinging_load(&dir, true);
    let found = draft(&[&path], &Names::default(), (None, None), &|_| ()).unwrap();
    let axis = &found.axes[0];
    assert!(axis.structure.lag || axis.structure.delay, "{}", found.text());
    assert!((30.0..90.0).contains(&parameter(&found, "B[1,1]")), "{}", found.text());
    let path = under_a_swinging_load(&dir, false);
    let error = draft(&[&path], &Names::default(), (None, None), &|_| ()).unwrap_err();
    assert!(matches!(error, DraftError::Unexplained { .. }), "{error}");
}

/// A quadrotor flown by a law over four rotors that lag by 0.06 s, 60 s at 100 Hz, as a Crazyflie logs it.
fn quadrotor(dir: &tempfile::TempDir) -> PathBuf {
    const SIGNS: [[f64; 4]; 3] = [[-1.0, -1.0, 1.0, 1.0], [1.0, -1.0, -1.0, 1.0], [1.0, -1.0, 1.0, -1.0]];
    const GAINS: [f64; 3] = [40.0, 40.0, 10.0];
    const FINE: usize = 5;
    let steps = 6000;
    let dt = PERIOD_S / FINE as f64;
    let series: Vec<Vec<f64>> = (0..9).map(|i| noise(steps, 20 + i)).collect();
    let random = |i: usize, k: usize| series[i][k];
    let mut csv = "t,motor.m1,motor.m2,motor.m3,motor.m4,gyro.x,gyro.y,gyro.z\n".to_string();
    let (mut rates, mut rotors, mut wanted) = ([0.0f64; 3], [0.5f64; 4], [0.0; 3]);
    for k in 0..steps {
        if k % 50 == 0 {
            wanted = [0, 1, 2].map(|i| random(i, k));
        }
        let measured = [0, 1, 2].map(|i| rates[i] + 0.01 * random(3 + i, k));
        let mut commands = [0.5; 4];
        for i in 0..3 {
            let asked = 2.0 / GAINS[i] * (wanted[i] - measured[i]);
            commands.iter_mut().zip(SIGNS[i]).for_each(|(u, sign)| *u += sign * asked);
        }
        let [m1, m2, m3, m4] = commands;
        let [p, q, r] = measured.map(f64::to_degrees);
        csv.push_str(&format!("{},{m1},{m2},{m3},{m4},{p},{q},{r}\n", k as f64 * PERIOD_S));
        for _ in 0..FINE {
            rotors.iter_mut().zip(commands).for_each(|(x, u)| *x += dt * (u - *x) / 0.06);
            for i in 0..3 {
                let torque: f64 = SIGNS[i].iter().zip(rotors).map(|(sign, x)| sign * x).sum();
                rates[i] += dt * (GAINS[i] * torque - rates[i] + 0.5 * random(6 + i, k));
            }
        }
    }
    let path = dir.path().join("crazyflie.csv");
    std::fs::write(&path, csv).unwrap();
    path
}

#[test]
fn rotors_of_a_quadrotor_drive_its_axes_together() {
    let dir = tempfile::tempdir().unwrap();
    let found = draft(&[quadrotor(&dir)], &Names::default(), (None, None), &|_| ()).unwrap();
    assert_eq!(found.axes.len(), 3, "{}", found.text());
    let vehicle = Vehicle::parse(&found.toml, "crazyflie.toml").unwrap();
    assert_eq!(vehicle.inputs.len(), 4, "{}", found.toml);
    let patterns = [[-1.0, -1.0, 1.0, 1.0], [1.0, -1.0, -1.0, 1.0], [1.0, -1.0, 1.0, -1.0]];
    for (output, (signs, name)) in patterns.iter().zip(["roll_rate", "pitch_rate", "yaw_rate"]).enumerate() {
        assert_eq!(vehicle.outputs[output].name, name);
        // Total gain of a rotor at the state that it drives.
        let first = vehicle.state_index(name).unwrap();
        let row = (first..vehicle.states.len()).find(|i| vehicle.b[(*i, 0)] != 0.0).unwrap();
        let gains: Vec<f64> = (0..4).map(|j| vehicle.b[(row, j)] * signs[j]).collect();
        assert!(gains.iter().all(|g| *g > 0.0 && *g == gains[0]), "{name}: {gains:?}\n{}", found.text());
    }
    // Motors have the same lag: each is named once, or the motion has the lag as its own pole.
    let lags = vehicle.effects.iter().filter(|e| e.kind() == whirlstand_vehicle::Kind::ActuatorLag).count();
    assert!(lags == 0 || lags == 4, "{}", found.toml);
    assert_eq!(vehicle.map.iter().filter(|(_, source)| source.starts_with("motor.m")).count(), 4);
    // One by one the rotors' gains and lags are not determined: an identification must not untie them.
    let own = |free: &whirlstand_vehicle::Free| matches!(free.target, Target::Entry(Matrix::A, ..));
    assert!(!vehicle.free.is_empty() && vehicle.free.iter().all(own), "{}", found.toml);
}

#[test]
fn inputs_that_explain_nothing_are_followed_by_the_next() {
    let dir = tempfile::tempdir().unwrap();
    let path = quadrotor(&dir);
    // What a program writes beside its motors, and what has nothing to do with them.
    let idle = noise(6000, 77);
    let text = std::fs::read_to_string(&path).unwrap();
    let extended = text.lines().enumerate().map(|(k, line)| match k {
        0 => format!("{line},controller.cmd_roll\n"),
        k => format!("{line},{}\n", idle[(k - 1) / 40 * 40]),
    });
    std::fs::write(&path, extended.collect::<String>()).unwrap();
    let found = draft(&[&path], &Names::default(), (None, None), &|_| ()).unwrap();
    let inputs: Vec<&str> = found.axes.iter().map(|axis| axis.input.as_str()).collect();
    assert!(inputs.len() == 3 && inputs.iter().all(|input| input.contains("motor")), "{}", found.text());
}
