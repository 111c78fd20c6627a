//! Discretisation over one sample period by a short step that is doubled repeatedly: accurate for slow and
//! fast modes at once.
//!
//! The short step is computed by power series without cancellation; doubling adds the contribution of the
//! first half, propagated over the second, to that of the second. exp(-A t), which overflows for a mode that
//! decays within the period, does not occur. The doubled quantity is exp(A t) - I, which keeps the digits of
//! slow modes.

use nalgebra::DMatrix;
use whirlstand_linalg::balancing_exponents;

/// Largest 1-norm of A times the short step.
const SHORT: f64 = 0.5;

/// Number of terms of the transition's series; the next is 4e-17 of the first at [`SHORT`].
const TRANSITION_TERMS: u32 = 13;

/// Number of terms of the Gramian's series, whose operator has twice the norm.
const GRAMIAN_TERMS: u32 = 17;

/// exp(A t), n x n, and the integral of exp(A t) B, n x m, over one length.
pub type Transition = (DMatrix<f64>, DMatrix<f64>);

/// A model over a step, in units in which the rows and columns of A have similar magnitudes.
pub struct Balanced {
    /// A over the short step, n x n.
    x: DMatrix<f64>,
    /// The short step, s.
    short_s: f64,
    doublings: u32,
    units: Vec<f64>,
}

impl Balanced {
    /// Prepares `a`, n x n, over `length_s`; the 1-norm of their product must be finite.
    pub fn new(a: &DMatrix<f64>, length_s: f64) -> Self {
        Self::with_halves(a, length_s, 0)
    }

    /// The same with a short step that is at most the length halved this many times.
    pub fn with_halves(a: &DMatrix<f64>, length_s: f64, halvings: u32) -> Self {
        let units: Vec<f64> = balancing_exponents(a).iter().map(|e| f64::powi(2.0, *e)).collect();
        let x = DMatrix::from_fn(a.nrows(), a.ncols(), |i, j| a[(i, j)] * length_s * (units[j] / units[i]));
        let norm = x.column_iter().map(|c| c.lp_norm(1)).fold(0.0, f64::max);
        let doublings = ((norm / SHORT).log2().ceil().max(0.0) as u32).max(halvings);
        let share = f64::powi(0.5, doublings as i32);
        Self { x: x * share, short_s: length_s * share, doublings, units }
    }

    /// The mean of exp(A t) over the short step: I + X/2! + X^2/3! + ...
    fn mean_transition(&self) -> DMatrix<f64> {
        let mut sum = DMatrix::identity(self.x.nrows(), self.x.ncols());
        let mut next = sum.clone();
        for k in (1..=TRANSITION_TERMS).rev() {
            next.gemm(1.0 / f64::from(k + 1), &self.x, &sum, 0.0);
            (0..next.nrows()).for_each(|i| next[(i, i)] += 1.0);
            std::mem::swap(&mut sum, &mut next);
        }
        sum
    }

    /// exp(A t) at the end, n x n, and the integral of exp(A t) B, n x m for `b` of that size.
    pub fn transition_and_input(&self, b: &DMatrix<f64>) -> Transition {
        self.transitions_and_inputs(b, 1).swap_remove(0)
    }

    /// The same over the whole length, its half, its quarter and so on: `count` of them, at least one and none shorter than the
    /// short step.
    pub fn transitions_and_inputs(&self, b: &DMatrix<f64>, count: u32) -> Vec<Transition> {
        let n = self.x.nrows();
        let in_units = |moved: &DMatrix<f64>, gamma: &DMatrix<f64>| {
            let phi = DMatrix::from_fn(n, n, |i, j| {
                f64::from(u8::from(i == j)) + moved[(i, j)] * (self.units[i] / self.units[j])
            });
            (phi, DMatrix::from_fn(n, b.ncols(), |i, j| gamma[(i, j)] * self.units[i]))
        };
        let mean = self.mean_transition();
        let mut moved = &self.x * &mean;
        let mut gamma =
            mean * DMatrix::from_fn(b.nrows(), b.ncols(), |i, j| b[(i, j)] / self.units[i]) * self.short_s;
        let mut all = Vec::new();
        for left in (0..=self.doublings).rev() {
            if left < count {
                all.push(in_units(&moved, &gamma));
            }
            if left > 0 {
                gamma = &gamma * 2.0 + &moved * &gamma;
                moved = &moved * 2.0 + &moved * &moved;
            }
        }
        all.reverse();
        all
    }

    /// The integral of exp(A t) W exp(A' t), n x n and symmetric, for `w` of that size.
    pub fn gramian(&self, w: &DMatrix<f64>) -> DMatrix<f64> {
        let units = |i: usize, j: usize| self.units[i] * self.units[j];
        let n = w.nrows();
        let w = DMatrix::from_fn(n, n, |i, j| w[(i, j)] * self.short_s / units(i, j));
        // W + L(W)/2! + L^2(W)/3! + ... with L(W) = X W + W X'.
        let mut sum = w.clone();
        for k in (1..=GRAMIAN_TERMS).rev() {
            let half = &self.x * sum;
            sum = &w + (&half + half.transpose()) / f64::from(k + 1);
        }
        let mut moved = &self.x * self.mean_transition();
        for _ in 0..self.doublings {
            let carried = &sum + &moved * &sum;
            sum += &carried + &carried * moved.transpose();
            sum = (&sum + sum.transpose()) * 0.5;
            moved = &moved * 2.0 + &moved * &moved;
        }
        DMatrix::from_fn(n, n, |i, j| sum[(i, j)] * units(i, j))
    }
}
