//! What is taken back of effects that are not linear: the gain in the loop, the bounds, and what is declined.

use nalgebra::DVector;
use whirlstand_control::{
    Compensation, Controller, Declined, Design, Estimator, EstimatorOptions, InputLimits, LawOptions,
    LqrOptions, SampledPlant, Selector, Sensors,
};
use whirlstand_vehicle::{Effect, Kind, LinearModel, Simulator, Vehicle};

use crate::support::ALL;

const PERIOD: f64 = 0.005;
const REACH: f64 = 20.0;

/// Effect, place and parameters.
type Given<'a> = (Kind, &'a str, &'a [(&'a str, f64)]);

struct Bench {
    vehicle: Vehicle,
    linear: LinearModel,
    design: Design,
    estimator: Estimator,
}

fn bench(effects: &[Given<'_>], rate: f64) -> Bench {
    let mut vehicle = Vehicle::builtin("quadrotor").expect("built in");
    for (kind, place, parameters) in effects {
        vehicle.add_effect(Effect::new(*kind, place, parameters).expect("in range")).expect("fits");
    }
    let linear = LinearModel::new(&vehicle).expect("fits");
    let limits = InputLimits { lower: -REACH, upper: REACH, rate };
    let names = |list: Vec<&str>| list.into_iter().map(str::to_owned).collect::<Vec<_>>();
    let plant = SampledPlant::of(&linear, PERIOD)
        .and_then(|p| p.with_limits(vec![limits; 2]))
        .and_then(|p| {
            let states = names(vehicle.states.iter().map(|s| s.name.as_str()).collect());
            p.with_names(states, names(vehicle.inputs.iter().map(|i| i.name.as_str()).collect()))
        })
        .expect("sound");
    let sensors = Sensors {
        c: linear.c.columns(0, linear.own).into_owned(),
        d: linear.d.clone(),
        std: vehicle.outputs.iter().map(|o| o.noise.max(1e-6)).collect(),
        names: vehicle.outputs.iter().map(|o| o.name.clone()).collect(),
    };
    let estimator = Estimator::of(&plant, &sensors, Some(&linear), &EstimatorOptions::default());
    let options = LqrOptions { integral: vec![Selector::Index(0)], ..LqrOptions::default() };
    let design = Design::new(&plant, &LawOptions::Lqr(options)).expect("controllable");
    Bench { estimator: estimator.expect("observable"), vehicle, linear, design }
}

fn declined(bench: &Bench) -> Vec<Declined> {
    Controller::new(&bench.design).compensate(&bench.design, &bench.linear, &ALL)
}

/// How a flight's roll is asked for, step by step.
type Wanted<'a> = &'a dyn Fn(u64) -> f64;

/// The roll of a flight of 16 s, and the largest command.
fn fly(flown: &Vehicle, bench: &Bench, asked: &[Compensation], wanted: Wanted<'_>) -> (Vec<f64>, f64) {
    let mut controller = Controller::new(&bench.design);
    assert_eq!(controller.compensate(&bench.design, &bench.linear, asked), []);
    let mut estimator = bench.estimator.clone();
    let mut simulator = Simulator::new(flown, PERIOD, 1).expect("slow enough");
    let (mut now, mut next, mut most) = ([0.0; 2], [0.0; 2], 0f64);
    let roll = (0..3200).map(|k| {
        let before = now;
        now = next;
        simulator.apply(&now);
        let y = simulator.measure().to_vec();
        estimator.step(&y, u64::MAX, &before, &now);
        controller.step(estimator.x(), &[wanted(k), 0.0, 0.0, 0.0], 1, &mut next);
        most = most.max(next[0].abs());
        simulator.advance();
        simulator.state()[0]
    });
    (roll.collect(), most)
}

/// Square of the error to what was wanted, and to the same flight of a vehicle without the effect: with over without.
fn gain(effect: Given<'_>, asked: Compensation, wanted: Wanted<'_>) -> [f64; 2] {
    let (bench, plain) = (bench(&[effect], f64::INFINITY), bench(&[], f64::INFINITY));
    let (ideal, _) = fly(&plain.vehicle, &plain, &[], wanted);
    let flights = [vec![], vec![asked]].map(|asked| {
        let (roll, most) = fly(&bench.vehicle, &bench, &asked, wanted);
        assert!(most <= REACH, "{most}");
        let errors = roll.iter().zip(&ideal).enumerate();
        errors.fold([0.0, 0.0], |[e, d], (k, (roll, ideal))| {
            [e + (roll - wanted(k as u64)).powi(2), d + (roll - ideal).powi(2)]
        })
    });
    let answer = [0, 1].map(|i| flights[1][i] / flights[0][i]);
    println!("{effect:?}: error times {:.3}, distance times {:.2e}", answer[0], answer[1]);
    answer
}

#[test]
fn every_compensation_brings_the_flight_closer_to_that_without_the_effect() {
    let sine: Wanted<'_> = &|k| 0.01 * (std::f64::consts::TAU * k as f64 * PERIOD / 8.0).sin();
    for (effect, asked, most) in [
        ((Kind::DeadZone, "u_roll", &[("width", 1.0)][..]), Compensation::DeadZone, 0.01),
        ((Kind::Backlash, "u_roll", &[("width", 3.0)]), Compensation::Backlash, 0.05),
        ((Kind::CoulombFriction, "roll_rate", &[("level", 0.01)]), Compensation::CoulombFriction, 0.3),
        ((Kind::GainDrift, "u_roll", &[("rate_per_s", -0.03)]), Compensation::GainDrift, 1e-9),
    ] {
        let [_, closer] = gain(effect, asked, sine);
        assert!(closer < most, "{}: {closer}", asked.name());
    }
    // Limits cannot be taken back; what the law knows of them keeps its integrator from winding up.
    let steps: Wanted<'_> = &|k| if k / 400 % 2 == 0 { 0.01 } else { -0.01 };
    for (effect, asked) in [
        (
            (Kind::InputSaturation, "u_roll", &[("lower", -0.6), ("upper", 0.6)][..]),
            Compensation::InputSaturation,
        ),
        ((Kind::RateLimit, "u_roll", &[("limit_per_s", 3.0)]), Compensation::RateLimit),
    ] {
        let [less, _] = gain(effect, asked, steps);
        assert!(less < 0.6, "{}: {less}", asked.name());
    }
}

#[test]
fn a_filter_knows_what_acts_of_a_command() {
    let bench = bench(
        &[
            (Kind::InputGain, "u_roll", &[("factor", 0.5)]),
            (Kind::InputBias, "u_roll", &[("offset", 0.4)]),
            (Kind::GainDrift, "u_roll", &[("rate_per_s", 0.05)]),
            (Kind::DeadZone, "u_roll", &[("width", 0.3)]),
            (Kind::InputSaturation, "u_roll", &[("lower", -3.0), ("upper", 2.0)]),
            (Kind::RateLimit, "u_roll", &[("limit_per_s", 15.0)]),
            (Kind::Backlash, "u_roll", &[("width", 0.8)]),
        ],
        f64::INFINITY,
    );
    // Without a measurement the filter goes by its commands alone: it stays with the vehicle.
    let mut estimator = bench.estimator.clone();
    let mut simulator = Simulator::new(&bench.vehicle, PERIOD, 1).expect("slow enough");
    let mut before = [0.0; 2];
    for k in 0..2000u32 {
        let now = [9.0 * (f64::from(k) * 0.03).sin(), 0.0];
        simulator.apply(&now);
        estimator.step(&[0.0; 4], 0, &before, &now);
        let (truth, found) = (&simulator.state()[..4], estimator.x());
        let error = (DVector::from_row_slice(truth) - DVector::from_row_slice(found)).amax();
        assert!(error < 1e-9, "step {k}: {truth:?} {found:?}");
        before = now;
        simulator.advance();
    }
}

#[test]
fn what_is_unsafe_is_declined_with_its_reason() {
    let why = |effects: &[Given<'_>], rate: f64| {
        let found = declined(&bench(effects, rate));
        assert_eq!(found.len(), 1, "{effects:?}: {found:?}");
        format!("{} of {}: {}", found[0].effect.name(), found[0].place, found[0].why)
    };
    for (effects, rate, told) in [
        (
            (Kind::DeadZone, "u_roll", &[("width", 20.0)][..]),
            f64::INFINITY,
            "dead_zone of u_roll: it leaves the input no room",
        ),
        (
            (Kind::Backlash, "u_roll", &[("width", 41.0)]),
            f64::INFINITY,
            "backlash of u_roll: it leaves the input no room",
        ),
        (
            (Kind::InputSaturation, "u_roll", &[("lower", 1.0), ("upper", 4.0)]),
            f64::INFINITY,
            "input_saturation of u_roll: it leaves the input no room",
        ),
        (
            (Kind::RateLimit, "u_pitch", &[("limit_per_s", 0.0)]),
            f64::INFINITY,
            "rate_limit of u_pitch: it leaves",
        ),
        ((Kind::Backlash, "u_roll", &[("width", 4.0)]), 20.0, "at its limited rate the input takes 0.20 s"),
        (
            (Kind::CoulombFriction, "roll_rate", &[("level", 3.0)]),
            f64::INFINITY,
            "coulomb_friction of roll_rate: it would take more than half of what u_roll can do",
        ),
        (
            (Kind::CoulombFriction, "roll", &[("level", 0.01)]),
            f64::INFINITY,
            "coulomb_friction of roll: the inputs cannot push against it",
        ),
    ] {
        let found = why(&[effects], rate);
        assert!(found.contains(told), "{found}");
    }
    // Behind a long delay the push comes when friction has turned.
    let late = [
        (Kind::InputDelay, "u_roll", &[("delay_s", 0.4)][..]),
        (Kind::CoulombFriction, "roll_rate", &[("level", 0.18)]),
    ];
    let found = why(&late, f64::INFINITY);
    assert!(found.contains("would make the loop unstable about rest"), "{found}");
}

#[test]
fn commands_stay_within_their_limits_and_rates_whatever_is_taken_back() {
    let bench = bench(
        &[
            (Kind::GainDrift, "u_roll", &[("rate_per_s", -0.2)]),
            (Kind::DeadZone, "u_roll", &[("width", 1.0)]),
            (Kind::Backlash, "u_roll", &[("width", 1.0)]),
            (Kind::InputSaturation, "u_pitch", &[("lower", -4.0), ("upper", 3.0)]),
            (Kind::RateLimit, "u_pitch", &[("limit_per_s", 30.0)]),
            (Kind::CoulombFriction, "roll_rate", &[("level", 0.01), ("asymmetry", 0.002)]),
        ],
        f64::INFINITY,
    );
    let mut controller = Controller::new(&bench.design);
    assert_eq!(controller.compensate(&bench.design, &bench.linear, &ALL), []);
    let (mut next, mut before) = ([0.0; 2], 0.0);
    let mut stream = whirlstand_vehicle::Stream::new(1, "compensation");
    for k in 0..4000 {
        let mut x: Vec<f64> = (0..4).map(|_| 10f64.powf(3.0 * stream.normal()) * stream.normal()).collect();
        if k % 100 == 99 {
            x[1] = f64::NAN;
        }
        controller.step(&x, &[0.0; 4], 1, &mut next);
        assert!(next[0].abs() <= REACH && (-4.0..=3.0).contains(&next[1]), "{next:?}");
        assert!((next[1] - before).abs() <= 30.0 * PERIOD + 1e-12 || k % 100 > 90, "{before} {next:?}");
        before = next[1];
    }
}

#[test]
fn an_inverse_is_exact_once_its_jump_is_over() {
    // Two laws on one state, with and without the effect and its inverse: what acts in the end is the same.
    let zone = bench(
        &[(Kind::DeadZone, "u_roll", &[("width", 1.0)]), (Kind::Backlash, "u_roll", &[("width", 1.0)])],
        f64::INFINITY,
    );
    let plain = bench(&[], f64::INFINITY);
    let mut inverse = Controller::new(&zone.design);
    assert_eq!(inverse.compensate(&zone.design, &zone.linear, &ALL), []);
    let mut law = Controller::new(&plain.design);
    let (mut u, mut v) = ([0.0; 2], [0.0; 2]);
    let mut play = whirlstand_vehicle::Backlash::new(1.0, 0.0);
    let mut off = 0;
    for k in 0..400 {
        let x = [0.02 * (f64::from(k) * 0.02).sin(), 0.0, 0.0, 0.0];
        inverse.step(&x, &[0.0; 4], 0, &mut u);
        law.step(&x, &[0.0; 4], 0, &mut v);
        let acting = play.next(whirlstand_vehicle::dead_zone(u[0], 1.0));
        off += usize::from((acting - v[0]).abs() > 1e-9);
        assert!((acting - v[0]).abs() <= 1.0, "{acting} {v:?}");
    }
    println!("{off} of 400 steps within a jump");
    assert!(off < 60, "{off}");
}
