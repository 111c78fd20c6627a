//! What a set of genes costs.

use std::cell::RefCell;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use genetic_algorithm::fitness::FitnessCache;
use genetic_algorithm::strategy::evolve::prelude::*;
use rayon::prelude::*;
use thread_local::ThreadLocal;

use crate::identify::Progress;
use crate::identify::batch::{Batch, LANES};
use crate::identify::data::Segment;
use crate::identify::problem::Problem;

/// Ranges of the unknowns: bounds of the parameters; initial states and offsets as the record leaves them open.
pub fn ranges(problem: &Problem, segments: &[Segment]) -> Vec<(f64, f64)> {
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
pub fn scaled(genes: &[f64], range: &[(f64, f64)]) -> Vec<f64> {
    const WARP: f64 = 4.0;
    let warped = |g: f64| (WARP * (2.0 * g - 1.0)).sinh() / WARP.sinh();
    genes
        .iter()
        .zip(range)
        .map(|(g, (low, high))| (0.5 * (low + high) + 0.5 * (high - low) * warped(*g)).clamp(*low, *high))
        .collect()
}

/// Costs are compared as logarithms in steps of this: improvements below a hundred-thousandth do not count.
pub const PRECISION: f64 = 1e-5;

/// Genes and their score.
pub type Scored = (FitnessValue, Vec<f64>);

/// The cost of a population, in batches, on all cores.
#[derive(Clone)]
pub struct Cost<'a> {
    /// The simulations of each stage; those of the last one run freely.
    pub batches: Vec<Batch<'a>>,
    /// Ranges of the unknowns.
    pub range: &'a [(f64, f64)],
    /// Simulations so far, of all runs.
    pub evaluations: Arc<AtomicUsize>,
    /// Simulations at most.
    pub budget: usize,
    /// Told after every generation.
    pub observe: &'a (dyn Fn(Progress) + Sync),
    /// Stage of the search: an index into `batches`.
    pub stage: Arc<AtomicUsize>,
    /// The first population, until it is taken.
    pub first: Vec<Scored>,
}

impl std::fmt::Debug for Cost<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Cost").field("unknowns", &self.range.len()).finish_non_exhaustive()
    }
}

impl Cost<'_> {
    /// Scores of some sets of genes; the greatest where the simulation leaves all bounds.
    pub fn scores(&self, genes: &[&[f64]]) -> Vec<FitnessValue> {
        let points: Vec<Vec<f64>> = genes.iter().map(|g| scaled(g, self.range)).collect();
        let batch = &self.batches[self.stage.load(Ordering::Relaxed)];
        let costs = points.par_chunks(LANES).flat_map_iter(|chunk| {
            let chunk: Vec<&[f64]> = chunk.iter().map(Vec::as_slice).collect();
            batch.costs(&chunk)
        });
        let costs: Vec<f64> = costs.collect();
        self.evaluations.fetch_add(costs.len(), Ordering::Relaxed);
        costs.into_iter().map(score).collect()
    }
}

/// The logarithm of a cost in steps of [`PRECISION`].
fn score(cost: f64) -> FitnessValue {
    // A cost of exactly zero has no logarithm.
    if cost.is_finite() { (cost.max(1e-300).ln() / PRECISION) as FitnessValue } else { FitnessValue::MAX }
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
        let all = &mut population.chromosomes;
        // The crate draws from a given first population with replacement; every member shall be there once.
        for (chromosome, (score, genes)) in all.iter_mut().zip(self.first.drain(..)) {
            chromosome.genes = genes;
            chromosome.set_fitness_score(Some(score));
        }
        let fresh: Vec<usize> = (0..all.len()).filter(|i| all[*i].fitness_score().is_none()).collect();
        let genes: Vec<&[f64]> = fresh.iter().map(|i| all[*i].genes.as_slice()).collect();
        let scores = self.scores(&genes);
        for (i, score) in fresh.into_iter().zip(scores) {
            all[i].set_fitness_score(Some(score));
        }
        let best = all.iter().filter_map(|c| c.fitness_score()).min();
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
        self.scores(&[chromosome.genes.as_slice()]).first().copied()
    }
}
