//! Costs of many simulations at once, without sensitivities, for the genetic algorithm.
//!
//! Sixteen models are simulated side by side in one loop, so that their arithmetic uses the full vector width
//! instead of waiting for one recursion.

use multiversion::multiversion;
use whirlstand_vehicle::{Simulator, discretise};

use super::data::Segment;
use super::problem::Problem;

/// Number of models that are simulated side by side.
pub const LANES: usize = 16;
type Lane = [f64; LANES];
/// Absolute value beyond which a simulation counts as diverged.
const LARGEST: f64 = 1e9;

/// Computes the normalised mean square error of simulations.
#[derive(Debug, Clone)]
pub struct Batch<'p> {
    problem: &'p Problem,
    segments: &'p [Segment],
    /// Weight of each output divided by its number of values times their variance.
    scale: Vec<f64>,
    /// States that an output measures: state, output, gain.
    measuring: Vec<(usize, usize, f64)>,
    /// Steps after which the measured states are reset to the record.
    horizon: usize,
}

impl<'p> Batch<'p> {
    /// Simulations of `segments`. The cost of a point is the weighted mean over the outputs of the mean
    /// square error divided by the variance of the output; it is dimensionless.
    pub fn new(problem: &'p Problem, segments: &'p [Segment]) -> Self {
        let p = problem.p();
        let total: f64 = problem.weights.iter().sum();
        let scale = (0..p).map(|i| {
            let values: Vec<f64> =
                segments.iter().flat_map(|s| s.output(i, p)).filter(|v| v.is_finite()).collect();
            let mean = whirlstand_logs::stats::mean(&values);
            let sum: f64 = values.iter().map(|v| (v - mean) * (v - mean)).sum();
            if problem.weights[i] > 0.0 && sum > 0.0 { problem.weights[i] / (total * sum) } else { 0.0 }
        });
        let measuring = super::start::measuring_outputs(&problem.vehicle, &problem.weights);
        let measuring =
            measuring.into_iter().enumerate().filter_map(|(j, s)| s.map(|(i, gain)| (j, i, gain)));
        let horizon = usize::MAX;
        Self { scale: scale.collect(), problem, segments, measuring: measuring.collect(), horizon }
    }

    /// A batch whose simulations run freely for `steps` only: then the states that an output measures are
    /// reset to the record. The shorter the run, the smoother the cost is as a function of the parameters,
    /// the more it resembles an equation error, and the larger the effect of noise (Ribeiro et al.,
    /// Automatica 121, 2020).
    pub fn with_horizon(&self, steps: usize) -> Self {
        Self { horizon: steps.max(1), ..self.clone() }
    }

    /// True when some state can be reset to the record.
    pub fn restarts(&self) -> bool {
        !self.measuring.is_empty()
    }

    fn starts_anew(&self, k: usize) -> bool {
        k > 0 && k.is_multiple_of(self.horizon)
    }

    /// Number of unknowns of a point: the parameters, then the nuisances of every segment.
    pub fn unknowns(&self) -> usize {
        self.problem.parameters.len() + self.problem.nuisances() * self.segments.len()
    }

    /// Costs of up to [`LANES`] points; infinite where a simulation diverges.
    pub fn costs(&self, points: &[&[f64]]) -> Vec<f64> {
        debug_assert!(points.len() <= LANES);
        if self.problem.is_plain() {
            let costs = self.plain(points);
            costs[..points.len()].to_vec()
        } else {
            points.iter().map(|point| self.extended(point)).collect()
        }
    }

    fn nuisance<'a>(&self, point: &'a [f64], segment: usize) -> (&'a [f64], &'a [f64]) {
        let count = self.problem.nuisances();
        let first = self.problem.parameters.len() + segment * count;
        super::problem::split(self.problem, &point[first..first + count])
    }

    fn plain(&self, points: &[&[f64]]) -> Lane {
        let p = self.problem.p();
        let mut cost = [f64::INFINITY; LANES];
        let models = Models::new(self.problem, points, &mut cost);
        for (s, segment) in self.segments.iter().enumerate() {
            let mut z: Vec<Lane> = vec![[0.0; LANES]; models.width];
            let mut offset: Vec<Lane> = vec![[0.0; LANES]; p];
            for (lane, point) in points.iter().enumerate() {
                let (initial, offsets) = self.nuisance(point, s);
                initial.iter().enumerate().for_each(|(i, v)| z[i][lane] = *v);
                offsets.iter().enumerate().for_each(|(i, v)| offset[i][lane] = *v);
            }
            sweep(self, &models, segment, z, &offset, &mut cost);
        }
        cost.map(|c| if c.is_finite() { c } else { f64::INFINITY })
    }

    fn extended(&self, point: &[f64]) -> f64 {
        let (m, p) = (self.problem.m(), self.problem.p());
        let vehicle = self.problem.vehicle_at(&point[..self.problem.parameters.len()]);
        let Ok(simulator) = Simulator::expected(&vehicle, self.problem.period_s) else {
            return f64::INFINITY;
        };
        let mut cost = 0.0;
        for (s, segment) in self.segments.iter().enumerate() {
            let (initial, offsets) = self.nuisance(point, s);
            let mut simulator = simulator.clone();
            simulator.begin_at(segment.first_step);
            if !initial.is_empty() {
                simulator.set_state(initial);
            }
            for k in 0..segment.steps {
                if self.starts_anew(k) {
                    let mut state = simulator.state().to_vec();
                    for &(j, i, gain) in &self.measuring {
                        let y = segment.outputs[k * p + i] - offsets.get(i).unwrap_or(&0.0);
                        if y.is_finite() {
                            state[j] = y / gain;
                        }
                    }
                    simulator.set_state(&state);
                }
                simulator.apply(&segment.inputs[k * m..(k + 1) * m]);
                let y = simulator.measure();
                let measured = &segment.outputs[k * p..(k + 1) * p];
                for (i, (measured, y)) in measured.iter().zip(y).enumerate() {
                    let e = measured - y - offsets.get(i).unwrap_or(&0.0);
                    if e.is_finite() {
                        cost += self.scale[i] * e * e;
                    }
                }
                simulator.advance();
            }
            if simulator.diverged() {
                return f64::INFINITY;
            }
        }
        if cost.is_finite() { cost } else { f64::INFINITY }
    }
}

/// Models simulated side by side.
struct Models {
    states: usize,
    /// Number of states and inputs.
    width: usize,
    /// [Phi Gamma], row after row.
    motion: Vec<Lane>,
    /// For every output with a weight: its index, and its row over [x; u].
    sensing: Vec<(usize, Vec<(usize, Lane)>)>,
}

impl Models {
    /// The models at `points`; the cost of models without a finite discretisation is unchanged, that of
    /// others set to 0.
    fn new(problem: &Problem, points: &[&[f64]], cost: &mut Lane) -> Self {
        let (n, m, p) = (problem.n(), problem.m(), problem.p());
        let w = n + m;
        let mut motion: Vec<Lane> = vec![[0.0; LANES]; n * w];
        let mut sensing: Vec<Lane> = vec![[0.0; LANES]; p * w];
        for (lane, point) in points.iter().enumerate() {
            let [a, b, c, d] = problem.matrices_at(&point[..problem.parameters.len()]);
            let Ok((phi, gamma)) = discretise(&a, &b, problem.period_s) else { continue };
            cost[lane] = 0.0;
            for i in 0..n {
                (0..n).for_each(|j| motion[i * w + j][lane] = phi[(i, j)]);
                (0..m).for_each(|j| motion[i * w + n + j][lane] = gamma[(i, j)]);
            }
            for i in 0..p {
                (0..n).for_each(|j| sensing[i * w + j][lane] = c[(i, j)]);
                (0..m).for_each(|j| sensing[i * w + n + j][lane] = d[(i, j)]);
            }
        }
        let row = |i: usize| {
            let entries = (0..w).map(|j| (j, sensing[i * w + j]));
            (i, entries.filter(|(_, lanes)| *lanes != [0.0; LANES]).collect())
        };
        let fitted = (0..p).filter(|i| problem.weights[*i] > 0.0);
        Self { states: n, width: w, sensing: fitted.map(row).collect(), motion }
    }
}

/// Simulates the models over a segment, from the initial states in `z`, and adds to their costs; infinite for
/// those that diverge.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn sweep(
    batch: &Batch<'_>,
    models: &Models,
    segment: &Segment,
    mut z: Vec<Lane>,
    offset: &[Lane],
    cost: &mut Lane,
) {
    let (n, w, p) = (models.states, models.width, offset.len());
    let mut next = z.clone();
    let mut squares: Vec<Lane> = vec![[0.0; LANES]; p];
    let mut until_anew = batch.horizon;
    for k in 0..segment.steps {
        let measured = &segment.outputs[k * p..(k + 1) * p];
        for (z, u) in z[n..].iter_mut().zip(&segment.inputs[k * (w - n)..(k + 1) * (w - n)]) {
            *z = [*u; LANES];
        }
        if until_anew == 0 {
            until_anew = batch.horizon;
            for &(j, i, gain) in batch.measuring.iter().filter(|(_, i, _)| measured[*i].is_finite()) {
                z[j] = offset[i].map(|o| (measured[i] - o) / gain);
            }
        }
        until_anew -= 1;
        for (i, terms) in &models.sensing {
            let y = measured[*i];
            if y.is_nan() {
                continue;
            }
            let mut e: Lane = offset[*i].map(|o| y - o);
            for (j, c) in terms {
                let z = &z[*j];
                (0..LANES).for_each(|l| e[l] -= c[l] * z[l]);
            }
            let sum = &mut squares[*i];
            (0..LANES).for_each(|l| sum[l] += e[l] * e[l]);
        }
        for (next, row) in next.iter_mut().zip(models.motion.chunks_exact(w)) {
            let mut sum = [0.0; LANES];
            for (a, z) in row.iter().zip(z.iter()) {
                (0..LANES).for_each(|l| sum[l] += a[l] * z[l]);
            }
            *next = sum;
        }
        std::mem::swap(&mut z, &mut next);
        // A diverging lane would soon spread infinities through the other lanes' vectors.
        if k % 64 == 63 {
            for l in 0..LANES {
                if !(0..n).all(|i| z[i][l].abs() < LARGEST) {
                    cost[l] = f64::INFINITY;
                    (0..n).for_each(|i| z[i][l] = 0.0);
                }
            }
            if cost.iter().all(|c| c.is_infinite()) {
                return;
            }
        }
    }
    for (sum, scale) in squares.iter().zip(&batch.scale).filter(|(_, scale)| **scale > 0.0) {
        (0..LANES).for_each(|l| cost[l] += scale * sum[l]);
    }
}

#[cfg(test)]
mod tests {
    use super::super::problem::Nuisance;
    use super::super::tests::{pilot, record};
    use super::*;
    use whirlstand_vehicle::Vehicle;

    #[test]
    fn with_a_horizon_an_unstable_model_costs_something_finite_and_the_truth_stays_the_best() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let structure = Vehicle::builtin("quadrotor-structure").unwrap();
        let segments = [record(&vehicle, &pilot(2000, 2, 0.03, 10.0, 3), 0.03, 3)];
        let problem = Problem::new(&structure, &segments, Nuisance::default()).unwrap();
        let batch = Batch::new(&problem, &segments);
        let mut truth: Vec<f64> = problem.parameters.iter().map(|p| vehicle.free_value(&p.target)).collect();
        truth.resize(batch.unknowns(), 0.0);
        let (mut near, mut unstable) = (truth.clone(), truth.clone());
        near[0] *= 1.3;
        unstable[1] = 3.0;
        let points: [&[f64]; 3] = [&truth, &near, &unstable];
        let free = batch.costs(&points);
        assert!(free[0] < free[1] && free[2].is_infinite(), "{free:?}");
        for steps in [16, 100] {
            let costs = batch.with_horizon(steps).costs(&points);
            assert!(costs[0] < costs[1] && costs[1] < costs[2] && costs[2].is_finite(), "{steps} {costs:?}");
        }
        assert_eq!(batch.with_horizon(5000).costs(&points), free);
    }
}
