//! One run of the genetic algorithm: a population from its first members until convergence.

use whirlstand_vehicle::Stream;

use super::LANES;
use super::cost::{Cost, Member};
use super::rex::{children, take_parents};
use super::stages::{Next, Stages};

/// Children per generation, in multiples of the number of unknowns.
const CHILDREN: usize = 6;
/// Ratio of random points to members of the first population, which is the best of them.
const OVERSAMPLING: usize = 4;
/// Smallest decrease of the logarithm of the cost that counts as progress.
const PRECISION: f64 = 1e-5;

/// Result of a run.
pub struct Run {
    /// Best genes of the last stage reached.
    pub genes: Vec<f64>,
    /// Number of generations.
    pub generations: usize,
    /// True when the run ended because nothing improved, false when the simulations were spent or the search
    /// was stopped.
    pub stagnated: bool,
}

/// The best member of a stage so far, and the number of generations since its last progress.
struct Best {
    member: Member,
    /// Score relative to which the next progress is measured.
    mark: f64,
    /// Number of generations without progress.
    stale: usize,
}

impl Best {
    fn of(population: &[Member]) -> Self {
        let member = least(population).clone();
        Self { mark: member.score, member, stale: 0 }
    }

    fn update(&mut self, population: &[Member]) {
        let least = least(population);
        if least.score < self.member.score {
            self.member = least.clone();
        }
        if self.member.score < self.mark - PRECISION {
            self.mark = self.member.score;
            self.stale = 0;
        } else {
            self.stale += 1;
        }
    }
}

/// The member with the lowest score; a population is never empty.
fn least(population: &[Member]) -> &Member {
    population.iter().fold(&population[0], |best, m| if m.score < best.score { m } else { best })
}

/// Evolves a population of `size` from random points until it has converged, nothing has improved for
/// `stagnation` generations, the simulations are spent, or the search is stopped.
pub fn evolve(cost: &mut Cost<'_>, size: usize, seed: u64, stagnation: usize) -> Run {
    let d = cost.range.len();
    let offspring = (CHILDREN * d.max(1)).next_multiple_of(LANES);
    cost.stage = 0;
    let mut population = first(cost, size, seed);
    let mut best = Best::of(&population);
    if cost.report(best.member.score).is_break() {
        return Run { genes: best.member.genes, generations: 0, stagnated: false };
    }
    let generations = (cost.most.saturating_sub(cost.evaluations) / offspring).max(1);
    let stages = Stages { last: cost.batches.len() - 1, stagnation, generations };
    let mut stream = Stream::new(seed, "recombination");
    for generation in 1..=generations {
        let parents = take_parents(&mut population, d + 1, &mut stream);
        let mut young = cost.scored(children(&parents, offspring, &mut stream));
        // JGG: the best children replace the parents.
        young.sort_by(|a, b| a.score.total_cmp(&b.score));
        population.extend(young.into_iter().take(parents.len()));
        best.update(&population);
        if cost.report(best.member.score).is_break() {
            return Run { genes: best.member.genes, generations: generation, stagnated: false };
        }
        match stages.next(cost.stage, &population, generation, best.stale) {
            Next::Stay => {}
            Next::Advance => {
                cost.stage += 1;
                population = cost.scored(population.into_iter().map(|member| member.genes).collect());
                best = Best::of(&population);
            }
            Next::End => {
                let stagnated = generation < generations;
                return Run { genes: best.member.genes, generations: generation, stagnated };
            }
        }
    }
    Run { genes: best.member.genes, generations, stagnated: false }
}

/// The best of many random points, of fewer when the search is stopped.
fn first(cost: &mut Cost<'_>, size: usize, seed: u64) -> Vec<Member> {
    let d = cost.range.len();
    let mut stream = Stream::new(seed, "first population");
    let mut best: Vec<Member> = Vec::new();
    for _ in 0..OVERSAMPLING {
        let genes = (0..size).map(|_| (0..d).map(|_| stream.uniform()).collect()).collect();
        best.extend(cost.scored(genes));
        best.sort_by(|a, b| a.score.total_cmp(&b.score));
        best.truncate(size);
        if cost.watch.is_stopped() {
            break;
        }
    }
    best
}
