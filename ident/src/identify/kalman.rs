//! Prediction-error search with a Kalman filter: start values, then optimisation.

use nalgebra::DMatrix;

use super::data::Segment;
use super::filter_error::Likelihood;
use super::fitted::{Fit, NoiseFit, bounds, no_nuisances};
use super::forces::with_forces;
use super::predictor::NoiseStructure;
use super::problem::Problem;
use super::search::{Limits, Outcome, descends, search};
use super::{filter_error, spread, start};
use crate::watch::Watch;

/// Number of the caller's starts from which a short search is made, besides the data's and the file's.
const MOST_SEARCHED: usize = 4;
/// Steps of a short search.
const SHORT: usize = 12;
/// Most steps of a search to its end.
const LONG: usize = 60;

/// Parameters and noises at the start of a search.
#[derive(Debug, Clone)]
pub struct Start {
    /// The parameters, SI.
    pub theta: Vec<f64>,
    /// Logarithms of the noises' standard deviations.
    pub noise: Vec<f64>,
}

/// Start of the search. An equation-error fit to the data with the best short predictions suffices, since the
/// filter follows the record. Short searches from it, from the vehicle file's own values and from further starts of
/// the caller decide, as the likelihood of a start depends on the noises, which no start includes.
pub fn kalman_start(
    problem: &Problem,
    structure: &NoiseStructure,
    segments: &[Segment],
    extra: &[Vec<f64>],
    watch: &Watch,
) -> Start {
    let wide = with_forces(problem, structure);
    let noise: Vec<f64> = first_noise(&wide, segments, structure).iter().map(|n| n.start).collect();
    let nuisances = no_nuisances(&wide, segments);
    let ranked = |starts: Vec<Vec<f64>>, most: usize| -> Vec<Start> {
        let mut all = Vec::new();
        for theta in starts {
            let unknowns: Vec<f64> = theta.iter().chain(&noise).copied().collect();
            let cost = filter_error::evaluate(&wide, structure, segments, &unknowns, &nuisances)
                .map_or(f64::INFINITY, |e| e.cost);
            all.push((cost, theta));
            if watch.is_stopped() && cost.is_finite() {
                break;
            }
        }
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        all.into_iter().take(most).map(|(_, theta)| Start { theta, noise: noise.clone() }).collect()
    };
    let mut starts = ranked(start::candidates(problem, segments), 1);
    let given = Start { theta: start::given(problem), noise: noise.clone() };
    starts.extend(settled(&wide, structure, segments, &given, watch));
    if starts.iter().all(|start| start.theta != given.theta || start.noise != given.noise) {
        starts.push(given);
    }
    starts.extend(ranked(extra.to_vec(), MOST_SEARCHED));
    if starts.len() == 1 || watch.is_stopped() {
        return starts.swap_remove(0);
    }
    let found = starts.iter().filter_map(|start| climb(&wide, structure, segments, start, SHORT, watch));
    match found.min_by(|a, b| a.0.cost.total_cmp(&b.0.cost)) {
        Some((found, _)) => {
            let (theta, noise) = found.unknowns.split_at(problem.parameters.len());
            Start { theta: theta.to_vec(), noise: noise.to_vec() }
        }
        None => starts.swap_remove(0),
    }
}

/// A start with the noises that are likeliest beside its parameters. From a file that was fitted before, a search thus
/// begins at what was found and cannot end at less; from noises that only follow the record it may leave for another valley.
fn settled(
    problem: &Problem,
    structure: &NoiseStructure,
    segments: &[Segment],
    start: &Start,
    watch: &Watch,
) -> Option<Start> {
    let vehicle = problem.vehicle_at(&start.theta);
    let fixed = Problem { vehicle, parameters: Vec::new(), ..problem.clone() };
    let noises = Start { theta: Vec::new(), noise: start.noise.clone() };
    let (found, _) = climb(&fixed, structure, segments, &noises, LONG, watch)?;
    Some(Start { theta: start.theta.clone(), noise: found.unknowns })
}

/// Logarithm of a noise's standard deviation: where the search begins and the limits within which it stays.
struct FirstNoise {
    start: f64,
    lower: f64,
    upper: f64,
}

/// Initial noise: measurement noise from the record, process noise that lets the filter follow the record
/// within a few steps. The limits are a millionth of the start, where a noise has no effect, and a thousand times it; a
/// process noise may besides be as large as all that the record does from one step to the next, as a smooth record has
/// hardly any measurement noise to begin with.
fn first_noise(problem: &Problem, segments: &[Segment], structure: &NoiseStructure) -> Vec<FirstNoise> {
    let p = problem.p();
    let measured: Vec<(f64, f64)> = structure
        .outputs
        .iter()
        .map(|&i| {
            let runs: Vec<Vec<f64>> = segments.iter().map(|s| s.output(i, p)).collect();
            let values: Vec<f64> = runs.iter().flatten().copied().filter(|v| v.is_finite()).collect();
            let mean = whirlstand_logs::stats::mean(&values);
            let spread = whirlstand_logs::stats::rms(&values.iter().map(|v| v - mean).collect::<Vec<_>>());
            let steps = runs.iter().flat_map(|run| run.windows(2).map(|w| w[1] - w[0]));
            let steps: Vec<f64> = steps.filter(|step| step.is_finite()).collect();
            let noise = whirlstand_logs::stats::white_noise_std(&values).max(1e-4 * spread).max(1e-12);
            (noise, if steps.is_empty() { spread } else { whirlstand_logs::stats::rms(&steps) })
        })
        .collect();
    let noise = |std: f64, largest: f64| {
        let start = std.ln();
        FirstNoise { start, lower: start - 14.0, upper: (start + 7.0).max(largest.ln()) }
    };
    let over = 1.0 / problem.period_s.sqrt();
    let own = problem.n() - structure.forces.len();
    let driven = structure.states.iter().map(|&j| {
        // A force begins as large as the noise of the state on which it acts.
        let force = j.checked_sub(own).map(|force| structure.forces[force].output);
        if let Some(at) = force.and_then(|output| structure.outputs.iter().position(|i| *i == output)) {
            return noise(0.3 * measured[at].0 * over, 0.0);
        }
        let at = structure.outputs.iter().position(|&i| problem.vehicle.c[(i, j)] != 0.0);
        let (size, step) = match at {
            Some(at) => {
                let gain = problem.vehicle.c[(structure.outputs[at], j)].abs();
                (measured[at].0 / gain, measured[at].1 / gain)
            }
            None => (whirlstand_logs::stats::mean(&measured.iter().map(|m| m.0).collect::<Vec<_>>()), 0.0),
        };
        noise(0.3 * size * over, step * over)
    });
    driven.chain(measured.iter().map(|m| noise(m.0, 0.0))).collect()
}

/// Maximises the likelihood of the Kalman filter's innovations from a start; the problem includes the forces.
fn climb(
    problem: &Problem,
    structure: &NoiseStructure,
    segments: &[Segment],
    start: &Start,
    iterations: usize,
    watch: &Watch,
) -> Option<(filter_error::Evaluation, Outcome)> {
    let mut limits = bounds(problem);
    limits.extend(first_noise(problem, segments, structure).iter().map(|noise| (noise.lower, noise.upper)));
    let unknowns: Vec<f64> = start.theta.iter().chain(&start.noise).copied().collect();
    let first = Likelihood::at(problem, structure, segments, (&unknowns, &no_nuisances(problem, segments)))?;
    let search_limits = Limits { iterations, tolerance: 0.01, ..Limits::default() };
    let (found, outcome) =
        search(first, &limits, search_limits, Likelihood::after, |step, cost| descends(watch, step, cost));
    Some((found.evaluation, outcome))
}

/// Fits the parameters and the noises by maximum likelihood of the Kalman filter's innovations.
pub fn kalman(
    problem: &Problem,
    structure: &NoiseStructure,
    segments: &[Segment],
    start: &Start,
    watch: &Watch,
) -> Option<(Fit, DMatrix<f64>)> {
    let np = problem.parameters.len();
    let wide = with_forces(problem, structure);
    let (found, outcome) = climb(&wide, structure, segments, start, LONG, watch)?;
    let information = spread::marginal(&found.information, np)?;
    let covariance = super::normal::pseudo_inverse(&information)?;
    let fit = Fit {
        problem: problem.clone(),
        theta: found.unknowns[..np].to_vec(),
        nuisances: found.nuisances,
        covariance,
        fixed: Vec::new(),
        noise: NoiseFit::Kalman(structure.clone(), found.unknowns[np..].to_vec()),
        cost: found.cost,
        outcome,
    };
    Some((fit, information))
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_vehicle::Vehicle;

    /// A smooth motion that is not the input's: with hardly any measurement noise, the process noise has to reach what
    /// the record does from step to step, or the filter cannot follow it.
    #[test]
    fn a_smooth_record_that_the_inputs_do_not_explain_is_followed() {
        let text = r#"
            A = [[-2.0]]
            B = [[1.0]]
            states = [{ name = "v" }]
            inputs = [{ name = "u" }]
            free = [{ entry = "A[1,1]", lower = -20.0, upper = 0.0, start = -2.0 }]
        "#;
        let vehicle = Vehicle::parse(text, "axis.toml").unwrap();
        let (steps, period_s) = (1500, 0.01);
        let motion = |k: usize| {
            let t = k as f64 * period_s;
            7.0 * (14.4 * t).sin() + 4.0 * (9.3 * t + 1.0).sin()
        };
        let segments = [Segment {
            origin: "smooth".into(),
            start_s: 0.0,
            first_step: 0,
            period_s,
            inputs: (0..steps).map(|k| f64::from(k as u32 / 70 % 2)).collect(),
            outputs: (0..steps).map(motion).collect(),
            steps,
        }];
        let problem = Problem::new(&vehicle, &segments, super::super::Nuisance::default()).unwrap();
        let structure = NoiseStructure::new(&problem);
        let start = kalman_start(&problem, &structure, &segments, &[], &Watch::default());
        let (fit, _) = kalman(&problem, &structure, &segments, &start, &Watch::default()).unwrap();
        let NoiseFit::Kalman(_, noise) = fit.noise else { panic!("{:?}", fit.noise) };
        let (driving, measuring) = (noise[0].exp() * period_s.sqrt(), noise[1].exp());
        assert!(driving > 0.5 && measuring < 0.1 * driving, "{driving} {measuring}");
    }
}
