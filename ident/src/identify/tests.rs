//! Identification of vehicles with known parameters.

use whirlstand_vehicle::{Simulator, Stream, Vehicle};

use super::data::Segment;
use super::pem::{Noise, fit};
use super::problem::{Nuisance, Problem};
use crate::watch::Watch;

/// Random multistep inputs, as a pilot flies them.
pub fn pilot(steps: usize, m: usize, period_s: f64, size: f64, seed: u64) -> Vec<f64> {
    let mut inputs = vec![0.0; steps * m];
    for j in 0..m {
        let mut stream = Stream::new(seed, &format!("pilot {j}"));
        let (mut left, mut value) = (0usize, 0.0);
        for k in 0..steps {
            if left == 0 {
                left = ((0.2 + 1.3 * stream.uniform()) / period_s) as usize;
                value = if stream.chance(0.3) { 0.0 } else { size * (2.0 * stream.uniform() - 1.0) };
            }
            left -= 1;
            inputs[k * m + j] = value;
        }
    }
    inputs
}

/// A record of `vehicle` under `inputs`, with sensor noise.
pub fn record(vehicle: &Vehicle, inputs: &[f64], period_s: f64, seed: u64) -> Segment {
    let (m, p) = (vehicle.inputs.len(), vehicle.outputs.len());
    let mut simulator = Simulator::new(vehicle, period_s, seed).unwrap();
    simulator.set_engine(whirlstand_vehicle::Engine::Off);
    let mut outputs = Vec::new();
    for u in inputs.chunks_exact(m) {
        simulator.apply(u);
        let y = simulator.measure().to_vec();
        outputs.extend(y.iter().zip(simulator.fresh()).map(|(y, fresh)| if *fresh { *y } else { f64::NAN }));
        simulator.advance();
    }
    let steps = inputs.len() / m;
    assert_eq!(outputs.len(), steps * p);
    Segment {
        origin: "test".into(),
        start_s: 0.0,
        first_step: 0,
        period_s,
        inputs: inputs.to_vec(),
        outputs,
        steps,
    }
}

fn truth(problem: &Problem, vehicle: &Vehicle) -> Vec<f64> {
    problem.parameters.iter().map(|p| vehicle.free_value(&p.target)).collect()
}

#[test]
fn quadrotor_from_its_structure_alone() {
    let vehicle = Vehicle::builtin("quadrotor").unwrap();
    let structure = Vehicle::builtin("quadrotor-structure").unwrap();
    let segment = record(&vehicle, &pilot(3000, 2, 0.01, 10.0, 1), 0.01, 1);
    let segments = [segment];
    let problem = Problem::new(&structure, &segments, Nuisance::default()).unwrap();
    for noise in [Noise::White, Noise::Coloured, Noise::Kalman] {
        let start = std::time::Instant::now();
        let fit = fit(&problem, &segments, noise, &[], &Watch::default()).unwrap();
        let truth = truth(&fit.problem, &vehicle);
        println!("{noise:?} {:?} {:?} fixed {:?}", start.elapsed(), fit.outcome, fit.fixed);
        for (i, p) in fit.problem.parameters.iter().enumerate() {
            let std = fit.covariance[(i, i)].sqrt();
            println!(
                "{} {:9.4} true {:9.4} std {:.4} z {:.2}",
                p.name,
                fit.theta[i] / p.factor,
                truth[i] / p.factor,
                std / p.factor,
                (fit.theta[i] - truth[i]) / std
            );
            assert!((fit.theta[i] - truth[i]).abs() < 5.0 * std, "{}", p.name);
        }
        assert!(fit.outcome.converged);
    }
}

#[test]
fn helicopters_from_their_structure_alone() {
    let structure = Vehicle::builtin("helicopter-structure").unwrap();
    for name in ["helicopter-hover", "helicopter-longitudinal", "helicopter-lateral"] {
        let vehicle = Vehicle::builtin(name).unwrap();
        let segments = [record(&vehicle, &pilot(3000, 2, 0.02, 5.0, 1), 0.02, 1)];
        let problem = Problem::new(&structure, &segments, Nuisance::default()).unwrap();
        for noise in [Noise::White, Noise::Kalman] {
            let start = std::time::Instant::now();
            let fit = fit(&problem, &segments, noise, &[], &Watch::default()).unwrap();
            let truth = truth(&fit.problem, &vehicle);
            println!("{name} {noise:?} {:?} {:?} fixed {:?}", start.elapsed(), fit.outcome, fit.fixed);
            for (i, p) in fit.problem.parameters.iter().enumerate() {
                let std = fit.covariance[(i, i)].sqrt();
                let z = (fit.theta[i] - truth[i]) / std;
                assert!(z.abs() < 5.0, "{name} {noise:?} {}: {} {} {std}", p.name, fit.theta[i], truth[i]);
            }
            assert!(fit.outcome.converged && fit.fixed.is_empty());
        }
    }
}

/// A vehicle with a free effect, flown with process noise in closed loop: the predictor estimates all
/// parameters.
#[test]
fn a_free_effect_is_found_in_a_closed_loop() {
    let text = "A = [[0.0, 1.0], [-4.0, -0.5]]\nB = [[0.0], [2.0]]\n\
        states = [{ name = \"x\", unit = \"m\" }, { name = \"v\", unit = \"m/s\" }]\n\
        inputs = [{ name = \"u\", lower = -5.0, upper = 5.0 }]\n\
        outputs = [{ name = \"x\", unit = \"m\", noise = 0.002 }, { name = \"v\", unit = \"m/s\", noise = 0.01 }]\n\
        free = [{ entry = \"A[2,1]\", lower = -20.0, upper = 0.0 }, { entry = \"A[2,2]\", lower = -5.0, upper = 0.0 }, \
                { entry = \"B[2,1]\", lower = 0.0, upper = 9.0 }, \
                { effect = \"actuator_lag\", where = \"u\", parameter = \"time_constant_s\", lower = 0.0, upper = 1.0 }]\n\
        [[effects]]\neffect = \"actuator_lag\"\nwhere = \"u\"\ntime_constant_s = 0.1\n";
    let vehicle = Vehicle::parse(text, "cart.toml").unwrap();
    let (steps, period_s) = (6000, 0.01);
    let mut simulator = Simulator::new(&vehicle, period_s, 3).unwrap();
    let reference = pilot(steps, 1, period_s, 1.0, 5);
    let mut gusts = Stream::new(9, "gusts");
    let (mut inputs, mut outputs, mut u) = (Vec::new(), Vec::new(), 0.0);
    for r in &reference {
        simulator.apply(&[u]);
        let y = simulator.measure().to_vec();
        inputs.extend_from_slice(simulator.applied());
        u = 4.0 * (r - y[0]) - 1.0 * y[1];
        outputs.extend(y);
        simulator.disturb(&[0.0, 2.0 * gusts.normal()]);
        simulator.advance();
    }
    let segments =
        [Segment { origin: "test".into(), start_s: 0.0, first_step: 0, period_s, inputs, outputs, steps }];
    let problem = Problem::new(&vehicle, &segments, Nuisance::default()).unwrap();
    let truth = truth(&problem, &vehicle);
    // The start differs from the truth in the file.
    let mut elsewhere = vehicle.clone();
    for (p, v) in problem.parameters.iter().zip([-8.0, -1.0, 4.0, 0.02]) {
        elsewhere.set_free(&p.target, v).unwrap();
    }
    let problem = Problem::new(&elsewhere, &segments, Nuisance::default()).unwrap();
    let fit = fit(&problem, &segments, Noise::Kalman, &[], &Watch::default()).unwrap();
    assert!(fit.fixed.is_empty() && fit.outcome.converged, "{:?} {:?}", fit.fixed, fit.outcome);
    for (i, p) in fit.problem.parameters.iter().enumerate() {
        let std = fit.covariance[(i, i)].sqrt();
        println!("{} {:.4} true {:.4} std {std:.4}", p.name, fit.theta[i], truth[i]);
        assert!((fit.theta[i] - truth[i]).abs() < 4.0 * std, "{}", p.name);
        assert!(std < 0.1 * truth[i].abs(), "{} {std}", p.name);
    }
}

/// A slowly damped body in a loop that mostly answers a wandering torque: the torque is told, and the body found. Without
/// the torque none is told, and the standard errors are as small as before.
#[test]
fn a_wandering_force_in_a_closed_loop_biases_nothing() {
    let text = "A = [[-2.0]]\nB = [[60.0]]\nstates = [{ name = \"roll_rate\", unit = \"rad/s\" }]\n\
        inputs = [{ name = \"u\", lower = -5.0, upper = 5.0 }]\n\
        outputs = [{ name = \"roll_rate\", unit = \"rad/s\", noise = 0.005 }]\n\
        free = [{ entry = \"A[1,1]\", lower = -100.0, upper = 2.0 }, { entry = \"B[1,1]\", lower = -500.0, upper = 500.0 }]\n";
    let vehicle = Vehicle::parse(text, "body.toml").unwrap();
    let (steps, period_s) = (6000, 0.01);
    let flown = |wind: f64| {
        let mut simulator = Simulator::new(&vehicle, period_s, 3).unwrap();
        let mut air = Stream::new(9, "wind");
        let reference = pilot(steps, 1, period_s, 0.2, 5);
        let (mut inputs, mut outputs, mut u, mut torque) = (Vec::new(), Vec::new(), 0.0, 0.0);
        for r in &reference {
            simulator.apply(&[u]);
            let y = simulator.measure().to_vec();
            inputs.extend_from_slice(simulator.applied());
            u = 0.15 * (r - y[0]);
            outputs.extend(y);
            torque += wind * period_s.sqrt() * air.normal();
            simulator.disturb(&[torque]);
            simulator.advance();
        }
        [Segment { origin: "test".into(), start_s: 0.0, first_step: 0, period_s, inputs, outputs, steps }]
    };
    for (wind, is_told) in [(10.0, true), (0.0, false)] {
        let segments = flown(wind);
        let problem = Problem::new(&vehicle, &segments, Nuisance::default()).unwrap();
        let fit =
            super::force_fit::fit_beside_likely_forces(&problem, &segments, &[], &Watch::default()).unwrap();
        let super::pem::NoiseFit::Kalman(structure, _) = &fit.noise else { panic!("{:?}", fit.noise) };
        assert_eq!(!structure.forces.is_empty(), is_told, "wind {wind}");
        for (i, (p, truth)) in fit.problem.parameters.iter().zip([-2.0, 60.0]).enumerate() {
            let std = fit.covariance[(i, i)].sqrt();
            println!("wind {wind}: {} {:.3} true {truth} std {std:.3}", p.name, fit.theta[i]);
            assert!((fit.theta[i] - truth).abs() < 4.0 * std, "{} {} {std}", p.name, fit.theta[i]);
        }
    }
}

#[test]
fn the_gradient_of_the_innovations_likelihood_is_that_of_its_differences() {
    use super::filter_error::evaluate;
    use super::predictor::NoiseStructure;
    let vehicle = Vehicle::builtin("quadrotor").unwrap();
    let segments = [record(&vehicle, &pilot(2000, 2, 0.01, 10.0, 1), 0.01, 1)];
    let problem = Problem::new(&vehicle, &segments, Nuisance::default()).unwrap();
    let structure = NoiseStructure::new(&problem);
    let noises = std::iter::repeat_n(-3.0, structure.states.len())
        .chain(std::iter::repeat_n(-5.0, structure.outputs.len()));
    // Slightly off the truth, so that the gradient is not zero.
    let start: Vec<f64> = truth(&problem, &vehicle).iter().map(|v| 1.02 * v + 0.01).chain(noises).collect();
    let at = |u: &[f64], n: &[Vec<f64>]| evaluate(&problem, &structure, &segments, u, n).unwrap();
    let first = at(&start, &super::pem::no_nuisances(&problem, &segments));
    let e = at(&start, &first.nuisances);
    for i in 0..start.len() {
        let std = 1.0 / e.information[(i, i)].sqrt();
        let cost = |side: f64| {
            let mut moved = start.clone();
            moved[i] += side * 0.02 * std;
            at(&moved, &e.nuisances).cost
        };
        let difference = (cost(-1.0) - cost(1.0)) / (0.04 * std);
        // In standard errors: the resulting error of a search.
        let off = (e.right[i] - difference).abs() * std;
        assert!(off < 0.01 * (1.0 + difference.abs() * std), "{i}: {} {difference} {off}", e.right[i]);
    }
}
