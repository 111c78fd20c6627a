//! Recombination and alternation.

use genetic_algorithm::strategy::evolve::prelude::*;
use rand_ga::Rng;

/// REX: children about the centre of the parents, who leave the population.
#[derive(Debug, Clone)]
pub struct Rex {
    /// Parents a generation.
    pub parents: usize,
    /// Children a generation.
    pub children: usize,
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
pub struct Alternate {
    /// Parents a generation.
    pub parents: usize,
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
pub struct NoMutation;

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
