//! Linear algebra: decompositions of dense matrices, each with a limit on its iterations and an error when it
//! fails, the equations that are solved with them, and Fourier transforms.
//!
//! nalgebra's own `svd`, `symmetric_eigen` and `complex_eigenvalues` iterate until they converge, and there are
//! matrices, a permutation among them, for which they never do. No other room calls them (`clippy.toml`). The
//! matrix exponential belongs to the vehicle's room.

mod balance;
mod eigen;
mod error;
pub mod fft;
mod lyapunov;
mod qz;
mod scale;
mod svd;
mod symmetric;

pub use balance::{balance, balancing_exponents};
pub use eigen::{Schur, eigenvalues, spectral_abscissa, spectral_radius};
pub use error::DecompositionError;
pub use lyapunov::{solve_lyapunov, solve_stein};
pub use qz::GeneralizedSchur;
pub use svd::{Svd, pseudo_inverse, singular_values};
pub use symmetric::symmetric_eigen;

use nalgebra::{Complex, DMatrix};

/// A complex number in double precision.
pub type C64 = Complex<f64>;

/// The complex copy of a real matrix.
pub fn complex(a: &DMatrix<f64>) -> DMatrix<C64> {
    a.map(|v| C64::new(v, 0.0))
}

/// The symmetric part, `(a + a') / 2`.
pub fn symmetric_part(a: &DMatrix<f64>) -> DMatrix<f64> {
    (a + a.transpose()) * 0.5
}

/// A square orthogonal matrix (n x n) whose first m columns span those of `a` (n x m, m <= n), by Householder
/// reflections; nalgebra's QR gives the thin factor only.
pub fn orthogonal_completion(a: &DMatrix<f64>) -> DMatrix<f64> {
    let (n, m) = a.shape();
    let mut work = a.clone();
    let mut q = DMatrix::<f64>::identity(n, n);
    for k in 0..m {
        let mut v = work.column(k).into_owned();
        for i in 0..k {
            v[i] = 0.0;
        }
        let norm = v.norm();
        if norm == 0.0 {
            continue;
        }
        v[k] += if v[k] >= 0.0 { norm } else { -norm };
        let beta = 2.0 / v.norm_squared();
        let w = work.tr_mul(&v) * beta;
        work -= &v * w.transpose();
        let w = &q * &v * beta;
        q -= w * v.transpose();
    }
    q
}
