//! Propagation of the covariance over many steps at once.
//!
//! Over any number of steps with given measurements, an optimal filter maps its covariance P to `H + A P (I +
//! G P)^-1 A'`. The composition of such maps has the same form, so a map over 2 k steps follows from one over
//! k: the doubling algorithm (Anderson and Moore, Optimal Filtering, 1979, section 6.7; Chu, Fan, Lin and
//! Wang, Int. J. Control 77, 2004). It is exact for any P, not only in the limit. After construction no
//! operation allocates.

use nalgebra::DMatrix;

use super::filter_model::FilterModel;
use crate::kernel::Packed;

/// One covariance map `P -> H + A P (I + G P)^-1 A'`.
#[derive(Debug, Clone)]
struct Map {
    a: Packed,
    g: Packed,
    h: Packed,
}

impl Map {
    fn identity(n: usize) -> Self {
        let zero = Packed::zeros(n, n);
        Self { a: Packed::new(&DMatrix::identity(n, n)), g: zero.clone(), h: zero }
    }

    fn copy_from(&mut self, other: &Self) {
        self.a.copy_from(&other.a);
        self.g.copy_from(&other.g);
        self.h.copy_from(&other.h);
    }
}

/// The map over a pattern of measurements, or over many repetitions of it.
#[derive(Debug, Clone)]
pub struct Flow {
    n: usize,
    f: Packed,
    q: Packed,
    /// Information matrix h' h / r of each output.
    information: Vec<Packed>,
    whole: Map,
    step: Map,
    next: Map,
    left: Packed,
    right: Packed,
    elimination: Elimination,
}

impl Flow {
    /// Prepares the identity map for a model.
    pub fn new(model: &FilterModel) -> Self {
        let n = model.f.nrows();
        let information = (0..model.h.nrows())
            .map(|i| Packed::new(&(model.h.row(i).transpose() * model.h.row(i) / model.variance[i])))
            .collect();
        let (map, zero) = (Map::identity(n), Packed::zeros(n, n));
        Self {
            n,
            f: Packed::new(&model.f),
            q: Packed::new(&model.q),
            information,
            whole: map.clone(),
            step: map.clone(),
            next: map,
            left: zero.clone(),
            right: zero,
            elimination: Elimination::new(n),
        }
    }

    /// Resets to the identity map.
    pub fn clear(&mut self) {
        self.whole.a.clear();
        self.whole.g.clear();
        self.whole.h.clear();
        (0..self.n).for_each(|i| self.whole.a.set(i, i, 1.0));
    }

    /// Appends one step to the map: prediction, then the measurements of `mask`.
    pub fn append(&mut self, mask: u64) {
        let n = self.n;
        // Prediction is the map (F, 0, Q), measurement (I, Y, 0); their composition has A = (I + Q Y)^-1 F,
        // H = (I + Q Y)^-1 Q and G = F' Y A.
        let y = &mut self.next.g;
        y.clear();
        for (i, own) in self.information.iter().enumerate() {
            if mask >> i & 1 == 1 {
                (0..n).for_each(|j| crate::kernel::add_scaled(y.column_mut(j), own.column(j), 1.0));
            }
        }
        self.left.clear();
        self.left.add_product(&self.q, y, n);
        self.elimination.solve(&self.left, [&self.f, &self.q], [&mut self.step.a, &mut self.step.h]);
        self.left.clear();
        self.left.add_product(y, &self.step.a, n);
        self.right.transpose_from(&self.f, n);
        self.step.g.clear();
        self.step.g.add_product(&self.right, &self.left, n);
        self.compose();
    }

    /// Doubles the number of steps of the map.
    pub fn double(&mut self) {
        self.step.copy_from(&self.whole);
        self.compose();
    }

    /// Composes `whole` followed by `step`: with M = I + H1 G2, A = A2 M^-1 A1, H = H2 + A2 M^-1 H1 A2' and G
    /// = G1 + A1' G2 M^-1 A1.
    fn compose(&mut self) {
        let n = self.n;
        let Self { whole, step, next, left, right, elimination, .. } = self;
        right.transpose_from(&step.a, n);
        left.clear();
        left.add_product(&whole.h, right, n);
        right.clear();
        right.add_product(&whole.h, &step.g, n);
        elimination.solve(right, [&whole.a, left], [&mut next.a, &mut next.h]);
        // next.a and next.h hold M^-1 A1 and M^-1 H1 A2'.
        left.clear();
        left.add_product(&step.g, &next.a, n);
        right.transpose_from(&whole.a, n);
        next.g.copy_from(&whole.g);
        next.g.add_product(right, left, n);
        whole.g.copy_from(&next.g);
        whole.a.clear();
        whole.a.add_product(&step.a, &next.a, n);
        whole.h.copy_from(&step.h);
        whole.h.add_product(&step.a, &next.h, n);
        whole.g.symmetrise(n);
        whole.h.symmetrise(n);
    }

    /// What the map makes of a covariance of zero.
    pub fn covariance(&self) -> &Packed {
        &self.whole.h
    }

    /// Applies the map to the covariance P.
    pub fn apply(&mut self, p: &mut Packed) {
        let n = self.n;
        let Self { whole, next, left, right, elimination, .. } = self;
        left.clear();
        left.add_product(p, &whole.g, n);
        // (I + P G)^-1 P is P (I + G P)^-1.
        elimination.solve(left, [p, p], [&mut next.a, &mut next.h]);
        right.transpose_from(&whole.a, n);
        left.clear();
        left.add_product(&next.a, right, n);
        p.copy_from(&whole.h);
        p.add_product(&whole.a, left, n);
        p.symmetrise(n);
    }
}

/// Gaussian elimination with partial pivoting in preallocated memory.
#[derive(Debug, Clone)]
struct Elimination {
    n: usize,
    /// Rows of `[I + M, B1, B2]`.
    rows: Vec<f64>,
}

impl Elimination {
    fn new(n: usize) -> Self {
        Self { n, rows: vec![0.0; 3 * n * n] }
    }

    /// Solves `(I + m) x = b` for two right-hand sides, n x n each. I + m is never singular here: m is a
    /// product of two positive semidefinite matrices, so its eigenvalues are not negative.
    fn solve(&mut self, m: &Packed, b: [&Packed; 2], x: [&mut Packed; 2]) {
        let n = self.n;
        let width = 3 * n;
        for (i, row) in self.rows.chunks_exact_mut(width).enumerate() {
            for j in 0..n {
                row[j] = m.entry(i, j) + if i == j { 1.0 } else { 0.0 };
                row[n + j] = b[0].entry(i, j);
                row[2 * n + j] = b[1].entry(i, j);
            }
        }
        for k in 0..n {
            let size = |rows: &[f64], i: usize| rows[i * width + k].abs();
            let pivot =
                (k..n).fold(k, |best, i| if size(&self.rows, i) > size(&self.rows, best) { i } else { best });
            if pivot != k {
                for j in k..width {
                    self.rows.swap(k * width + j, pivot * width + j);
                }
            }
            let (above, below) = self.rows.split_at_mut((k + 1) * width);
            let own = &mut above[k * width..];
            let inverse = 1.0 / own[k];
            own[k..].iter_mut().for_each(|v| *v *= inverse);
            for row in below.chunks_exact_mut(width) {
                let factor = row[k];
                if factor != 0.0 {
                    row[k..].iter_mut().zip(&own[k..]).for_each(|(r, o)| *r -= factor * o);
                }
            }
        }
        for k in (0..n).rev() {
            let (above, below) = self.rows.split_at_mut(k * width);
            let own = &below[n..width];
            for row in above.chunks_exact_mut(width) {
                let factor = row[k];
                row[n..].iter_mut().zip(own).for_each(|(r, o)| *r -= factor * o);
            }
        }
        let [first, second] = x;
        for (i, row) in self.rows.chunks_exact(width).enumerate() {
            for j in 0..n {
                first.set(i, j, row[n + j]);
                second.set(i, j, row[2 * n + j]);
            }
        }
    }
}
