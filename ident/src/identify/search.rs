//! Levenberg-Marquardt within bounds, for any cost that gives an information matrix.

use std::ops::ControlFlow;

use nalgebra::{DMatrix, DVector};

use super::normal::solve;
use crate::watch::Watch;

/// A value of the unknowns with its cost and the derivatives of the cost.
pub trait Point {
    /// Values of the unknowns.
    fn position(&self) -> &[f64];
    /// The cost at this point.
    fn cost(&self) -> f64;
    /// Derivatives of the cost at this point, requested once, where the search continues from it. `None`
    /// where they do not exist: the search ends there.
    fn derivatives(&mut self) -> Option<Derivatives>;
}

/// Derivatives of a cost.
#[derive(Debug, Clone)]
pub struct Derivatives {
    /// Information matrix, unknowns x unknowns: a positive semidefinite approximation of the second derivative of the
    /// cost.
    pub information: DMatrix<f64>,
    /// Negative gradient of the cost.
    pub right: DVector<f64>,
}

/// Effort and success of a search.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Outcome {
    /// Number of steps.
    pub iterations: usize,
    /// Number of evaluations of the cost, without that of the start.
    pub evaluations: usize,
    /// True when the last step was shorter than the tolerance, and not only because of its damping.
    pub converged: bool,
    /// Damping of the next step, had there been one.
    pub damping: f64,
}

/// Limits of a search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Largest number of steps.
    pub iterations: usize,
    /// The search ends when a step is shorter than this many standard errors (norm over all parameters).
    pub tolerance: f64,
    /// The search ends after a step that lowers the cost by less than this.
    pub gain: f64,
    /// Number of increasingly damped steps tried from one point.
    pub trials: usize,
    /// Damping of the first step, relative to the diagonal of the information matrix.
    pub damping: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { iterations: 100, tolerance: 1e-3, gain: 0.0, trials: 30, damping: 1e-3 }
    }
}

/// Distance in standard errors, as predicted, below which a failed step counts as convergence: rounding then
/// hides the minimum.
const NEAR: f64 = 0.5;

/// Minimises a cost from `start`, every unknown i within `bounds[i]`. `at` returns the point at a position,
/// given the step that led there, or `None` where the cost does not exist.
///
/// Damping follows Nielsen (IMM-REP-1999-05): it falls smoothly with the gain ratio and grows twice as fast
/// at each failure. A coordinate at a bound whose step points outwards is held there. `observe` receives the
/// number of the step and the cost before each step and after each failure, and may end the search at the
/// best point so far.
pub fn search<P: Point>(
    start: P,
    bounds: &[(f64, f64)],
    limits: Limits,
    mut at: impl FnMut(&P, &[f64], &DVector<f64>) -> Option<P>,
    mut observe: impl FnMut(usize, f64) -> ControlFlow<()>,
) -> (P, Outcome) {
    let mut point = start;
    let mut outcome = Outcome { damping: limits.damping, ..Outcome::default() };
    let mut growth = 2.0;
    while outcome.iterations < limits.iterations {
        outcome.iterations += 1;
        if observe(outcome.iterations, point.cost()).is_break() {
            break;
        }
        let Some(slopes) = point.derivatives() else { break };
        let mut stepped = false;
        // Predicted distance of the minimum: the first step of a round, without its damping.
        let mut ahead = f64::INFINITY;
        for _ in 0..limits.trials {
            let Some((position, step)) = step(point.position(), &slopes, bounds, outcome.damping) else {
                break;
            };
            let curved = &slopes.information * &step;
            let length = step.dot(&curved).max(0.0).sqrt();
            ahead = ahead.min(length * (1.0 + outcome.damping));
            if length < limits.tolerance {
                // A step that is short only because of its damping is no sign of a minimum.
                outcome.converged = ahead < NEAR;
                return (point, outcome);
            }
            outcome.evaluations += 1;
            let predicted = slopes.right.dot(&step) - 0.5 * step.dot(&curved);
            if let Some(next) = at(&point, &position, &step)
                && next.cost() < point.cost()
            {
                let gain = point.cost() - next.cost();
                let ratio = gain / predicted.max(1e-300);
                let change = (1.0 - (2.0 * ratio - 1.0).powi(3)).clamp(1.0 / 5.0, 1.0);
                outcome.damping = (outcome.damping * change).max(1e-12);
                growth = 2.0;
                point = next;
                if gain < limits.gain {
                    outcome.converged = true;
                    return (point, outcome);
                }
                stepped = true;
                break;
            }
            outcome.damping *= growth;
            growth *= 2.0;
            if observe(outcome.iterations, point.cost()).is_break() {
                break;
            }
        }
        if !stepped {
            // No nearby point is lower: rounding, or a kink.
            break;
        }
    }
    (point, outcome)
}

/// Reports the progress of a descent; the result says whether to continue.
pub(super) fn descends(watch: &Watch, step: usize, cost: f64) -> ControlFlow<()> {
    watch.step("descends", || format!("step {step}, cost {cost:.6e}"), None)
}

/// The damped step and where it leads, within the bounds.
fn step(
    position: &[f64],
    slopes: &Derivatives,
    bounds: &[(f64, f64)],
    damping: f64,
) -> Option<(Vec<f64>, DVector<f64>)> {
    let (f, g) = (&slopes.information, &slopes.right);
    let n = position.len();
    let mut held: Vec<bool> = (0..n)
        .map(|i| {
            let (lower, upper) = bounds[i];
            f[(i, i)] <= 0.0 || position[i] <= lower && g[i] < 0.0 || position[i] >= upper && g[i] > 0.0
        })
        .collect();
    // A step that leaves the bounds is cut there and the others are recomputed.
    for _ in 0..=n {
        let free: Vec<usize> = (0..n).filter(|i| !held[*i]).collect();
        let mut step = DVector::zeros(n);
        if !free.is_empty() {
            let scale: Vec<f64> = free.iter().map(|i| 1.0 / f[(*i, *i)].sqrt()).collect();
            let mut scaled =
                DMatrix::from_fn(free.len(), free.len(), |a, b| f[(free[a], free[b])] * scale[a] * scale[b]);
            for a in 0..free.len() {
                scaled[(a, a)] += damping;
            }
            let right = DVector::from_fn(free.len(), |a, _| g[free[a]] * scale[a]);
            let solution = solve(&scaled, &right)?;
            for (a, i) in free.iter().enumerate() {
                step[*i] = solution[a] * scale[a];
            }
        }
        let beyond = (0..n).filter(|i| !held[*i]).find(|i| {
            let (lower, upper) = bounds[*i];
            let to = position[*i] + step[*i];
            (to < lower && position[*i] <= lower) || (to > upper && position[*i] >= upper)
        });
        if let Some(i) = beyond {
            held[i] = true;
            continue;
        }
        let to: Vec<f64> = (0..n).map(|i| (position[i] + step[i]).clamp(bounds[i].0, bounds[i].1)).collect();
        let taken = DVector::from_fn(n, |i, _| to[i] - position[i]);
        return taken.iter().all(|v| v.is_finite()).then_some((to, taken));
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Rosenbrock {
        x: Vec<f64>,
        f: DMatrix<f64>,
        g: DVector<f64>,
        cost: f64,
    }

    impl Rosenbrock {
        fn new(x: &[f64]) -> Self {
            let r = DVector::from_vec(vec![10.0 * (x[1] - x[0] * x[0]), 1.0 - x[0]]);
            let j = DMatrix::from_row_slice(2, 2, &[-20.0 * x[0], 10.0, -1.0, 0.0]);
            Self {
                x: x.to_vec(),
                f: j.transpose() * &j,
                g: -j.transpose() * &r,
                cost: 0.5 * r.norm_squared(),
            }
        }
    }

    impl Point for Rosenbrock {
        fn position(&self) -> &[f64] {
            &self.x
        }
        fn cost(&self) -> f64 {
            self.cost
        }
        fn derivatives(&mut self) -> Option<Derivatives> {
            Some(Derivatives { information: self.f.clone(), right: self.g.clone() })
        }
    }

    #[test]
    fn the_valley_is_followed_and_bounds_hold() {
        let limits = Limits { iterations: 200, tolerance: 1e-9, ..Limits::default() };
        let at = |_: &Rosenbrock, x: &[f64], _: &DVector<f64>| Some(Rosenbrock::new(x));
        let free = [(-5.0, 5.0), (-5.0, 5.0)];
        let (best, outcome) =
            search(Rosenbrock::new(&[-1.2, 1.0]), &free, limits, at, |_, _| ControlFlow::Continue(()));
        assert!(outcome.converged && (best.x[0] - 1.0).abs() < 1e-6 && (best.x[1] - 1.0).abs() < 1e-6);
        let bounded = [(-5.0, 0.5), (-5.0, 5.0)];
        let (best, _) =
            search(Rosenbrock::new(&[-1.2, 1.0]), &bounded, limits, at, |_, _| ControlFlow::Continue(()));
        assert!((best.x[0] - 0.5).abs() < 1e-9 && (best.x[1] - 0.25).abs() < 1e-6, "{:?}", best.x);
    }

    #[test]
    fn a_search_that_is_ended_gives_the_best_point_so_far() {
        let at = |_: &Rosenbrock, x: &[f64], _: &DVector<f64>| Some(Rosenbrock::new(x));
        let free = [(-5.0, 5.0), (-5.0, 5.0)];
        let start = || Rosenbrock::new(&[-1.2, 1.0]);
        let (unmoved, outcome) = search(start(), &free, Limits::default(), at, |_, _| ControlFlow::Break(()));
        assert_eq!((unmoved.x, outcome.evaluations, outcome.converged), (vec![-1.2, 1.0], 0, false));
        let until_third = |step, _| if step < 3 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) };
        let (best, outcome) = search(start(), &free, Limits::default(), at, until_third);
        assert!(!outcome.converged && outcome.iterations == 3 && best.cost < start().cost, "{outcome:?}");
    }
}
