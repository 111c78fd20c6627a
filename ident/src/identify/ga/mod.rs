//! Method of the paper: a real-coded genetic algorithm on the mean square error of the simulation.
//!
//! The recombination is REX (real-coded ensemble crossover) with the generation alternation JGG (Akimoto,
//! Nagata, Ono and Kobayashi, GECCO 2009): children scatter about the centre of n + 1 parents with the
//! parents' own covariance, so that the search follows correlated, badly scaled parameters; the best children
//! replace the parents.
//!
//! Over a long free run the true parameters lie in a deep but narrow minimum beside wide shallow ones. So the
//! cost of the first stage uses short simulations that are reset to the record regularly; as the population
//! converges they become longer, and at last run freely.

mod cost;
mod evolve;
mod rex;
mod stages;

use nalgebra::DMatrix;

use super::IdentifyError;
use super::ar::Ar;
use super::batch::{Batch, LANES};
use super::data::Segment;
use super::options::Options;
use super::pem::{Fit, NoiseFit};
use super::problem::Problem;
use super::search::Outcome;
use crate::watch::Watch;
use cost::{Cost, ranges, scaled};
use evolve::evolve;

/// Result of a search: its best point and its effort.
#[derive(Debug, Clone, PartialEq)]
pub struct SearchResult {
    /// Values of the free parameters, SI.
    pub theta: Vec<f64>,
    /// Nuisances of every segment, SI: initial state, then output offsets.
    pub nuisances: Vec<Vec<f64>>,
    /// Weighted mean over the outputs of the mean square error divided by the variance of the output.
    pub cost: f64,
    /// Number of simulations.
    pub evaluations: usize,
    /// Number of generations.
    pub generations: usize,
    /// True when the search ended because nothing improved, false when the simulations were spent or the
    /// search was stopped.
    pub stagnated: bool,
}

/// Size of the first population, in multiples of the number of unknowns.
const POPULATION: usize = 18;
/// Horizons of the stages before the last, as divisors of the longest segment.
const DIVISORS: [usize; 3] = [64, 16, 4];
/// Shortest horizon, steps.
const SHORTEST: usize = 8;
/// Cost ratio below which two runs have found the same minimum.
const SAME: f64 = 5e-3;

/// Searches the box that the bounds span, with initial states around the first measured values.
///
/// A run ends when the population has converged or nothing improves any more. While simulations are left and
/// the search is not stopped, another run starts, until the best cost was found twice: a population cannot
/// detect that it has converged to a local minimum. From the third run on the population doubles (Auger and
/// Hansen, CEC 2005).
///
/// # Errors
/// [`IdentifyError::UnstableStart`] when no simulation in the whole box stays finite.
pub fn search(
    problem: &Problem,
    segments: &[Segment],
    options: &Options,
    watch: &Watch,
) -> Result<SearchResult, IdentifyError> {
    let range = ranges(problem, segments);
    let free = Batch::new(problem, segments);
    let longest = segments.iter().map(|s| s.steps).max().unwrap_or(0);
    let mut batches: Vec<Batch<'_>> = Vec::new();
    if free.restarts() {
        batches.extend(DIVISORS.iter().map(|d| free.with_horizon((longest / d).max(SHORTEST))));
    }
    batches.push(free.clone());
    let most = options.evaluations;
    let mut cost = Cost { batches, range: &range, evaluations: 0, most, watch, stage: 0 };
    let mut best: Option<(f64, Vec<f64>)> = None;
    let (mut generations, mut stagnated, mut agreed) = (0, false, false);
    let mut population = (POPULATION * range.len()).max(64).next_multiple_of(LANES);
    let mut run = 0;
    let may_go_on = |spent, population| !watch.is_stopped() && spent + 2 * population < most;
    while !agreed && (run == 0 || may_go_on(cost.evaluations, population)) {
        let seed = options.seed.wrapping_add(0x9e37_79b9_7f4a_7c15u64.wrapping_mul(run));
        let found = evolve(&mut cost, population, seed, options.stagnation);
        generations += found.generations;
        stagnated = found.stagnated;
        let point = scaled(&found.genes, &range);
        let c = free.costs(&[&point])[0];
        agreed = best.as_ref().is_some_and(|(b, _)| (c / b - 1.0).abs() < SAME);
        if c.is_finite() && best.as_ref().is_none_or(|(b, _)| c < *b) {
            best = Some((c, point));
        }
        if run > 0 {
            population *= 2;
        }
        run += 1;
    }
    let evaluations = cost.evaluations;
    let Some((cost, point)) = best else { return Err(IdentifyError::UnstableStart { tried: evaluations }) };
    let np = problem.parameters.len();
    let each = problem.nuisances();
    Ok(SearchResult {
        theta: point[..np].to_vec(),
        nuisances: (0..segments.len()).map(|s| point[np + s * each..np + (s + 1) * each].to_vec()).collect(),
        cost,
        evaluations,
        generations,
        stagnated: stagnated || agreed,
    })
}

/// The result as a fit without standard errors.
pub fn as_fit(problem: &Problem, segments: &[Segment], found: &SearchResult) -> Option<Fit> {
    let runs = super::output_error::residual_runs(problem, segments, &found.theta, &found.nuisances)?;
    let np = problem.parameters.len();
    Some(Fit {
        problem: problem.clone(),
        theta: found.theta.clone(),
        nuisances: found.nuisances.clone(),
        covariance: DMatrix::zeros(np, np),
        fixed: Vec::new(),
        noise: NoiseFit::Outputs(runs.iter().map(|r| Ar::fit(r, 30)).collect()),
        cost: found.cost,
        outcome: Outcome { iterations: found.generations, converged: found.stagnated, ..Outcome::default() },
    })
}
