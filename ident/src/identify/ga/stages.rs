//! The way from stage to stage.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use genetic_algorithm::strategy::evolve::prelude::*;
use rand_ga::Rng;

use super::cost::PRECISION;

/// A stage before the last ends when nine tenths of the population cost less than this times the best: it has found
/// the valley, and is still wide enough to move on to where the next stage has its optimum.
const NEAR: f64 = 1.5;
/// The last stage ends at this ratio.
const SETTLED: f64 = 1.001;

/// Goes on to the next stage as the population settles; the survivors' costs are then found anew.
#[derive(Debug, Clone)]
pub struct Stages {
    /// The present stage.
    pub stage: Arc<AtomicUsize>,
    /// The last stage.
    pub last: usize,
    /// Generations without progress after which a stage ends.
    pub stagnation: usize,
    /// Generations of the whole run; the stages before the last get half of them at most.
    pub generations: usize,
    /// Set when the population has settled in the last stage.
    pub settled: Arc<AtomicBool>,
}

impl Extension for Stages {
    type Genotype = MultiRangeGenotype<f64>;

    fn after_selection_complete<R: Rng, SR: StrategyReporter<Genotype = Self::Genotype>>(
        &mut self,
        _genotype: &mut Self::Genotype,
        state: &mut EvolveState<Self::Genotype>,
        _config: &EvolveConfig,
        _reporter: &mut SR,
        _rng: &mut R,
    ) {
        let all = &mut state.population.chromosomes;
        let mut scores: Vec<FitnessValue> = all.iter().filter_map(|c| c.fitness_score()).collect();
        scores.sort_unstable();
        let (Some(best), Some(tail)) = (scores.first(), scores.get(scores.len() * 9 / 10)) else { return };
        let within = |ratio: f64| (tail.saturating_sub(*best) as f64) * PRECISION < ratio.ln();
        let stage = self.stage.load(Ordering::Relaxed);
        if stage == self.last {
            // Where all simulations leave all bounds, all score alike, and nothing has settled.
            if *best < FitnessValue::MAX && within(SETTLED) {
                self.settled.store(true, Ordering::Relaxed);
            }
            return;
        }
        let late = state.current_generation * 2 * self.last >= self.generations * (stage + 1);
        if within(NEAR) || late || state.stale_generations >= self.stagnation {
            self.stage.store(stage + 1, Ordering::Relaxed);
            all.iter_mut().for_each(|c| c.set_fitness_score(None));
            state.best_fitness_score = None;
            state.best_chromosome = None;
            state.stale_generations = 0;
        }
    }
}
