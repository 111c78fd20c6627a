//! Fast evaluation of x+ = Phi x + Gamma u: columns are padded to a fixed length, so that the compiler
//! vectorises them.

use nalgebra::DMatrix;

/// One affine step. States are kept in slices of length [`Kernel::padded`]; the padding stays zero.
#[derive(Debug, Clone)]
pub struct Kernel {
    /// Length of a column.
    n: usize,
    /// Number of columns of Phi; padding has no effect.
    pub(super) states: usize,
    /// Columns one after the other, those of Phi first.
    columns: Vec<f64>,
}

/// A state vector of a kernel: an array where its length is known at compile time, else a vector.
pub trait State: Clone + AsRef<[f64]> + AsMut<[f64]> {
    /// Replaces the state x by Phi x + Gamma u. `u` may be shorter than Gamma is wide: the rest is zero.
    /// `scratch` has the length of the state; its content is arbitrary.
    fn flow(&mut self, kernel: &Kernel, u: &[f64], scratch: &mut Self);

    /// Adds a column of Phi, times `by`.
    fn add(&mut self, kernel: &Kernel, column: usize, by: f64);
}

/// Work vectors of a nonlinear step.
#[derive(Debug, Clone, Default)]
pub struct Work<V> {
    /// Result of a step.
    pub result: V,
    /// Scratch vector for [`State::flow`].
    pub scratch: V,
}

impl<V: State> Work<V> {
    /// Work vectors of the same size as this state.
    #[inline(always)]
    pub fn like(state: &V) -> Self {
        Self { result: state.clone(), scratch: state.clone() }
    }
}

impl<const N: usize> State for [f64; N] {
    #[inline(always)]
    fn flow(&mut self, kernel: &Kernel, u: &[f64], _: &mut Self) {
        *self = kernel.fixed(self, u);
    }

    #[inline(always)]
    fn add(&mut self, kernel: &Kernel, column: usize, by: f64) {
        axpy(self, &kernel.columns.as_chunks::<N>().0[column], by);
    }
}

impl State for Vec<f64> {
    #[inline]
    fn flow(&mut self, kernel: &Kernel, u: &[f64], scratch: &mut Self) {
        kernel.advance(self, u, scratch);
    }

    #[inline]
    fn add(&mut self, kernel: &Kernel, column: usize, by: f64) {
        axpy(self, &kernel.columns[column * kernel.n..][..kernel.n], by);
    }
}

impl Kernel {
    /// Length of the state slices for `n` states.
    pub fn padded(n: usize) -> usize {
        match n {
            0..=4 => 4,
            5..=8 => 8,
            9..=12 => 12,
            13..=16 => 16,
            _ => n,
        }
    }

    /// A kernel of `phi`, n x n, and `gamma`, n x m.
    pub fn new(phi: &DMatrix<f64>, gamma: &DMatrix<f64>) -> Self {
        let n = Self::padded(phi.nrows());
        let states = phi.ncols();
        let mut columns = vec![0.0; n * (states + gamma.ncols())];
        for (to, from) in columns.chunks_exact_mut(n).zip(phi.column_iter().chain(gamma.column_iter())) {
            to.iter_mut().zip(from.iter()).for_each(|(to, from)| *to = *from);
        }
        Self { n, states, columns }
    }

    /// Advances a slice as [`State::flow`].
    #[inline]
    pub fn advance(&self, x: &mut [f64], u: &[f64], scratch: &mut [f64]) {
        match self.n {
            4 => self.advance_fixed::<4>(x, u),
            8 => self.advance_fixed::<8>(x, u),
            12 => self.advance_fixed::<12>(x, u),
            16 => self.advance_fixed::<16>(x, u),
            n => {
                scratch.fill(0.0);
                let values = x.iter().chain(u);
                for (column, &value) in self.columns.chunks_exact(n).zip(values) {
                    if value != 0.0 {
                        axpy(scratch, column, value);
                    }
                }
                x.copy_from_slice(scratch);
            }
        }
    }

    #[inline]
    fn advance_fixed<const N: usize>(&self, x: &mut [f64], u: &[f64]) {
        // Always true: the simulator allocates states by `padded`.
        if let Some(x) = x.first_chunk_mut::<N>() {
            *x = self.fixed(x, u);
        }
    }

    /// Phi x + Gamma u as [`State::flow`], where `others` are columns of Gamma after those of `u`, ascending, and what they are
    /// multiplied with.
    #[inline(always)]
    pub fn fixed_with<const N: usize>(&self, x: &[f64; N], u: &[f64], others: &[(usize, f64)]) -> [f64; N] {
        let mut sum = self.fixed(x, u);
        let gamma = &self.columns.as_chunks::<N>().0[self.states..];
        for (column, value) in others {
            axpy(&mut sum, &gamma[*column], *value);
        }
        sum
    }

    #[inline(always)]
    fn fixed<const N: usize>(&self, x: &[f64; N], u: &[f64]) -> [f64; N] {
        let (phi, gamma) = self.columns.as_chunks::<N>().0.split_at(self.states);
        let mut sum = [0.0; N];
        // Loops, not closures: these would be compiled on their own, without the vector registers of their callers.
        for (column, &value) in phi.iter().zip(x) {
            axpy(&mut sum, column, value);
        }
        for (column, &value) in gamma.iter().zip(u) {
            if value != 0.0 {
                axpy(&mut sum, column, value);
            }
        }
        sum
    }

    /// Entry of Gamma.
    pub fn gamma(&self, row: usize, column: usize) -> f64 {
        self.entry(row, self.states + column)
    }

    /// Entry of Phi, or of Gamma in the columns after it.
    pub fn entry(&self, row: usize, column: usize) -> f64 {
        self.columns[column * self.n + row]
    }

    /// One state of Phi x + Gamma u; `u` as for [`State::flow`].
    #[inline(always)]
    pub fn row(&self, row: usize, x: &[f64], u: &[f64]) -> f64 {
        let (mut of_state, mut of_inputs) = (0.0, 0.0);
        let (phi, gamma) = self.columns.split_at(self.states * self.n);
        for (column, x) in phi.chunks_exact(self.n).zip(x) {
            of_state += column[row] * x;
        }
        for (column, u) in gamma.chunks_exact(self.n).zip(u) {
            of_inputs += column[row] * u;
        }
        of_state + of_inputs
    }

    /// Number of columns of Phi and Gamma.
    pub fn width(&self) -> usize {
        self.columns.len() / self.n
    }
}

#[inline(always)]
fn axpy(sum: &mut [f64], column: &[f64], value: f64) {
    for (s, c) in sum.iter_mut().zip(column) {
        *s += c * value;
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::DVector;

    use super::*;

    #[test]
    fn every_size_multiplies_as_nalgebra_does() {
        for (n, m) in [(1, 1), (3, 2), (4, 2), (8, 2), (8, 10), (13, 3), (16, 1), (17, 4), (40, 9)] {
            let entry = |i: usize, j: usize| ((i * 31 + j * 17 + 7) % 23) as f64 / 23.0 - 0.4;
            let (phi, gamma) = (DMatrix::from_fn(n, n, entry), DMatrix::from_fn(n, m, |i, j| entry(j, i)));
            let x = DVector::from_fn(n, |i, _| entry(i, 3));
            let u = DVector::from_fn(m, |i, _| entry(5, i));
            let expected = &phi * &x + &gamma * &u;
            let kernel = Kernel::new(&phi, &gamma);
            let mut state = vec![0.0; Kernel::padded(n)];
            state[..n].copy_from_slice(x.as_slice());
            let mut scratch = state.clone();
            kernel.advance(&mut state, u.as_slice(), &mut scratch);
            for i in 0..n {
                assert!((state[i] - expected[i]).abs() < 1e-13, "{n} {m}");
            }
            assert!(state[n..].iter().all(|v| *v == 0.0));
            assert_eq!(kernel.gamma(n - 1, m - 1), gamma[(n - 1, m - 1)]);
        }
    }
}
