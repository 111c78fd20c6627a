//! Identification of what is known.

use whirlstand_vehicle::{Simulator, Stream, Vehicle};

use super::data::Segment;
use super::pem::{Noise, fit};
use super::problem::{Nuisance, Problem};

/// Multistep inputs as a pilot flies them: held for random times, to random sides.
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

/// A record of `vehicle` under `inputs`, with its sensors' noise.
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
    Segment { origin: "test".into(), start_s: 0.0, period_s, inputs: inputs.to_vec(), outputs, steps }
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
        let fit = fit(&problem, &segments, noise, &[], &|_| ()).unwrap();
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
            let fit = fit(&problem, &segments, noise, &[], &|_| ()).unwrap();
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
