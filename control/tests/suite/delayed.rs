//! Vehicles with late inputs and sensors: against `reference/delayed.py`, and against the simulator.

use nalgebra::{Complex, DMatrix};
use whirlstand_control::design::{EstimatedLoop, Pole};
use whirlstand_control::{
    Controller, Design, Estimator, EstimatorOptions, InputLimits, LawOptions, LqrOptions, SampledModel,
    SampledPlant, Selector, Sensors, Weights,
};
use whirlstand_linalg::eigenvalues;
use whirlstand_vehicle::{Effect, Kind, LinearModel, Simulator, Vehicle};

use crate::support::{complex, distance, matrix, vehicle};

const PERIOD: f64 = 0.005;

/// Effect, place and parameters.
type Given<'a> = (Kind, &'a str, &'a [(&'a str, f64)]);

fn extended(effects: &[Given<'_>]) -> Vehicle {
    let mut vehicle = Vehicle::builtin("quadrotor").expect("built in");
    for (kind, place, parameters) in effects {
        vehicle.add_effect(Effect::new(*kind, place, parameters).expect("in range")).expect("fits");
    }
    vehicle
}

fn plant_of(vehicle: &Vehicle) -> (LinearModel, SampledPlant) {
    let linear = LinearModel::new(vehicle).expect("fits");
    let limits = InputLimits { lower: -20.0, upper: 20.0, rate: f64::INFINITY };
    let plant =
        SampledPlant::of(&linear, PERIOD).and_then(|p| p.with_limits(vec![limits; 2])).expect("sound");
    (linear, plant)
}

fn filter(vehicle: &Vehicle, linear: &LinearModel, plant: &SampledPlant) -> Estimator {
    filter_with(vehicle, linear, plant, &EstimatorOptions::default())
}

fn filter_with(
    vehicle: &Vehicle,
    linear: &LinearModel,
    plant: &SampledPlant,
    options: &EstimatorOptions,
) -> Estimator {
    let sensors = Sensors {
        c: linear.c.columns(0, linear.own).into_owned(),
        d: linear.d.clone(),
        std: vehicle.outputs.iter().map(|o| o.noise.max(1e-6)).collect(),
        names: vehicle.outputs.iter().map(|o| o.name.clone()).collect(),
    };
    Estimator::of(plant, &sensors, Some(linear), options).expect("observable")
}

/// The model of a built-in vehicle with the delays and lags of a case.
fn with_delays_and_lags(case: &serde_json::Value) -> LinearModel {
    let name = case["name"].as_str().expect("name");
    let numbers = |key: &str| -> Vec<f64> { serde_json::from_value(case[key].clone()).expect("numbers") };
    let (a, b) = vehicle(name);
    let (n, m) = b.shape();
    let lags: Vec<usize> = (0..m).filter(|i| numbers("lags")[*i] > 0.0).collect();
    let (mut az, mut bz) =
        (a.clone().resize(n + lags.len(), n + lags.len(), 0.0), DMatrix::zeros(n + lags.len(), m));
    bz.rows_mut(0, n).copy_from(&b);
    for (k, &i) in lags.iter().enumerate() {
        let rate = 1.0 / numbers("lags")[i];
        az.view_mut((0, n + k), (n, 1)).copy_from(&b.column(i));
        bz.column_mut(i).fill(0.0);
        (az[(n + k, n + k)], bz[(n + k, i)]) = (-rate, rate);
    }
    LinearModel {
        actuators: lags.len(),
        names: lags.iter().map(|i| format!("u{i} lag")).collect(),
        a: az,
        b: bz,
        c: DMatrix::zeros(0, n + lags.len()),
        d: DMatrix::zeros(0, m),
        mix: DMatrix::zeros(0, 0),
        input_delays_s: numbers("delays"),
        output_delays_s: Vec::new(),
        offsets: Vec::new(),
        variance: Vec::new(),
        turbulence: vec![0.0; n],
        ..LinearModel::new(&Vehicle::builtin(name).expect("built in")).expect("plain")
    }
}

#[test]
fn plants_gains_and_margins_are_those_of_scipy_and_python_control() {
    let table: serde_json::Value =
        serde_json::from_str(include_str!("../../reference/delayed.json")).expect("JSON");
    for case in table["cases"].as_array().expect("cases") {
        let name = case["name"].as_str().expect("name");
        let numbers = |key: &str| -> Vec<f64> { serde_json::from_value(case[key].clone()).expect("numbers") };
        let linear = with_delays_and_lags(case);
        let plant = SampledPlant::of(&linear, PERIOD).expect("sound");
        let near = |what: &str, found: &DMatrix<f64>, key: &str, tolerance: f64| {
            let wanted = matrix(&case[key]);
            let error = (found - &wanted).norm() / wanted.norm();
            println!("{name} {:?} {what} differs by {error:.1e}", linear.input_delays_s);
            assert!(error < tolerance, "{name} {:?} {what}: {error:e}", linear.input_delays_s);
        };
        near("transition", plant.transition(), "f", 1e-12);
        near("input matrix", plant.drive(), "g", 1e-12);
        let weights = |key: &str| Some(Weights::List(numbers(key)));
        let options = LqrOptions { q: weights("q"), r: weights("r"), ..LqrOptions::default() };
        let design = Design::new(&plant, &LawOptions::Lqr(options)).expect("controllable");
        near("gain", &design.linear.gain, "gain", 1e-8);
        let least = case["min_return_difference"].as_f64().expect("a number");
        let found = design.multivariable_margins.min_return_difference;
        assert!((found - least).abs() < 1e-8 * least, "{name}: {found}, python-control {least}");
        // Those of late inputs, at zero, have no digits in an iteration; the others have all of them.
        let slow =
            |poles: Vec<Complex<f64>>| poles.into_iter().filter(|p| p.norm() > 0.6).collect::<Vec<_>>();
        let found = design.closed_loop_poles.iter().map(|p| Complex::new(p.discrete[0], p.discrete[1]));
        let off = distance(&slow(found.collect()), &complex(&case["poles"]));
        println!("{name} {:?} poles differ by {off:.1e}", linear.input_delays_s);
        assert!(off < 1e-8, "{name} {:?} poles: {off:e}", linear.input_delays_s);
        for (found, wanted) in design.loop_margins.iter().zip(case["loops"].as_array().expect("loops")) {
            for (found, key) in [
                (found.gain_increase, "gain_increase"),
                (found.phase_deg, "phase_deg"),
                (found.delay_s, "delay_s"),
            ] {
                match (found, wanted[key].as_f64()) {
                    (Some(f), Some(w)) => assert!((f - w).abs() < 1e-8 * w, "{name} {key}: {f}, {w}"),
                    (f, w) => {
                        assert!(f.is_none() && w.is_none(), "{name} {key}: {f:?}, python-control {w:?}")
                    }
                }
            }
        }
    }
}

#[test]
fn the_sampled_model_is_the_simulator() {
    let vehicle = extended(&[
        (Kind::InputGain, "u_roll", &[("factor", 0.8)]),
        (Kind::InputBias, "u_pitch", &[("offset", 0.3)]),
        (Kind::InputDelay, "u_roll", &[("delay_s", 0.0231)]),
        (Kind::InputDelay, "u_pitch", &[("delay_s", 0.004)]),
        (Kind::ActuatorLag, "u_roll", &[("time_constant_s", 0.06)]),
        (Kind::UnmodelledMode, "u_pitch", &[("frequency_hz", 9.0), ("damping_ratio", 0.3), ("gain", 1.2)]),
        (Kind::InputCoupling, "u_roll->u_pitch", &[("coefficient", 0.2)]),
        (Kind::ParameterChange, "A[2,1]", &[("factor", 1.4)]),
        (Kind::SensorLag, "roll", &[("time_constant_s", 0.03)]),
        (Kind::SensorDelay, "roll", &[("delay_s", 0.0123)]),
        (Kind::SensorDelay, "pitch_rate", &[("delay_s", 0.02)]),
        (Kind::SensorScale, "pitch", &[("factor", 1.1)]),
        (Kind::Misalignment, "roll,pitch", &[("angle_rad", 0.1)]),
        (Kind::SensorBias, "roll", &[("offset", 0.02)]),
    ]);
    let linear = LinearModel::new(&vehicle).expect("fits");
    let model = SampledModel::new(&linear, PERIOD).expect("slow enough");
    let mut simulator = Simulator::expected(&vehicle, PERIOD).expect("slow enough");
    // At rest under neutral commands: what follows from the commands stands where these lead.
    let trimmed =
        |u: [f64; 2]| nalgebra::DVector::from_iterator(2, u.iter().zip(&linear.trim).map(|(u, t)| u - t));
    let plant = SampledPlant::of(&linear, PERIOD).expect("sound");
    let mut s = nalgebra::DVector::zeros(model.f.nrows());
    let rest = plant.memory_at_rest(trimmed([0.0, 0.0]).as_slice());
    s.rows_mut(4, rest.len()).copy_from_slice(&rest);
    for k in 0..400u32 {
        let u = [f64::from(k % 37) * 0.1 - 1.0, f64::from(k % 23) * 0.15 - 1.5];
        simulator.apply(&u);
        let y = simulator.measure().to_vec();
        let expected = &model.h * &s + &model.d * trimmed(u);
        for (i, (y, e)) in y.iter().zip(expected.iter()).enumerate() {
            let e = e + linear.offsets[i];
            assert!((y - e).abs() < 1e-11, "step {k}, output {i}: {y}, {e}");
        }
        simulator.advance();
        s = &model.f * s + &model.g * trimmed(u);
    }
}

#[test]
fn the_closed_loop_has_the_poles_that_were_asked_for_whatever_the_delay() {
    let wanted = vec![[-3.0, 1.0], [-3.0, -1.0], [-4.0, 0.0], [-5.0, 0.0]];
    let options =
        LawOptions::Ppc(whirlstand_control::PpcOptions { poles: Some(wanted.clone()), ..Default::default() });
    for (roll_s, pitch_s) in [(0.12, 0.0), (0.0473, 0.1217), (0.08, 0.08)] {
        let vehicle = extended(&[
            (Kind::InputDelay, "u_roll", &[("delay_s", roll_s)]),
            (Kind::InputDelay, "u_pitch", &[("delay_s", pitch_s)]),
        ]);
        let design = Design::new(&plant_of(&vehicle).1, &options).expect("controllable");
        let near = |w: &[f64; 2]| {
            design
                .closed_loop_poles
                .iter()
                .filter_map(|p: &Pole| p.continuous)
                .any(|s| (s[0] - w[0]).abs() < 1e-5 && (s[1] - w[1]).abs() < 1e-5)
        };
        assert!(wanted.iter().all(near), "{roll_s} {pitch_s}: {:?}", design.closed_loop_poles);
        let others = design.closed_loop_poles.iter().filter(|p| p.continuous.is_none()).count();
        assert_eq!(others + wanted.len(), design.closed_loop_poles.len());
        // Those of the loop as it runs, past commands and all; what is left of registers is a ring that rounding makes.
        let runs = eigenvalues(&design.linear.closed_loop(&design.plant)).expect("converges");
        let slow: Vec<Complex<f64>> = runs.into_iter().filter(|p| p.norm() > 0.6).collect();
        let asked: Vec<Complex<f64>> =
            wanted.iter().map(|p| (Complex::new(p[0], p[1]) * PERIOD).exp()).collect();
        assert_eq!(slow.len(), asked.len(), "{roll_s} {pitch_s}: {slow:?}");
        let off = distance(&slow, &asked);
        assert!(off < 1e-7, "{roll_s} {pitch_s}: {slow:?} off by {off:e}");
    }
}

/// A filter in flight, step by step: `answer` gives the command that acts one period later, `look` sees every step with the input
/// that acts in it.
fn fly(
    truth: &Vehicle,
    seed: u64,
    steps: u32,
    estimator: &mut Estimator,
    mut answer: impl FnMut(u32, &Estimator, &mut [f64; 2]),
    mut look: impl FnMut(u32, &Simulator, &Estimator, [f64; 2]),
) {
    let mut simulator = Simulator::new(truth, PERIOD, seed).expect("slow enough");
    let (mut now, mut next) = ([0.0; 2], [0.0; 2]);
    for k in 0..steps {
        let before = now;
        now = next;
        simulator.apply(&now);
        let y = simulator.measure().to_vec();
        estimator.step(&y, u64::MAX, &before, &now);
        answer(k, estimator, &mut next);
        look(k, &simulator, estimator, now);
        simulator.advance();
    }
}

/// A gust on the extended vehicle, with the law and the filter of `model`: largest roll in deg, and the mean square of roll and
/// of the input that turns it, in units of their sizes.
fn gust(vehicle: &Vehicle, model: &Vehicle, law: &str) -> (f64, f64) {
    let (linear, plant) = plant_of(model);
    let design = Design::new(&plant, &LawOptions::named(law).expect("known")).expect("controllable");
    let mut controller = Controller::new(&design);
    let mut estimator = filter(model, &linear, &plant);
    let mut flown = vehicle.clone();
    let gust = [("at_s", 1.0), ("duration_s", 0.2), ("magnitude", 1.05)];
    flown.add_effect(Effect::new(Kind::PulseDisturbance, "roll_rate", &gust).expect("fits")).expect("fits");
    let (mut peak, mut cost) = (0f64, 0.0);
    fly(
        &flown,
        1,
        1600,
        &mut estimator,
        |_, estimator, next| {
            controller.step(estimator.x(), &[0.0; 4], 0, next);
        },
        |_, simulator, _, now| {
            let roll = simulator.state()[0];
            peak = peak.max(roll.abs());
            cost += (roll / plant.scales()[0]).powi(2) + (now[0] / 20.0).powi(2);
        },
    );
    (peak.to_degrees(), cost / 1600.0)
}

#[test]
fn a_law_that_knows_the_delay_flies_it_better() {
    let plain = Vehicle::builtin("quadrotor").expect("built in");
    let late = extended(&[(Kind::InputDelay, "u_roll", &[("delay_s", 0.12)])]);
    for law in ["lqr", "ppc", "smc"] {
        let (prompt, old, new) =
            (gust(&plain, &plain, law), gust(&late, &plain, law), gust(&late, &late, law));
        println!(
            "{law}: peak {:.2}, late {:.2} -> {:.2} deg; cost {:.5}, late {:.5} -> {:.5}",
            prompt.0, old.0, new.0, prompt.1, old.1, new.1
        );
        // Poles that are as fast as without the delay cost more effort: pole placement promises poles, not costs.
        assert!(new.1 < old.1 || law == "ppc", "{law}: {old:?} before, {new:?} after");
    }
    // Where the delay makes the plain law ring, the extended one rests.
    let later = extended(&[(Kind::InputDelay, "u_roll", &[("delay_s", 0.4)])]);
    for law in ["lqr", "ppc", "smc"] {
        let (old, new) = (gust(&later, &plain, law), gust(&later, &later, law));
        println!("{law}, 400 ms: peak {:.2} -> {:.2} deg; cost {:.5} -> {:.5}", old.0, new.0, old.1, new.1);
        assert!(new.1 < old.1, "{law}: {old:?} before, {new:?} after");
    }
}

#[test]
fn the_filter_sees_through_a_late_sensor_and_the_loop_with_it_is_told() {
    let late = extended(&[
        (Kind::SensorDelay, "roll", &[("delay_s", 0.0525)]),
        (Kind::SensorDelay, "roll_rate", &[("delay_s", 0.0525)]),
        (Kind::InputDelay, "u_roll", &[("delay_s", 0.05)]),
        (Kind::Vibration, "roll_rate", &[("frequency_hz", 22.0), ("amplitude", 0.2)]),
    ]);
    let plain = Vehicle::builtin("quadrotor").expect("built in");
    let error = |model: &Vehicle| {
        let (linear, plant) = plant_of(model);
        let mut estimator = filter(model, &linear, &plant);
        let mut sum = 0.0;
        fly(
            &late,
            3,
            2000,
            &mut estimator,
            |k, _, next| *next = [5.0 * f64::from((k + 1) / 100 % 2), 0.0],
            |k, simulator, estimator, _| {
                if k > 400 {
                    sum += (estimator.x()[0] - simulator.state()[0]).powi(2);
                }
            },
        );
        (sum / 1600.0f64).sqrt()
    };
    let (old, new) = (error(&plain), error(&late));
    println!("roll error {:.4} -> {:.4} deg", old.to_degrees(), new.to_degrees());
    assert!(new < 0.5 * old, "{old} {new}");

    let (linear, plant) = plant_of(&late);
    let design = Design::new(&plant, &LawOptions::named("lqr").expect("known")).expect("controllable");
    let told = EstimatedLoop::new(&plant, &design.linear, &filter(&late, &linear, &plant), &linear, &[])
        .expect("settles");
    assert!(told.spectral_radius < 1.0, "{}", told.spectral_radius);
    // The filter costs margin, and never gives any that the law alone has not at its peak sensitivity.
    let (alone, with) = (&design.multivariable_margins, &told.multivariable_margins);
    assert!(with.max_sensitivity > 1.0 && alone.max_sensitivity > 1.0, "{alone:?} {with:?}");
    // A law for the prompt vehicle around the late one is told for what it is.
    let (prompt_linear, prompt) = plant_of(&plain);
    let blind = Design::new(&prompt, &LawOptions::named("lqr").expect("known")).expect("controllable");
    let filter = filter(&plain, &prompt_linear, &prompt);
    let around = EstimatedLoop::new(&prompt, &blind.linear, &filter, &linear, &[]).expect("settles");
    assert!(around.multivariable_margins.max_sensitivity > with.max_sensitivity, "{around:?}");
}

#[test]
fn the_offset_of_a_late_input_is_found_as_a_state() {
    let late = [
        (Kind::InputDelay, "u_roll", &[("delay_s", 0.06)][..]),
        (Kind::ActuatorLag, "u_roll", &[("time_constant_s", 0.05)]),
    ];
    let known = extended(&late);
    let (linear, plant) = plant_of(&known);
    // What nobody knows of: a steady offset of the input.
    let mut truth = known.clone();
    truth
        .add_effect(Effect::new(Kind::InputBias, "u_roll", &[("offset", 2.0)]).expect("in range"))
        .expect("fits");
    let options = LqrOptions { integral: vec![Selector::Index(0)], ..LqrOptions::default() };
    let design = Design::new(&plant, &LawOptions::Lqr(options)).expect("controllable");
    let flown = |input_bias: &[Selector]| {
        let options = EstimatorOptions { input_bias: input_bias.to_vec(), ..EstimatorOptions::default() };
        let mut estimator = filter_with(&known, &linear, &plant, &options);
        let mut controller = Controller::new(&design);
        let mut sum = 0.0;
        fly(
            &truth,
            1,
            6000,
            &mut estimator,
            |_, estimator, next| {
                controller.step(estimator.x(), &[0.0; 4], 1, next);
            },
            // Over the last half the noise averages out.
            |k, simulator, _, _| sum += if k >= 3000 { simulator.state()[0] / 3000.0 } else { 0.0 },
        );
        (sum.abs().to_degrees(), estimator.input_bias()[0])
    };
    let ((without, none), (with, found)) = (flown(&[]), flown(&[Selector::Index(0)]));
    println!("roll at rest {without:.4} -> {with:.4} deg, offset {found:.3} of 2");
    assert_eq!(none, 0.0);
    assert!((found - 2.0).abs() < 0.1, "{found}");
    assert!(with < 0.01, "{with}");
}

#[test]
fn a_lag_hides_nothing_from_the_filter() {
    let text = "A = [[0.3]]\nB = [[270.0]]\nstates = [{ name = \"rate\" }]\ninputs = [{ name = \"u\" }]\n\
                outputs = [{ name = \"rate\" }]\n[[effects]]\neffect = \"sensor_lag\"\nwhere = \"rate\"\ntime_constant_s = 0.07\n";
    let vehicle = Vehicle::parse(text, "one").expect("sound");
    let linear = LinearModel::new(&vehicle).expect("fits");
    let limits = InputLimits { lower: -1.0, upper: 1.0, rate: f64::INFINITY };
    let plant = SampledPlant::of(&linear, PERIOD).and_then(|p| p.with_limits(vec![limits])).expect("sound");
    // The one sensor shows the unstable motion behind its lag.
    let estimator = filter(&vehicle, &linear, &plant);
    assert_eq!(estimator.filter().model().f.nrows(), 2);
}
