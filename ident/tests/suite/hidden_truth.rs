//! Hidden truth: vehicles drawn from a seed, a record of each, and the search that knows neither.
//!
//! The structure is the quadrotor's. The truth is drawn about Table 2: every entry between half and one and a half times
//! its value, couplings that are zero there drawn small; only stable vehicles count. A search succeeds when its cost is
//! within 1 % of what the true parameters cost on the same record, initial state fitted for both.
//! WHIRLSTAND_TRIALS says how many seeds are run (200 for the full count; fewer by default, to keep the test short).

use whirlstand_ident::identify::pem::{Noise, fit, no_nuisances, white};
use whirlstand_ident::identify::problem::Problem;
use whirlstand_ident::identify::{Nuisance, Options, Segment, batch, ga, output_error};
use whirlstand_ident::watch::Watch;
use whirlstand_vehicle::{Engine, Simulator, Stream, Vehicle};

const PERIOD_S: f64 = 0.03;
const STEPS: usize = 1000;

fn alternatives(default: u64) -> u64 {
    std::env::var("WHIRLSTAND_TRIALS").ok().and_then(|v| v.parse().ok()).unwrap_or(default)
}

fn hidden(seed: u64) -> (Vehicle, Segment) {
    let mut stream = Stream::new(seed, "hidden truth");
    let nominal = Vehicle::builtin("quadrotor").unwrap();
    let vehicle = loop {
        let mut vehicle = nominal.clone();
        for f in &nominal.free {
            let value = nominal.free_value(&f.target);
            let drawn =
                value * (0.5 + stream.uniform()) + 0.2 * nominal.free_factor(&f.target) * stream.normal();
            vehicle.set_free(&f.target, drawn).unwrap();
        }
        if vehicle.poles().unwrap().iter().all(|p| p.re < -0.05) {
            break vehicle;
        }
    };
    let mut inputs = vec![0.0; STEPS * 2];
    for j in 0..2 {
        let (mut left, mut value) = (0usize, 0.0);
        for k in 0..STEPS {
            if left == 0 {
                left = ((0.2 + 1.3 * stream.uniform()) / PERIOD_S) as usize;
                value = if stream.chance(0.3) { 0.0 } else { 10.0 * (2.0 * stream.uniform() - 1.0) };
            }
            left -= 1;
            inputs[k * 2 + j] = value;
        }
    }
    let mut simulator = Simulator::new(&vehicle, PERIOD_S, seed).unwrap();
    simulator.set_engine(Engine::Off);
    let mut outputs = vec![0.0; STEPS * 4];
    simulator.run(&inputs, &mut outputs);
    let segment = Segment {
        origin: format!("seed {seed}"),
        start_s: 0.0,
        first_step: 0,
        period_s: PERIOD_S,
        inputs,
        outputs,
        steps: STEPS,
    };
    (vehicle, segment)
}

#[test]
fn prediction_error_finds_the_true_optimum() {
    let alternatives = alternatives(40);
    let structure = Vehicle::builtin("quadrotor-structure").unwrap();
    let mut failed = Vec::new();
    let (mut inside, mut all) = (0, 0);
    for seed in 1..=alternatives {
        let (truth, segment) = hidden(seed);
        let segments = [segment];
        let problem = Problem::new(&structure, &segments, Nuisance::default()).unwrap();
        let theta: Vec<f64> = problem.parameters.iter().map(|p| truth.free_value(&p.target)).collect();
        let whites = white(&problem);
        let cost = |theta: &[f64]| {
            output_error::evaluate(&problem, &segments, &whites, theta, &no_nuisances(&problem, &segments))
        };
        let best = cost(&theta).unwrap();
        let found = fit(&problem, &segments, Noise::White, &[], &Watch::default()).unwrap();
        // The determinant of the residuals' covariance, as a mean square ratio.
        let n: usize = best.counts.iter().sum();
        let ratio = (2.0 * (found.cost - best.cost) / n as f64).exp();
        if ratio > 1.01 || !found.fixed.is_empty() {
            failed.push(seed);
        }
        for (i, p) in found.problem.parameters.iter().enumerate() {
            let error = found.theta[i] - truth.free_value(&p.target);
            all += 1;
            inside += usize::from(error.abs() <= 3.0 * found.covariance[(i, i)].sqrt());
        }
    }
    let share = 100.0 * inside as f64 / all as f64;
    println!(
        "pem: {} of {alternatives} seeds fail {failed:?}; {share:.2} % of {all} parameters within 3 standard errors",
        failed.len()
    );
    assert!(failed.len() as u64 * 100 <= alternatives, "{failed:?}");
    assert!(share >= 99.0, "{share}");
}

#[test]
fn the_genetic_algorithm_finds_the_true_optimum() {
    let alternatives = alternatives(8);
    let structure = Vehicle::builtin("quadrotor-structure").unwrap();
    let mut failed = Vec::new();
    let mut evaluations = 0;
    for seed in 1..=alternatives {
        let (truth, segment) = hidden(seed);
        let segments = [segment];
        let problem = Problem::new(&structure, &segments, Nuisance::default()).unwrap();
        let theta: Vec<f64> = problem.parameters.iter().map(|p| truth.free_value(&p.target)).collect();
        let whites = white(&problem);
        let at_truth =
            output_error::evaluate(&problem, &segments, &whites, &theta, &no_nuisances(&problem, &segments))
                .unwrap();
        let point: Vec<f64> = theta.iter().chain(&at_truth.nuisances[0]).copied().collect();
        let best = batch::Batch::new(&problem, &segments).costs(&[&point])[0];
        let options = Options { seed, ..Options::default() };
        let found = ga::search(&problem, &segments, &options, &Watch::default()).unwrap();
        evaluations += found.evaluations;
        if found.cost > 1.01 * best {
            failed.push((seed, found.cost / best));
        }
    }
    println!(
        "ga: {} of {alternatives} seeds fail {failed:?}; {} simulations a seed",
        failed.len(),
        evaluations as u64 / alternatives
    );
    // At least 95 %; of the few seeds that are run by default, none may fail.
    assert!(failed.len() as u64 * 20 <= alternatives, "{failed:?}");
}
