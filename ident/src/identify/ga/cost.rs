//! Cost of a set of genes.

use std::ops::ControlFlow;

use rayon::prelude::*;

use crate::identify::batch::{Batch, LANES};
use crate::identify::data::Segment;
use crate::identify::problem::Problem;
use crate::watch::Watch;

/// Search range of every unknown, SI: the bounds of the parameters, then ranges of initial states and offsets
/// derived from the record.
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
            (whirlstand_logs::stats::mean(&first), if high > low { high - low } else { 0.0 })
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

/// Maps genes in [0, 1] to values: the middle of a wide range is searched more finely than its ends, as
/// bounds are mostly generous.
pub fn scaled(genes: &[f64], range: &[(f64, f64)]) -> Vec<f64> {
    const WARP: f64 = 4.0;
    let warped = |g: f64| (WARP * (2.0 * g - 1.0)).sinh() / WARP.sinh();
    genes
        .iter()
        .zip(range)
        .map(|(g, (low, high))| (0.5 * (low + high) + 0.5 * (high - low) * warped(*g)).clamp(*low, *high))
        .collect()
}

/// A member of the population: genes in [0, 1] and their score.
#[derive(Debug, Clone, PartialEq)]
pub struct Member {
    /// Logarithm of the cost; infinite where the simulation diverges.
    pub score: f64,
    /// One gene per unknown, 0 to 1.
    pub genes: Vec<f64>,
}

/// Evaluates the cost of genes, in batches, on all cores.
pub struct Cost<'a> {
    /// Simulations of each stage; those of the last stage run freely.
    pub batches: Vec<Batch<'a>>,
    /// Lower and upper end of the range of every unknown, SI.
    pub range: &'a [(f64, f64)],
    /// Number of simulations so far, over all runs.
    pub evaluations: usize,
    /// Largest number of simulations.
    pub most: usize,
    /// Receives the progress after every generation, and can stop the search.
    pub watch: &'a Watch,
    /// Stage of the search: an index into `batches`.
    pub stage: usize,
}

impl Cost<'_> {
    /// The genes with their scores at the current stage.
    pub fn scored(&mut self, genes: Vec<Vec<f64>>) -> Vec<Member> {
        let points: Vec<Vec<f64>> = genes.iter().map(|g| scaled(g, self.range)).collect();
        let batch = &self.batches[self.stage];
        let costs = points.par_chunks(LANES).flat_map_iter(|chunk| {
            let chunk: Vec<&[f64]> = chunk.iter().map(Vec::as_slice).collect();
            batch.costs(&chunk)
        });
        let costs: Vec<f64> = costs.collect();
        self.evaluations += costs.len();
        costs.into_iter().zip(genes).map(|(cost, genes)| Member { score: score(cost), genes }).collect()
    }

    /// Reports the best cost of a generation; the result says whether to continue. The reported share relates
    /// to the largest number of simulations: most searches end earlier.
    pub fn report(&self, best: f64) -> ControlFlow<()> {
        let share = (self.evaluations as f64 / self.most.max(1) as f64).min(1.0);
        let detail = || format!("best cost {:.6e}", best.exp());
        self.watch.step("searching with a genetic algorithm", detail, Some(share))
    }
}

/// The logarithm of a cost.
fn score(cost: f64) -> f64 {
    // A cost of exactly zero has no logarithm.
    if cost.is_finite() { cost.max(1e-300).ln() } else { f64::INFINITY }
}
