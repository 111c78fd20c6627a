//! Effects of every kind that act for a part of the time: nothing before, the effect in its window, and no state jumps.

use whirlstand_vehicle::{Effect, Kind, Simulator, SimulatorError, Vehicle, Window};

use crate::support::{EFFECTS, effect};

const PERIOD: f64 = 0.005;

fn window(from_s: f64, until_s: f64) -> Window {
    Window { from_s: Some(from_s), until_s: Some(until_s) }
}

/// As in [`EFFECTS`]; a mode transition is moved to the boundary of a step, where one with a window begins, and limits are
/// so narrow that they are met.
fn own(text: &str) -> Effect {
    let mut effect = effect(text);
    let changes: &[(&str, f64)] = match effect.kind() {
        Kind::ModeTransition => &[("at_s", 1.0)],
        Kind::InputSaturation => &[("lower", -0.1), ("upper", 0.1)],
        Kind::OutputSaturation => &[("lower", -0.001), ("upper", 0.001)],
        Kind::RateLimit => &[("limit_per_s", 0.5)],
        Kind::StepDisturbance | Kind::PulseDisturbance => &[("at_s", 1.1012)],
        _ => &[],
    };
    changes.iter().for_each(|(name, value)| effect.set_parameter(name, *value).unwrap());
    effect
}

fn helicopter(effects: &[Effect]) -> Vehicle {
    let mut vehicle = Vehicle::builtin("helicopter-hover").unwrap();
    effects.iter().for_each(|e| vehicle.add_effect(e.clone()).unwrap());
    vehicle
}

/// States and outputs of every step under commands that move.
fn flown(vehicle: &Vehicle, steps: usize, mut each: impl FnMut(usize, &mut Simulator)) -> Vec<Vec<f64>> {
    let mut simulator = Simulator::new(vehicle, PERIOD, 3).unwrap();
    (0..steps)
        .map(|k| {
            each(k, &mut simulator);
            let t = k as f64 * PERIOD;
            simulator.apply(&[0.3 * (7.0 * t).sin(), 0.2 * (5.0 * t).cos()]);
            let row = simulator.measure().to_vec();
            let row = [simulator.state(), &row[..]].concat();
            simulator.advance();
            row
        })
        .collect()
}

fn furthest(a: &[Vec<f64>], b: &[Vec<f64>]) -> f64 {
    a.iter()
        .flatten()
        .zip(b.iter().flatten())
        .map(|(a, b)| (a - b).abs() / (1.0 + a.abs()))
        .fold(0.0, f64::max)
}

#[test]
fn a_window_from_the_beginning_is_the_effect_itself() {
    for text in EFFECTS {
        let always = flown(&helicopter(&[own(text)]), 600, |_, _| {});
        let part = own(text).during(window(0.0, 100.0)).unwrap();
        let part = flown(&helicopter(&[part]), 600, |_, _| {});
        assert!(furthest(&always, &part) < 1e-9, "{text}: {}", furthest(&always, &part));
    }
}

#[test]
fn nothing_happens_before_the_window_and_something_in_it() {
    let clean = flown(&helicopter(&[]), 600, |_, _| {});
    for text in EFFECTS {
        let part = helicopter(&[own(text).during(window(1.0, 2.5)).unwrap()]);
        let path = flown(&part, 600, |_, _| {});
        // A step that a delay or the edge of a disturbance cuts is rounded otherwise.
        assert!(furthest(&path[..200], &clean[..200]) < 1e-12, "{text}");
        assert!(path[200..500] != clean[200..500], "{text} does nothing");
        let by_hand = flown(&part, 600, |k, simulator| {
            if k == 0 {
                assert!(simulator.switch(0, false), "{text}");
            }
        });
        let off_by = furthest(&by_hand, &clean);
        assert!(off_by < 1e-12, "{text}, switched off by hand: {off_by:e}");
    }
}

/// x' = u, measured as it is.
fn integrator(effect: Effect) -> Vehicle {
    let text = "A = [[0.0]]\nB = [[1.0]]\nstates = [{ name = 'v' }]\ninputs = [{ name = 'u' }]\n";
    let mut vehicle = Vehicle::parse(text, "integrator").unwrap();
    vehicle.add_effect(effect).unwrap();
    vehicle
}

/// The state of the integrator at every step under `u`.
fn integrated(effect: Effect, u: impl Fn(f64) -> f64) -> Vec<f64> {
    let mut simulator = Simulator::new(&integrator(effect), PERIOD, 1).unwrap();
    (0..400)
        .map(|k| {
            let x = simulator.state()[0];
            simulator.step(&[u(k as f64 * PERIOD)]);
            x
        })
        .collect()
}

#[test]
fn a_lag_begins_where_its_input_is_and_leaves_it_there() {
    let lag = Effect::new(Kind::ActuatorLag, "u", &[("time_constant_s", 0.1)]).unwrap();
    // The command steps from 1 to 2 at the moment at which the lag begins.
    let x = integrated(lag.during(window(0.5, 1.0)).unwrap(), |t| if t < 0.5 - 1e-9 { 1.0 } else { 2.0 });
    for k in [100, 101, 130, 200, 201, 399] {
        let t = k as f64 * PERIOD - 0.5;
        let lagged = |t: f64| 2.0 * t - 0.1 * (1.0 - (-t / 0.1).exp());
        let expected = 0.5 + if t < 0.5 { lagged(t) } else { lagged(0.5) + 2.0 * (t - 0.5) };
        assert!((x[k] - expected).abs() < 1e-12, "step {k}: {} is not {expected}", x[k]);
    }
}

#[test]
fn a_delay_has_run_all_the_time() {
    let delay = Effect::new(Kind::InputDelay, "u", &[("delay_s", 0.052)]).unwrap();
    let ramp = |t: f64| t;
    let x = integrated(delay.during(window(0.5, 1.0)).unwrap(), ramp);
    // The command of step j is held over its period; in the window it acts 10.4 periods later.
    let held = |t: f64| ramp(((t / PERIOD) + 1e-6).floor() * PERIOD);
    let mut expected = 0.0;
    for (k, x) in x.iter().enumerate() {
        assert!((x - expected).abs() < 1e-12, "step {k}: {x} is not {expected}");
        let t = k as f64 * PERIOD;
        let acts = |offset: f64| {
            let late = if (100..200).contains(&k) { 0.052 } else { 0.0 };
            held(t + offset - late)
        };
        // A step in fifths, so that a piece is constant.
        expected += (0..5).map(|i| 0.2 * PERIOD * acts((i as f64 + 0.5) * 0.2 * PERIOD)).sum::<f64>();
    }
}

#[test]
fn a_parameter_changes_and_the_state_goes_on() {
    let change = Effect::new(Kind::ParameterChange, "A[1,1]", &[("value", -2.0)]).unwrap();
    let x = integrated(change.during(window(0.5, 1.0)).unwrap(), |_| 1.0);
    let decayed = |t: f64| 0.5 + (0.5 - 0.5) * (-2.0 * t).exp();
    for (k, expected) in [(100, 0.5), (150, decayed(0.25)), (200, decayed(0.5)), (300, 1.0)] {
        assert!((x[k] - expected).abs() < 1e-12, "step {k}: {}", x[k]);
    }
    let change = Effect::new(Kind::ParameterChange, "B[1,1]", &[("factor", 3.0)]).unwrap();
    let x = integrated(change.during(window(0.5, 1.0)).unwrap(), |_| 1.0);
    assert!((x[300] - (0.5 + 1.5 + 0.5)).abs() < 1e-12, "{}", x[300]);
}

#[test]
fn friction_brakes_in_its_window_only() {
    let friction = Effect::new(Kind::CoulombFriction, "v", &[("level", 0.5)]).unwrap();
    let x =
        integrated(friction.during(window(0.5, 1.0)).unwrap(), |t| if t < 0.5 - 1e-9 { 1.0 } else { 0.0 });
    for (k, expected) in [(100, 0.5), (150, 0.375), (200, 0.25), (399, 0.25)] {
        assert!((x[k] - expected).abs() < 1e-9, "step {k}: {}", x[k]);
    }
}

#[test]
fn blocks_of_steps_are_the_steps_one_by_one() {
    for text in EFFECTS {
        let vehicle = helicopter(&[own(text).during(window(0.7, 1.6)).unwrap()]);
        let inputs: Vec<f64> = (0..800).map(|k| 0.3 * (0.03 * k as f64).sin()).collect();
        let mut outputs = vec![0.0; 400 * vehicle.outputs.len()];
        Simulator::expected(&vehicle, PERIOD).unwrap().run(&inputs, &mut outputs);
        let mut single = Simulator::expected(&vehicle, PERIOD).unwrap();
        for (u, y) in inputs.chunks(2).zip(outputs.chunks(vehicle.outputs.len())) {
            single.apply(u);
            assert_eq!(single.measure(), y, "{text}");
            single.advance();
        }
    }
}

#[test]
fn too_many_windows_are_refused_with_the_number_that_can_be() {
    let gain = |k: usize| {
        let parameters = [("time_constant_s", 0.01 * k as f64)];
        Effect::new(Kind::ActuatorLag, "u_roll", &parameters).unwrap().during(window(1.0, 2.0)).unwrap()
    };
    let six: Vec<Effect> = (1..=6).map(gain).collect();
    Simulator::new(&helicopter(&six), PERIOD, 1).unwrap();
    let seven: Vec<Effect> = (1..=7).map(gain).collect();
    let error = Simulator::new(&helicopter(&seven), PERIOD, 1).unwrap_err();
    assert!(matches!(error, SimulatorError::Windows { found: 7, most: 6 }), "{error}");
}

#[test]
fn what_an_effect_remembers_can_be_put_where_it_stood() {
    let cart = |effect: Effect| {
        let text = "A = [[0.0]]\nB = [[1.0]]\nstates = [{ name = 'v' }]\ninputs = [{ name = 'u' }]\n";
        let mut vehicle = Vehicle::parse(text, "cart").unwrap();
        vehicle.add_effect(effect).unwrap();
        Simulator::expected(&vehicle, 0.1).unwrap()
    };
    // The speed after a second without any command, from where the memory stood at 1.
    for (kind, parameter, value, speed) in [
        (Kind::ActuatorLag, "time_constant_s", 0.5, 0.5 * (1.0 - (-2.0_f64).exp())),
        (Kind::RateLimit, "limit_per_s", 2.0, 0.25),
        (Kind::Backlash, "width", 0.6, 0.3),
    ] {
        let mut simulator = cart(Effect::new(kind, "u", &[(parameter, value)]).unwrap());
        assert!(simulator.put(0, 1.0) && !simulator.put(1, 1.0), "{kind}");
        (0..10).for_each(|_| simulator.step(&[0.0]));
        assert!((simulator.state()[0] - speed).abs() < 1e-12, "{kind}: {}", simulator.state()[0]);
    }
    assert!(!cart(Effect::new(Kind::InputGain, "u", &[("factor", 0.5)]).unwrap()).put(0, 1.0));
}
