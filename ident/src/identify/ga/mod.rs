//! The paper's method: a real-coded genetic algorithm on the mean square error of the simulation.
//!
//! The loop, population and stopping rules are those of the `genetic_algorithm` crate; the recombination is REX
//! (real-coded ensemble crossover) with the generation alternation JGG (Akimoto, Nagata, Ono and Kobayashi, GECCO
//! 2009): children scatter about the centre of n + 1 parents as the parents themselves do, so that the search follows
//! correlated, badly scaled parameters; the best children take the parents' places.
//!
//! Over a long free run the right parameters lie in a valley that is deep but narrow, beside wide shallow ones. So the
//! population first lives in an easier world, in which simulations start anew from the record every so often, and only
//! as it settles do they run longer, at last freely.

mod cost;
mod rex;
mod stages;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use genetic_algorithm::strategy::evolve::prelude::*;
use nalgebra::DMatrix;

use super::ar::Ar;
use super::batch::{Batch, LANES};
use super::data::Segment;
use super::options::Options;
use super::pem::{Fit, NoiseFit};
use super::problem::Problem;
use super::search::Outcome;
use super::{IdentifyError, Progress};
use cost::{Cost, Scored, ranges, scaled};
use rex::{Alternate, NoMutation, Rex};
use stages::Stages;

/// The best point that was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// Parameters.
    pub theta: Vec<f64>,
    /// Nuisances of every segment.
    pub nuisances: Vec<Vec<f64>>,
    /// Weighted mean of mean square error over variance.
    pub cost: f64,
    /// Simulations.
    pub evaluations: usize,
    /// Generations.
    pub generations: usize,
    /// True when it stopped because nothing improved, false when the budget was spent.
    pub stagnated: bool,
}

/// Children a generation, in multiples of the number of unknowns.
const CHILDREN: usize = 6;
/// First population, in multiples of the number of unknowns.
const POPULATION: usize = 18;
/// The first population is the best of so many times as many random points.
const OVERSAMPLING: usize = 4;
/// Horizons of the stages before the last, as divisors of the longest segment.
const DIVISORS: [usize; 3] = [64, 16, 4];
/// Least horizon, steps.
const SHORTEST: usize = 8;
/// Costs of two runs that differ by less than this ratio are those of one valley.
const SAME: f64 = 5e-3;

/// Searches the box that the bounds span, initial states about the first measured values.
///
/// A run ends when the population has settled or nothing improves any more. As long as the budget lasts, another one
/// starts, until the best cost was found twice: a population that has closed in on a side valley does not know it.
/// From the third run on the population doubles (Auger and Hansen, CEC 2005).
///
/// # Errors
/// [`IdentifyError::UnstableStart`] when no simulation in the whole box stays finite.
pub fn search(
    problem: &Problem,
    segments: &[Segment],
    options: &Options,
    observe: &(dyn Fn(Progress) + Sync),
) -> Result<Found, IdentifyError> {
    let range = ranges(problem, segments);
    let free = Batch::new(problem, segments);
    let longest = segments.iter().map(|s| s.steps).max().unwrap_or(0);
    let mut batches: Vec<Batch<'_>> = Vec::new();
    if free.restarts() {
        batches.extend(DIVISORS.iter().map(|d| free.with_horizon((longest / d).max(SHORTEST))));
    }
    batches.push(free.clone());
    let evaluations = Arc::new(AtomicUsize::new(0));
    let cost = Cost {
        batches,
        stage: Arc::default(),
        range: &range,
        evaluations: evaluations.clone(),
        budget: options.budget,
        observe,
        first: Vec::new(),
    };
    let spent = || evaluations.load(Ordering::Relaxed);
    let mut best: Option<(f64, Vec<f64>)> = None;
    let (mut generations, mut stagnated, mut agreed) = (0, false, false);
    let mut population = (POPULATION * range.len()).max(64).next_multiple_of(LANES);
    let mut run = 0;
    while !agreed && (run == 0 || spent() + 2 * population < options.budget) {
        let seed = options.seed.wrapping_add(0x9e37_79b9_7f4a_7c15u64.wrapping_mul(run));
        let Some(found) = evolve(&cost, population, seed, options) else { break };
        generations += found.generations;
        if let Some(point) = found.genes.map(|genes| scaled(&genes, &range)) {
            let c = free.costs(&[&point])[0];
            agreed = best.as_ref().is_some_and(|(b, _)| (c / b - 1.0).abs() < SAME);
            stagnated = found.stagnated;
            if c.is_finite() && best.as_ref().is_none_or(|(b, _)| c < *b) {
                best = Some((c, point));
            }
        }
        if run > 0 {
            population *= 2;
        }
        run += 1;
    }
    let Some((cost, point)) = best else { return Err(IdentifyError::UnstableStart { tried: spent() }) };
    let np = problem.parameters.len();
    let each = problem.nuisances();
    Ok(Found {
        theta: point[..np].to_vec(),
        nuisances: (0..segments.len()).map(|s| point[np + s * each..np + (s + 1) * each].to_vec()).collect(),
        cost,
        evaluations: spent(),
        generations,
        stagnated: stagnated || agreed,
    })
}

/// How one run ended.
struct Run {
    genes: Option<Vec<f64>>,
    generations: usize,
    stagnated: bool,
}

/// One run; `None` when it cannot be set up, for which there is no known reason.
fn evolve(cost: &Cost<'_>, population: usize, seed: u64, options: &Options) -> Option<Run> {
    let d = cost.range.len();
    let (parents, children) = (d + 1, (CHILDREN * d).next_multiple_of(LANES));
    cost.stage.store(0, Ordering::Relaxed);
    let first = drawn(cost, population, seed);
    let left = options.budget.saturating_sub(cost.evaluations.load(Ordering::Relaxed));
    let most = (left / children).max(1);
    let genotype = MultiRangeGenotype::<f64>::builder()
        .with_allele_ranges(vec![0.0..=1.0; d])
        .with_genes_hashing(false)
        .build()
        .ok()?;
    let settled = Arc::new(AtomicBool::new(false));
    let stages = Stages {
        stage: cost.stage.clone(),
        last: cost.batches.len() - 1,
        stagnation: options.stagnation,
        generations: most,
        settled: settled.clone(),
    };
    let evolve = Evolve::builder()
        .with_genotype(genotype)
        .with_target_population_size(population)
        // One more than the stages wait, so that the run never ends before its last stage.
        .with_max_stale_generations(options.stagnation.saturating_add(1))
        .with_max_generations(most)
        .with_abort_flag(settled)
        .with_fitness(Cost { first, ..cost.clone() })
        .with_fitness_ordering(FitnessOrdering::Minimize)
        .with_par_fitness(true)
        .with_extension(stages)
        .with_crossover(Rex { parents, children })
        .with_mutate(NoMutation)
        .with_select(Alternate { parents })
        .with_rng_seed_from_u64(seed)
        .call()
        .ok()?;
    let generations = evolve.state.current_generation;
    let genes = evolve.best_genes_and_fitness_score().map(|(genes, _)| genes);
    Some(Run { genes, generations, stagnated: generations < most })
}

/// The best of many random points.
fn drawn(cost: &Cost<'_>, population: usize, seed: u64) -> Vec<Scored> {
    let d = cost.range.len();
    let mut stream = whirlstand_vehicle::Stream::new(seed, "first population");
    let mut drawn: Vec<Scored> = Vec::new();
    for _ in 0..OVERSAMPLING {
        let genes: Vec<Vec<f64>> =
            (0..population).map(|_| (0..d).map(|_| stream.uniform()).collect()).collect();
        let scores = cost.scores(&genes.iter().map(Vec::as_slice).collect::<Vec<_>>());
        drawn.extend(scores.into_iter().zip(genes));
        drawn.sort_by_key(|(score, _)| *score);
        drawn.truncate(population);
    }
    drawn
}

/// The result as a fit without standard errors.
pub fn as_fit(problem: &Problem, segments: &[Segment], found: &Found) -> Option<Fit> {
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
        outcome: Outcome { iterations: found.generations, evaluations: 0, converged: found.stagnated },
    })
}
