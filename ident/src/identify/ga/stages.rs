//! Decides when the search proceeds to the next stage with longer simulations.

use super::cost::Member;

/// A stage before the last ends when nine tenths of the population cost less than this times the best: the
/// minimum is found, and the population is still wide enough to move to the optimum of the next stage.
const NEAR: f64 = 1.5;
/// The last stage ends when nine tenths of the population cost less than this times the best.
const SETTLED: f64 = 1.001;

/// Decision after a generation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Next {
    /// Another generation of the same stage.
    Stay,
    /// The next stage, in which all costs are recomputed.
    Advance,
    /// The end of the run: the population has converged, or nothing improves any more.
    End,
}

/// Limits of the stages.
#[derive(Debug, Clone, Copy)]
pub struct Stages {
    /// Index of the last stage.
    pub last: usize,
    /// Generations without progress after which a stage ends.
    pub stagnation: usize,
    /// Generations of the whole run; the stages before the last get half of them at most.
    pub generations: usize,
}

impl Stages {
    /// Decides what follows generation `generation`, after `stale` generations without progress.
    pub fn next(&self, stage: usize, population: &[Member], generation: usize, stale: usize) -> Next {
        let mut scores: Vec<f64> = population.iter().map(|member| member.score).collect();
        scores.sort_unstable_by(f64::total_cmp);
        // Where all simulations diverge, all scores are equal, and nothing has converged.
        let spread = match (scores.first(), scores.get(scores.len() * 9 / 10)) {
            (Some(best), Some(tail)) if best.is_finite() => tail - best,
            _ => f64::INFINITY,
        };
        let stagnant = stale >= self.stagnation;
        if stage == self.last {
            return if spread < SETTLED.ln() || stagnant { Next::End } else { Next::Stay };
        }
        let late = generation * 2 * self.last >= self.generations * (stage + 1);
        if spread < NEAR.ln() || late || stagnant { Next::Advance } else { Next::Stay }
    }
}
