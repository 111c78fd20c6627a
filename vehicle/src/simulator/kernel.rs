//! x+ = Phi x + Gamma u, fast: columns padded to a fixed length, so that the compiler vectorises them.

use nalgebra::DMatrix;

/// One affine step. States are kept in slices of length [`Kernel::padded`]; the padding stays zero.
#[derive(Debug, Clone)]
pub enum Kernel {
    Small(Box<Fixed<4>>),
    Medium(Box<Fixed<8>>),
    Large(Box<Fixed<16>>),
    Any(Dynamic),
}

#[derive(Debug, Clone)]
pub struct Fixed<const N: usize> {
    phi: [[f64; N]; N],
    gamma: Vec<[f64; N]>,
}

#[derive(Debug, Clone)]
pub struct Dynamic {
    n: usize,
    /// Columns one after the other, those of Phi first.
    columns: Vec<f64>,
}

impl Kernel {
    /// Length of the state slices for `n` states.
    pub fn padded(n: usize) -> usize {
        match n {
            0..=4 => 4,
            5..=8 => 8,
            9..=16 => 16,
            _ => n,
        }
    }

    /// `phi` is n x n, `gamma` n x m.
    pub fn new(phi: &DMatrix<f64>, gamma: &DMatrix<f64>) -> Self {
        match Self::padded(phi.nrows()) {
            4 => Self::Small(Box::new(Fixed::new(phi, gamma))),
            8 => Self::Medium(Box::new(Fixed::new(phi, gamma))),
            16 => Self::Large(Box::new(Fixed::new(phi, gamma))),
            n => {
                let columns = phi.iter().chain(gamma.iter()).copied().collect();
                Self::Any(Dynamic { n, columns })
            }
        }
    }

    /// Replaces x by Phi x + Gamma u. `u` may be shorter than Gamma is wide: the rest is zero.
    /// `scratch` is as long as `x`; its content does not matter.
    #[inline]
    pub fn advance(&self, x: &mut [f64], u: &[f64], scratch: &mut [f64]) {
        match self {
            Self::Small(k) => k.advance(x, u),
            Self::Medium(k) => k.advance(x, u),
            Self::Large(k) => k.advance(x, u),
            Self::Any(k) => k.advance(x, u, scratch),
        }
    }

    /// Entry of Gamma.
    pub fn gamma(&self, row: usize, column: usize) -> f64 {
        match self {
            Self::Small(k) => k.gamma[column][row],
            Self::Medium(k) => k.gamma[column][row],
            Self::Large(k) => k.gamma[column][row],
            Self::Any(k) => k.columns[(k.n + column) * k.n + row],
        }
    }
}

impl<const N: usize> Fixed<N> {
    fn new(phi: &DMatrix<f64>, gamma: &DMatrix<f64>) -> Self {
        let column = |m: &DMatrix<f64>, j: usize| {
            std::array::from_fn(|i| if i < m.nrows() && j < m.ncols() { m[(i, j)] } else { 0.0 })
        };
        Self {
            phi: std::array::from_fn(|j| column(phi, j)),
            gamma: (0..gamma.ncols()).map(|j| column(gamma, j)).collect(),
        }
    }

    #[inline]
    fn advance(&self, x: &mut [f64], u: &[f64]) {
        // Always true: the simulator allocates states by `padded`.
        let Some(x) = x.first_chunk_mut::<N>() else { return };
        let mut sum = [0.0; N];
        for (column, &value) in self.phi.iter().zip(x.iter()) {
            axpy(&mut sum, column, value);
        }
        for (column, &value) in self.gamma.iter().zip(u) {
            if value != 0.0 {
                axpy(&mut sum, column, value);
            }
        }
        *x = sum;
    }
}

#[inline]
fn axpy<const N: usize>(sum: &mut [f64; N], column: &[f64; N], value: f64) {
    for (s, c) in sum.iter_mut().zip(column) {
        *s += c * value;
    }
}

impl Dynamic {
    fn advance(&self, x: &mut [f64], u: &[f64], scratch: &mut [f64]) {
        scratch.fill(0.0);
        let values = x.iter().chain(u);
        for (column, &value) in self.columns.chunks_exact(self.n).zip(values) {
            if value != 0.0 {
                for (s, c) in scratch.iter_mut().zip(column) {
                    *s += c * value;
                }
            }
        }
        x.copy_from_slice(scratch);
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
