//! The covariance of a filter that has run for a long time.

use nalgebra::DMatrix;

use super::filter_model::FilterModel;
use super::flow::Flow;

/// Largest number of times that the number of steps is doubled. A state that no measurement shows has no settled variance;
/// what it has after so many steps changes nothing that is measured.
const MOST_DOUBLINGS: usize = 20;
/// Relative change of a variance at which it has settled.
const SETTLED: f64 = 1e-12;

/// Covariance of the state before the first measurements of a pattern that repeats for ever, n x n; `pattern` has for every
/// step the set of outputs that are measured, output i as bit i. `None` where it does not stay finite.
///
/// Each doubling of the number of steps squares what is left of the initial covariance (Anderson and Moore, Optimal
/// Filtering, 1979, section 6.7), so that few of them suffice where single steps would need thousands.
pub fn settled_covariance(model: &FilterModel, pattern: &[u64]) -> Option<DMatrix<f64>> {
    let n = model.f.nrows();
    let mut flow = Flow::new(model);
    pattern.iter().for_each(|&mask| flow.append(mask));
    let mut variances = vec![0.0; n];
    for _ in 0..MOST_DOUBLINGS {
        // From no uncertainty at all.
        let now: Vec<f64> = (0..n).map(|i| flow.covariance().entry(i, i)).collect();
        if !now.iter().all(|v| v.is_finite()) {
            return None;
        }
        let is_settled = |(v, before): (&f64, &f64)| (v - before).abs() <= SETTLED * v.abs();
        if now.iter().zip(&variances).all(is_settled) {
            break;
        }
        variances = now;
        flow.double();
    }
    let after = flow.covariance();
    let p = DMatrix::from_fn(n, n, |i, j| after.entry(i, j));
    let before = &model.f * p * model.f.transpose() + &model.q;
    before.iter().all(|v| v.is_finite()).then_some(before)
}
