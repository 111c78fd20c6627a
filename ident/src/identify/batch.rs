//! Many simulations at once, for costs alone: what a genetic algorithm needs.
//!
//! Eight models run side by side in one loop, so that their arithmetic fills the machine's vectors instead of waiting
//! for one recursion.

use whirlstand_vehicle::{Simulator, discretise};

use super::data::Segment;
use super::problem::Problem;

/// Models that run side by side.
pub const LANES: usize = 8;
type Lane = [f64; LANES];
/// Beyond this a simulation has left all bounds.
const LARGEST: f64 = 1e9;

/// Computes the normalised mean square error of simulations.
#[derive(Debug, Clone)]
pub struct Batch<'p> {
    problem: &'p Problem,
    segments: &'p [Segment],
    /// Weight over (number of values times their variance), for each output.
    scale: Vec<f64>,
}

impl<'p> Batch<'p> {
    /// For the given data. The cost is the weighted mean, over outputs, of mean square error over variance.
    pub fn new(problem: &'p Problem, segments: &'p [Segment]) -> Self {
        let p = problem.p();
        let total: f64 = problem.weights.iter().sum();
        let scale = (0..p).map(|i| {
            let values: Vec<f64> =
                segments.iter().flat_map(|s| s.output(i, p)).filter(|v| v.is_finite()).collect();
            let mean = crate::stats::mean(&values);
            let sum: f64 = values.iter().map(|v| (v - mean) * (v - mean)).sum();
            if problem.weights[i] > 0.0 && sum > 0.0 { problem.weights[i] / (total * sum) } else { 0.0 }
        });
        Self { scale: scale.collect(), problem, segments }
    }

    /// Number of unknowns: parameters, then the nuisances of every segment.
    pub fn unknowns(&self) -> usize {
        self.problem.parameters.len() + self.problem.nuisances() * self.segments.len()
    }

    /// Costs of up to [`LANES`] points; infinity where a simulation leaves all bounds.
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
        let (n, m, p) = (self.problem.n(), self.problem.m(), self.problem.p());
        let w = n + m;
        let mut motion: Vec<Lane> = vec![[0.0; LANES]; n * w];
        let mut sensing: Vec<Lane> = vec![[0.0; LANES]; p * w];
        let mut cost = [f64::INFINITY; LANES];
        let mut used = vec![false; p * w];
        for (lane, point) in points.iter().enumerate() {
            let vehicle = self.problem.vehicle_at(&point[..self.problem.parameters.len()]);
            let Ok((phi, gamma)) = discretise(&vehicle.a, &vehicle.b, self.problem.period_s) else {
                continue;
            };
            cost[lane] = 0.0;
            for i in 0..n {
                (0..n).for_each(|j| motion[i * w + j][lane] = phi[(i, j)]);
                (0..m).for_each(|j| motion[i * w + n + j][lane] = gamma[(i, j)]);
            }
            for i in 0..p {
                (0..n).for_each(|j| sensing[i * w + j][lane] = vehicle.c[(i, j)]);
                (0..m).for_each(|j| sensing[i * w + n + j][lane] = vehicle.d[(i, j)]);
            }
        }
        for (used, lanes) in used.iter_mut().zip(&sensing) {
            *used = lanes.iter().any(|v| *v != 0.0);
        }
        // Output, weight, and the columns of [x; u] that it shows.
        let rows: Vec<(usize, Vec<usize>)> = (0..p)
            .filter(|i| self.scale[*i] > 0.0)
            .map(|i| (i, (0..w).filter(|j| used[i * w + j]).collect()))
            .collect();
        for (s, segment) in self.segments.iter().enumerate() {
            let mut z: Vec<Lane> = vec![[0.0; LANES]; w];
            let mut x: Vec<Lane> = vec![[0.0; LANES]; n];
            let mut offset: Vec<Lane> = vec![[0.0; LANES]; p];
            for (lane, point) in points.iter().enumerate() {
                let (initial, offsets) = self.nuisance(point, s);
                initial.iter().enumerate().for_each(|(i, v)| z[i][lane] = *v);
                offsets.iter().enumerate().for_each(|(i, v)| offset[i][lane] = *v);
            }
            let mut squares: Vec<Lane> = vec![[0.0; LANES]; p];
            for k in 0..segment.steps {
                for (z, u) in z[n..].iter_mut().zip(&segment.inputs[k * m..(k + 1) * m]) {
                    *z = [*u; LANES];
                }
                for (i, columns) in &rows {
                    let y = segment.outputs[k * p + i];
                    if y.is_nan() {
                        continue;
                    }
                    let mut e: Lane = offset[*i].map(|o| y - o);
                    for j in columns {
                        let (c, z) = (&sensing[i * w + j], &z[*j]);
                        (0..LANES).for_each(|l| e[l] -= c[l] * z[l]);
                    }
                    let sum = &mut squares[*i];
                    (0..LANES).for_each(|l| sum[l] += e[l] * e[l]);
                }
                for (x, row) in x.iter_mut().zip(motion.chunks_exact(w)) {
                    let mut sum = [0.0; LANES];
                    for (a, z) in row.iter().zip(&z) {
                        (0..LANES).for_each(|l| sum[l] += a[l] * z[l]);
                    }
                    *x = sum;
                }
                z[..n].copy_from_slice(&x);
                // A lane that grows without end would soon drag infinities through the others' vectors.
                if k % 64 == 63 {
                    for l in 0..LANES {
                        if !(0..n).all(|i| z[i][l].abs() < LARGEST) {
                            cost[l] = f64::INFINITY;
                            (0..n).for_each(|i| z[i][l] = 0.0);
                        }
                    }
                    if cost.iter().all(|c| c.is_infinite()) {
                        return cost;
                    }
                }
            }
            for (i, sum) in squares.iter().enumerate().filter(|(i, _)| self.scale[*i] > 0.0) {
                (0..LANES).for_each(|l| cost[l] += self.scale[i] * sum[l]);
            }
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
            if !initial.is_empty() {
                simulator.set_state(initial);
            }
            for k in 0..segment.steps {
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
