//! Forces that switch with a state with hysteresis and dead time, as those of a limit cycle.

use crate::model::forced_response::Forces;
use crate::model::score_test::ScoreTest;
use crate::residual::basis::{Signal, relay};
use crate::thresholds::{
    RELAY_DEAD_TIMES_S, RELAY_ROUNDS, RELAY_STEPS, RELAY_THRESHOLDS, RELAYS_REFINED, RELAYS_TOGETHER,
};

/// A hysteresis relay on a state, and the size of its force.
#[derive(Debug, Clone)]
pub struct Relay {
    /// Index of the state that switches the relay.
    pub follows: usize,
    /// Threshold, as a share of the state's largest magnitude.
    pub threshold: f64,
    /// Dead time, s.
    pub late_s: f64,
    /// Score in the score test: the reduction of the whitened sum of squares.
    pub score: f64,
    /// Size of its force, in the unit that `forces` have.
    pub size: f64,
}

impl Relay {
    /// Description of its force: "switches with pitch after a delay of 0.50 s".
    pub fn description(&self, states: &[Signal]) -> String {
        format!("switches with {} after a delay of {:.2} s", states[self.follows].name, self.late_s)
    }

    /// Response of the samples (filled) to its force.
    pub fn response(
        &self,
        score_test: &ScoreTest<'_>,
        forces: &Forces<'_>,
        states: &[Signal],
    ) -> Option<Vec<f64>> {
        let late = self.late_s / score_test.data().period_s;
        let force = relay(&states[self.follows].values, self.threshold, late);
        let mut response = forces.each(&[&force], |_, _, response| response).pop()?;
        score_test.data().fill(&mut response);
        response.iter_mut().for_each(|r| *r *= self.size);
        Some(response)
    }
}

/// Number of relays tried for each state, without the refinement.
pub fn looks() -> usize {
    RELAY_THRESHOLDS.len() * RELAY_DEAD_TIMES_S.len()
}

/// The relay that explains most of a score test's residual.
pub fn likeliest(
    score_test: &ScoreTest<'_>,
    forces: &Forces<'_>,
    states: &[Signal],
    refine: bool,
) -> Option<Relay> {
    let grid = |follows: usize| {
        let all = RELAY_THRESHOLDS.iter().flat_map(|t| RELAY_DEAD_TIMES_S.iter().map(move |d| (*t, *d)));
        all.map(move |(threshold, late_s)| (follows, threshold, late_s))
    };
    let mut best = weighed(score_test, forces, states, (0..states.len()).flat_map(grid).collect());
    if refine {
        let (mut wider, mut later) = RELAY_STEPS;
        for _ in 0..RELAY_ROUNDS {
            best.truncate(RELAYS_REFINED);
            let around = [-1.0, 0.0, 1.0];
            let near = best.iter().flat_map(|r| {
                let pairs = around.into_iter().flat_map(|a| around.map(|b| (a, b)));
                pairs.map(|(a, b)| {
                    (r.follows, r.threshold * f64::exp(a * wider), (r.late_s + b * later).max(0.0))
                })
            });
            best = weighed(score_test, forces, states, near.collect());
            (wider, later) = (0.5 * wider, 0.5 * later);
        }
    }
    best.into_iter().next()
}

/// Scores of relays of the given states, thresholds and dead times, highest first.
fn weighed(
    score_test: &ScoreTest<'_>,
    forces: &Forces<'_>,
    states: &[Signal],
    tried: Vec<(usize, f64, f64)>,
) -> Vec<Relay> {
    let period = score_test.data().period_s;
    let mut all = Vec::new();
    for tried in tried.chunks(RELAYS_TOGETHER) {
        let functions: Vec<Vec<f64>> = tried
            .iter()
            .map(|(follows, threshold, late_s)| relay(&states[*follows].values, *threshold, late_s / period))
            .collect();
        let functions: Vec<&[f64]> = functions.iter().map(Vec::as_slice).collect();
        all.extend(forces.each(&functions, |_, index, mut response| {
            score_test.data().fill(&mut response);
            let look = score_test.score(&response);
            let (follows, threshold, late_s) = tried[index];
            Relay { follows, threshold, late_s, score: look.score, size: look.amplitude }
        }));
    }
    all.retain(|r| r.score.is_finite());
    all.sort_by(|a, b| b.score.total_cmp(&a.score));
    all
}
