//! Linear systems with a shifted Hessenberg matrix, in n^2 operations.

use nalgebra::DMatrix;
use whirlstand_linalg::{C64, complex};

/// Solves `(z I - a) x = b` by elimination of the single subdiagonal with row exchanges. `a` is n x n; unless
/// it has Hessenberg form it is reduced first, which costs n^3. `None` at an eigenvalue.
pub fn solve_shifted(a: &DMatrix<f64>, b: &DMatrix<f64>, z: C64) -> Option<DMatrix<C64>> {
    let n = a.nrows();
    if (0..n).any(|j| (j + 2..n).any(|i| a[(i, j)] != 0.0)) {
        let (q, h) = nalgebra::Hessenberg::new(a.clone()).unpack();
        return Some(complex(&q) * solve_shifted(&h, &q.tr_mul(b), z)?);
    }
    // Row by row, so that the elimination accesses contiguous memory.
    let mut rows: Vec<C64> = (0..n * n).map(|k| C64::new(-a[(k / n, k % n)], 0.0)).collect();
    (0..n).for_each(|i| rows[i * n + i] += z);
    let mut x = complex(b);
    for k in 0..n.saturating_sub(1) {
        let (above, below) = rows.split_at_mut((k + 1) * n);
        let (pivot, next) = (&mut above[k * n + k..], &mut below[k..n]);
        if next[0].norm_sqr() > pivot[0].norm_sqr() {
            pivot.swap_with_slice(next);
            x.swap_rows(k, k + 1);
        }
        if next[0] == C64::new(0.0, 0.0) {
            continue;
        }
        let factor = next[0] / pivot[0];
        next.iter_mut().zip(pivot.iter()).for_each(|(v, p)| *v -= factor * p);
        for j in 0..x.ncols() {
            let eliminated = factor * x[(k, j)];
            x[(k + 1, j)] -= eliminated;
        }
    }
    for k in (0..n).rev() {
        let pivot = rows[k * n + k];
        if pivot == C64::new(0.0, 0.0) {
            return None;
        }
        for j in 0..x.ncols() {
            let known: C64 = (k + 1..n).map(|i| rows[k * n + i] * x[(i, j)]).sum();
            x[(k, j)] = (x[(k, j)] - known) / pivot;
        }
    }
    Some(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_solves_what_a_full_elimination_solves() {
        for n in [1, 2, 7, 30] {
            let entry = |i: usize, j: usize| ((i * 37 + j * 17 + 5) % 29) as f64 / 29.0 - 0.5;
            let (a, b) = (DMatrix::from_fn(n, n, entry), DMatrix::from_fn(n, 2, |i, j| entry(j, i)));
            let z = C64::from_polar(1.0, 0.3);
            let mut shifted = -complex(&a);
            (0..n).for_each(|i| shifted[(i, i)] += z);
            let x = solve_shifted(&a, &b, z).unwrap();
            assert!((shifted * x - complex(&b)).norm() < 1e-10, "{n}");
        }
    }
}
