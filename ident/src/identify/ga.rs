//! The paper's method: a real-coded genetic algorithm on the mean square error of the simulation.
//!
//! The loop, population and stopping rules are those of the `genetic_algorithm` crate; the recombination is REX
//! (real-coded ensemble crossover) with the generation alternation JGG (Akimoto, Nagata, Ono and Kobayashi, GECCO
//! 2009): children scatter about the centre of n + 1 parents as the parents themselves do, so that the search follows
//! correlated, badly scaled parameters; the best children take the parents' places.

use std::cell::RefCell;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use genetic_algorithm::fitness::FitnessCache;
use genetic_algorithm::strategy::evolve::prelude::*;
use nalgebra::DMatrix;
use rand_ga::Rng;
use rayon::prelude::*;
use thread_local::ThreadLocal;

use super::ar::Ar;
use super::batch::{Batch, LANES};
use super::data::Segment;
use super::options::Options;
use super::pem::{Fit, NoiseFit};
use super::problem::Problem;
use super::search::Outcome;
use super::{IdentifyError, Progress};

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

/// Costs are compared as logarithms in steps of this: improvements below a hundred-thousandth do not count.
const PRECISION: f64 = 1e-5;

/// Children a generation, in multiples of the number of unknowns.
const CHILDREN: usize = 8;
/// First population, in multiples of the number of unknowns; every restart doubles it.
const POPULATION: usize = 20;
/// The first population is the best of so many times as many random points.
const OVERSAMPLING: usize = 16;

/// Searches the box that the bounds span, initial states about the first measured values.
///
/// A run ends when nothing improves any more. As long as the budget lasts, another one starts with twice the
/// population (Auger and Hansen, CEC 2005), until the best cost was found twice: a population that has closed in on a
/// side valley does not know it.
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
    let d = range.len();
    let evaluations = Arc::new(AtomicUsize::new(0));
    let cost = Cost {
        batch: Batch::new(problem, segments),
        range: &range,
        evaluations: evaluations.clone(),
        budget: options.budget,
        observe,
    };
    let spent = || evaluations.load(Ordering::Relaxed);
    let mut best: Option<(f64, Vec<f64>)> = None;
    let (mut generations, mut stagnated, mut agreed) = (0, false, false);
    let mut population = (POPULATION * d).max(64).next_multiple_of(LANES);
    let mut run = 0;
    while !agreed && (run == 0 || spent() + 2 * population < options.budget) {
        let seed = options.seed.wrapping_add(0x9e37_79b9_7f4a_7c15u64.wrapping_mul(run));
        let Some(found) = evolve(&cost, population, seed, options) else { break };
        generations += found.generations;
        if let Some(point) = found.genes.map(|genes| scaled(&genes, &range)) {
            let c = cost.batch.costs(&[&point])[0];
            // Twice the same valley: the costs agree far better than valleys do.
            agreed = best.as_ref().is_some_and(|(b, _)| (c / b - 1.0).abs() < 1e-3);
            stagnated = found.stagnated;
            if c.is_finite() && best.as_ref().is_none_or(|(b, _)| c < *b) {
                best = Some((c, point));
            }
        }
        population *= 2;
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
    let children = (CHILDREN * d).next_multiple_of(LANES);
    let mut stream = whirlstand_vehicle::Stream::new(seed, "first population");
    let mut drawn: Vec<(Option<FitnessValue>, Vec<f64>)> = Vec::new();
    for _ in 0..OVERSAMPLING {
        let genes: Vec<Vec<f64>> =
            (0..population).map(|_| (0..d).map(|_| stream.uniform()).collect()).collect();
        let scores = cost.scores(&genes.iter().map(Vec::as_slice).collect::<Vec<_>>());
        drawn.extend(scores.into_iter().zip(genes));
        drawn.sort_by_key(|(score, _)| score.unwrap_or(FitnessValue::MAX));
        drawn.truncate(population);
    }
    let left = options.budget.saturating_sub(cost.evaluations.load(Ordering::Relaxed) + population);
    let most = (left / children).max(1);
    let genotype = MultiRangeGenotype::<f64>::builder()
        .with_allele_ranges(vec![0.0..=1.0; d])
        .with_genes_hashing(false)
        .with_seed_genes_list(drawn.into_iter().map(|(_, genes)| genes).collect())
        .build()
        .ok()?;
    let evolve = Evolve::builder()
        .with_genotype(genotype)
        .with_target_population_size(population)
        .with_max_stale_generations(options.stagnation)
        .with_max_generations(most)
        .with_fitness(cost.clone())
        .with_fitness_ordering(FitnessOrdering::Minimize)
        .with_par_fitness(true)
        .with_crossover(Rex { parents: d + 1, children })
        .with_mutate(NoMutation)
        .with_select(Alternate { parents: d + 1 })
        .with_rng_seed_from_u64(seed)
        .call()
        .ok()?;
    let generations = evolve.state.current_generation;
    let genes = evolve.best_genes_and_fitness_score().map(|(genes, _)| genes);
    Some(Run { genes, generations, stagnated: generations < most })
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

/// Ranges of the unknowns: bounds of the parameters; initial states and offsets as the record leaves them open.
fn ranges(problem: &Problem, segments: &[Segment]) -> Vec<(f64, f64)> {
    let mut all: Vec<(f64, f64)> = problem.parameters.iter().map(|p| (p.lower, p.upper)).collect();
    let (n, p) = (problem.n(), problem.p());
    for segment in segments {
        let extent = |i: usize| {
            let values = segment.output(i, p);
            let known = || values.iter().copied().filter(|v| v.is_finite());
            let (low, high) =
                known().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
            let first: Vec<f64> = known().take(10).collect();
            (crate::stats::mean(&first), if high > low { high - low } else { 0.0 })
        };
        if problem.nuisance.initial_state {
            for j in 0..n {
                let shown = (0..p).find(|i| problem.weights[*i] > 0.0 && problem.vehicle.c[(*i, j)] != 0.0);
                let (centre, width) = shown.map_or((0.0, 1.0), |i| {
                    let (first, width) = extent(i);
                    (first / problem.vehicle.c[(i, j)], width / problem.vehicle.c[(i, j)].abs())
                });
                let half = if shown.is_some() { 0.25 * width } else { width };
                all.push((centre - half, centre + half));
            }
        }
        if problem.nuisance.output_offsets {
            for i in 0..p {
                let width = if problem.weights[i] > 0.0 { extent(i).1 } else { 0.0 };
                all.push((-0.5 * width, 0.5 * width));
            }
        }
    }
    all
}

/// From genes in [0, 1] to values: the middle of a wide range is searched more finely than its ends, as bounds are
/// mostly given generously.
fn scaled(genes: &[f64], range: &[(f64, f64)]) -> Vec<f64> {
    const WARP: f64 = 4.0;
    let warped = |g: f64| (WARP * (2.0 * g - 1.0)).sinh() / WARP.sinh();
    genes
        .iter()
        .zip(range)
        .map(|(g, (low, high))| (0.5 * (low + high) + 0.5 * (high - low) * warped(*g)).clamp(*low, *high))
        .collect()
}

/// The cost of a population, in batches, on all cores.
#[derive(Clone)]
struct Cost<'a> {
    batch: Batch<'a>,
    range: &'a [(f64, f64)],
    evaluations: Arc<AtomicUsize>,
    budget: usize,
    observe: &'a (dyn Fn(Progress) + Sync),
}

impl std::fmt::Debug for Cost<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Cost").field("unknowns", &self.range.len()).finish_non_exhaustive()
    }
}

impl Cost<'_> {
    fn scores(&self, genes: &[&[f64]]) -> Vec<Option<FitnessValue>> {
        let points: Vec<Vec<f64>> = genes.iter().map(|g| scaled(g, self.range)).collect();
        let costs = points.par_chunks(LANES).flat_map_iter(|chunk| {
            let chunk: Vec<&[f64]> = chunk.iter().map(Vec::as_slice).collect();
            self.batch.costs(&chunk)
        });
        let costs: Vec<f64> = costs.collect();
        self.evaluations.fetch_add(costs.len(), Ordering::Relaxed);
        let score = |c: &f64| (c.is_finite() && *c > 0.0).then(|| (c.ln() / PRECISION) as FitnessValue);
        costs.iter().map(score).collect()
    }
}

impl Fitness for Cost<'_> {
    type Genotype = MultiRangeGenotype<f64>;

    fn call_for_population(
        &mut self,
        population: &mut FitnessPopulation<Self>,
        _genotype: &FitnessGenotype<Self>,
        _thread_local: Option<&ThreadLocal<RefCell<Self>>>,
        _cache: Option<&FitnessCache>,
    ) {
        let fresh: Vec<usize> = (0..population.chromosomes.len())
            .filter(|i| {
                let c = &population.chromosomes[*i];
                c.fitness_score().is_none() && c.is_offspring()
            })
            .collect();
        let genes: Vec<&[f64]> = fresh.iter().map(|i| population.chromosomes[*i].genes.as_slice()).collect();
        let scores = self.scores(&genes);
        for (i, score) in fresh.into_iter().zip(scores) {
            population.chromosomes[i].set_fitness_score(score);
        }
        let best = population.chromosomes.iter().filter_map(|c| c.fitness_score()).min();
        (self.observe)(Progress::Generation {
            evaluations: self.evaluations.load(Ordering::Relaxed),
            budget: self.budget,
            cost: best.map_or(f64::INFINITY, |b| (b as f64 * PRECISION).exp()),
        });
    }

    fn calculate_for_chromosome(
        &mut self,
        chromosome: &FitnessChromosome<Self>,
        _genotype: &FitnessGenotype<Self>,
    ) -> Option<FitnessValue> {
        self.scores(&[chromosome.genes.as_slice()])[0]
    }
}

/// REX: children about the centre of the parents, who leave the population.
#[derive(Debug, Clone)]
struct Rex {
    parents: usize,
    children: usize,
}

impl Crossover for Rex {
    type Genotype = MultiRangeGenotype<f64>;

    fn call<R: Rng, SR: StrategyReporter<Genotype = Self::Genotype>>(
        &mut self,
        genotype: &Self::Genotype,
        state: &mut EvolveState<Self::Genotype>,
        _config: &EvolveConfig,
        _reporter: &mut SR,
        rng: &mut R,
    ) {
        let all = &mut state.population.chromosomes;
        let count = self.parents.min(all.len());
        let mut parents = Vec::with_capacity(count);
        for _ in 0..count {
            let index = rng.gen_range(0..all.len());
            parents.push(all.swap_remove(index));
        }
        let Some(d) = parents.first().map(|p| p.genes.len()) else { return };
        let mean = |i: usize| parents.iter().map(|p| p.genes[i]).sum::<f64>() / count as f64;
        let centre: Vec<f64> = (0..d).map(mean).collect();
        let width = (3.0 / count as f64).sqrt();
        for _ in 0..self.children {
            let mut child = parents[0].clone();
            child.genes.copy_from_slice(&centre);
            for parent in &parents {
                let xi = width * (2.0 * rng.r#gen::<f64>() - 1.0);
                for ((g, p), c) in child.genes.iter_mut().zip(&parent.genes).zip(&centre) {
                    *g += xi * (p - c);
                }
            }
            for g in &mut child.genes {
                // Beyond a bound: as far inside as it was outside.
                *g = if *g < 0.0 {
                    -*g
                } else if *g > 1.0 {
                    2.0 - *g
                } else {
                    *g
                }
                .clamp(0.0, 1.0);
            }
            child.reset_metadata(genotype.genes_hashing);
            all.push(child);
        }
    }
}

/// JGG: of the children the best take the parents' places.
#[derive(Debug, Clone)]
struct Alternate {
    parents: usize,
}

impl Select for Alternate {
    type Genotype = MultiRangeGenotype<f64>;

    fn call<R: Rng, SR: StrategyReporter<Genotype = Self::Genotype>>(
        &mut self,
        _genotype: &Self::Genotype,
        state: &mut EvolveState<Self::Genotype>,
        config: &EvolveConfig,
        _reporter: &mut SR,
        _rng: &mut R,
    ) {
        let all = &mut state.population.chromosomes;
        if all.len() <= config.target_population_size {
            return;
        }
        // Children were appended; those who stay come first among them.
        let old = config.target_population_size.saturating_sub(self.parents).min(all.len());
        all[old..].sort_by_key(|c| c.fitness_score().unwrap_or(FitnessValue::MAX));
        all.truncate(config.target_population_size);
    }
}

/// REX needs no mutation.
#[derive(Debug, Clone)]
struct NoMutation;

impl Mutate for NoMutation {
    type Genotype = MultiRangeGenotype<f64>;

    fn call<R: Rng, SR: StrategyReporter<Genotype = Self::Genotype>>(
        &mut self,
        _genotype: &Self::Genotype,
        _state: &mut EvolveState<Self::Genotype>,
        _config: &EvolveConfig,
        _reporter: &mut SR,
        _rng: &mut R,
    ) {
    }
}
