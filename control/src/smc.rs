//! Sliding surfaces for sampled control.
//!
//! The plant is transformed to regular form by an orthogonal transformation, in which the inputs act on the
//! last m states only; these are the inputs of the other states, and a gain for them defines the surface
//! (Utkin, Sliding Modes in Control and Optimization, 1992; Edwards and Spurgeon, Sliding Mode Control, 1998,
//! chapter 4). The reaching law is Gao, Wang and Homaifa's (IEEE Trans. Ind. Electron. 42, 1995), with a
//! boundary layer.

use nalgebra::DMatrix;
use thiserror::Error;
use whirlstand_linalg::{C64, DecompositionError, orthogonal_completion, singular_values};

use crate::place::{PlaceError, place};
use crate::riccati::{RiccatiError, dare};

/// Method that shapes the motion on the surface.
#[derive(Debug, Clone, PartialEq)]
pub enum Shaping {
    /// Minimum cost of the states, weight n x n, discrete.
    Cost(DMatrix<f64>),
    /// Given poles, n - m of them, discrete.
    Poles(Vec<C64>),
}

/// A sliding surface `s = C x` and the motion on it.
#[derive(Debug, Clone, PartialEq)]
pub struct Surface {
    /// Surface matrix C, m x n, scaled so that `C Gamma = T I`: s is in units of the inputs times s, and the
    /// input acts on it as on an integrator.
    pub c: DMatrix<f64>,
    /// Gain of the equivalent control `u = -K x`, m x n, which keeps s constant: `C (Phi - Gamma K) = C`.
    pub equivalent: DMatrix<f64>,
    /// Poles of the motion on the surface, n - m of them, discrete.
    pub poles: Vec<C64>,
}

/// Reason why there is no surface.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum SurfaceError {
    /// The columns of B are dependent.
    #[error(
        "the {inputs} inputs act in only {rank} independent directions; sliding-mode control needs as many surfaces as \
         inputs, so drop or combine inputs"
    )]
    DependentInputs {
        /// Number of inputs.
        inputs: usize,
        /// Rank of the input matrix.
        rank: usize,
    },
    /// The cost-based surface failed.
    #[error("the surface by least cost: {0}")]
    Cost(#[from] RiccatiError),
    /// The pole-based surface failed.
    #[error("the surface by poles: {0}")]
    Poles(#[from] PlaceError),
    /// The input matrix cannot be decomposed.
    #[error("the directions in which the inputs act cannot be told apart: {0}")]
    Decomposition(#[from] DecompositionError),
}

impl Surface {
    /// A surface for `x+ = phi x + gamma u` (n x n, n x m, m <= n) with period `dt` in s.
    ///
    /// # Errors
    /// [`SurfaceError`] when the inputs are dependent, or the reduced system cannot be shaped as requested.
    pub fn design(
        phi: &DMatrix<f64>,
        gamma: &DMatrix<f64>,
        dt: f64,
        shaping: &Shaping,
    ) -> Result<Self, SurfaceError> {
        let (n, m) = gamma.shape();
        let singular = singular_values(gamma)?;
        let floor = singular.max() * f64::EPSILON * n as f64;
        let rank = singular.iter().filter(|s| **s > floor).count();
        if rank < m {
            return Err(SurfaceError::DependentInputs { inputs: m, rank });
        }
        // Rows of t: first the directions that the inputs do not move, then those that they move.
        let q = orthogonal_completion(gamma);
        let mut t = DMatrix::zeros(n, n);
        t.rows_mut(0, n - m).copy_from(&q.columns(m, n - m).transpose());
        t.rows_mut(n - m, m).copy_from(&q.columns(0, m).transpose());
        let regular = &t * phi * t.transpose();
        let f11 = regular.view((0, 0), (n - m, n - m)).into_owned();
        let f12 = regular.view((0, n - m), (n - m, m)).into_owned();
        let (gain, poles) = if n == m {
            (DMatrix::zeros(m, 0), Vec::new())
        } else {
            match shaping {
                Shaping::Cost(weight) => {
                    let w = &t * weight * t.transpose();
                    let cross = w.view((0, n - m), (n - m, m)).into_owned();
                    let w11 = w.view((0, 0), (n - m, n - m)).into_owned();
                    let w22 = w.view((n - m, n - m), (m, m)).into_owned();
                    let solution = dare(&f11, &f12, &w11, &w22, Some(&cross))?;
                    (solution.gain, solution.poles)
                }
                Shaping::Poles(poles) => {
                    let placed = place(&f11, &f12, poles)?;
                    (placed.gain, placed.poles)
                }
            }
        };
        let mut c = DMatrix::zeros(m, n);
        c.columns_mut(0, n - m).copy_from(&gain);
        c.columns_mut(n - m, m).fill_with_identity();
        let c = c * t;
        let normal = (&c * gamma).lu();
        let c = normal.solve(&c).ok_or(SurfaceError::DependentInputs { inputs: m, rank })? * dt;
        let equivalent = (&c * phi - &c) / dt;
        Ok(Self { c, equivalent, poles })
    }
}
