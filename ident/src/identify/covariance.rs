//! The covariance recursion of a Kalman filter, run to its periodic steady state.

use nalgebra::DMatrix;

/// Largest number of steps until a filter is taken as settled.
const MOST_STEPS: usize = 4000;

/// Covariance recursion of a linear model with white noises.
pub struct CovarianceRecursion {
    n: usize,
    /// Transition matrix, n x n, row after row.
    phi: Vec<f64>,
    /// Variance of the process noise per step, one per state.
    pub driving: Vec<f64>,
    /// Fresh outputs of every phase, each with its row of C and its noise variance.
    measurements: Vec<Vec<(Vec<f64>, f64)>>,
    /// Covariance of the state before the first phase, n x n, row after row.
    pub covariance: Vec<f64>,
    scratch: Vec<f64>,
}

impl CovarianceRecursion {
    /// A recursion with the initial covariance `covariance`, n x n, row after row.
    pub fn new(
        phi: &DMatrix<f64>,
        driving: Vec<f64>,
        measurements: Vec<Vec<(Vec<f64>, f64)>>,
        covariance: Vec<f64>,
    ) -> Self {
        let n = phi.nrows();
        Self {
            n,
            phi: (0..n * n).map(|at| phi[(at / n, at % n)]).collect(),
            driving,
            measurements,
            covariance,
            scratch: vec![0.0; n * n],
        }
    }

    /// Iterates until all phases together change no variance by more than `tolerance`, relative, or for
    /// `MOST_STEPS` steps. `None` when the covariance does not stay finite.
    pub fn settle(&mut self, tolerance: f64) -> Option<()> {
        let n = self.n;
        let mut steps = 0;
        loop {
            let before = self.covariance.clone();
            self.pass();
            steps += self.measurements.len();
            let now = &self.covariance;
            if !now.iter().all(|v| v.is_finite()) {
                return None;
            }
            let change = (0..n)
                .map(|i| (now[i * n + i] - before[i * n + i]).abs() / now[i * n + i].abs().max(1e-300))
                .fold(0.0, f64::max);
            if change < tolerance || steps >= MOST_STEPS {
                return Some(());
            }
        }
    }

    /// Passes through all phases once. Independent measurements are processed one after the other, which
    /// equals processing all at once and needs no factorisation.
    fn pass(&mut self) {
        let n = self.n;
        for measurements in &self.measurements {
            let p = &mut self.covariance;
            for (c, variance) in measurements {
                let pc = &mut self.scratch[..n];
                pc.fill(0.0);
                for (j, c) in c.iter().enumerate().filter(|(_, c)| **c != 0.0) {
                    (0..n).for_each(|i| pc[i] += c * p[i * n + j]);
                }
                let s: f64 = variance + c.iter().zip(&*pc).map(|(c, v)| c * v).sum::<f64>();
                for i in 0..n {
                    let f = pc[i] / s;
                    (0..n).for_each(|j| p[i * n + j] -= f * pc[j]);
                }
            }
            propagate(&self.phi, p, &mut self.scratch, n);
            (0..n).for_each(|i| p[i * n + i] += self.driving[i]);
        }
    }
}

/// P becomes phi P phi', made symmetric.
fn propagate(phi: &[f64], p: &mut [f64], scratch: &mut [f64], n: usize) {
    for i in 0..n {
        let row = &mut scratch[i * n..(i + 1) * n];
        row.fill(0.0);
        for (k, f) in phi[i * n..(i + 1) * n].iter().enumerate() {
            row.iter_mut().zip(&p[k * n..(k + 1) * n]).for_each(|(r, p)| *r += f * p);
        }
    }
    for i in 0..n {
        for j in 0..=i {
            let v: f64 =
                scratch[i * n..(i + 1) * n].iter().zip(&phi[j * n..(j + 1) * n]).map(|(a, b)| a * b).sum();
            p[i * n + j] = v;
            p[j * n + i] = v;
        }
    }
}
