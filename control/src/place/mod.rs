//! Robust pole placement for several inputs.
//!
//! With more than one input the poles leave freedom in the eigenvectors; it is used to make them as nearly
//! orthogonal as possible, by raising the determinant of their matrix: Kautsky, Nichols and Van Dooren (Int.
//! J. Control 41, 1985, method 0), with the globally convergent rank-2 updates of Tits and Yang (IEEE Trans.
//! Autom. Control 41, 1996), which move two eigenvectors at once, a pair of real ones or a complex one and
//! its conjugate.

mod eigenvectors;

use nalgebra::DMatrix;
use thiserror::Error;
use whirlstand_linalg::{C64, DecompositionError, Svd, complex, eigenvalues, singular_values};

use self::eigenvectors::{Eigenvectors, null_space};

/// Number of start directions for the choice of eigenvectors.
const STARTS: usize = 16;

/// Relative difference below which two condition numbers are equal: so small a difference does not reduce a
/// pole's sensitivity. Of results with equal condition the one with the smallest gain is chosen, because of
/// the inputs' limits.
const SAME_CONDITION: f64 = 0.01;

/// Result of a pole placement.
#[derive(Debug, Clone, PartialEq)]
pub struct Placement {
    /// The gain K, m x n, of `u = -K x`.
    pub gain: DMatrix<f64>,
    /// Eigenvalues of `A - B K` as computed.
    pub poles: Vec<C64>,
    /// Condition number of the matrix of unit eigenvectors: the sensitivity of the poles to changes of the
    /// plant.
    pub condition: f64,
    /// Number of sweeps over the eigenvectors.
    pub sweeps: usize,
}

/// Reason why poles cannot be placed.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PlaceError {
    /// The number of poles is wrong.
    #[error("{got} poles are asked for, but the plant has {wanted} states; give one pole per state")]
    Count {
        /// Number of poles given.
        got: usize,
        /// Number of states.
        wanted: usize,
    },
    /// The matrices have incompatible shapes, or contain NaN.
    #[error("A has to be n x n and B n x m with n, m > 0, all finite; they are {a:?} and {b:?}")]
    Matrices {
        /// Shape of A.
        a: (usize, usize),
        /// Shape of B.
        b: (usize, usize),
    },
    /// A pole has no conjugate, or is NaN.
    #[error("the pole {pole} comes without its complex conjugate, or is not finite; a real gain needs both")]
    NotConjugate {
        /// The pole.
        pole: C64,
    },
    /// A pole is repeated more often than B has rank.
    #[error(
        "the pole {pole} is asked for {times} times, but B has rank {rank}; a pole can be repeated at most that often, so \
         move the copies apart"
    )]
    Multiplicity {
        /// The pole.
        pole: C64,
        /// Number of repetitions.
        times: usize,
        /// Rank of B.
        rank: usize,
    },
    /// A mode is uncontrollable.
    #[error(
        "the mode {mode} is not controllable, so it stays where it is; ask for it among the poles, or give the plant an \
         input that moves it"
    )]
    Uncontrollable {
        /// The uncontrollable mode.
        mode: C64,
    },
    /// The eigenvectors are dependent.
    #[error("no independent set of eigenvectors was found for these poles; move them apart")]
    Defective,
    /// The eigenvalue iteration failed.
    #[error(transparent)]
    Eigenvalues(#[from] DecompositionError),
}

/// Gain K (m x n) such that `A - B K` has the given eigenvalues, with the lowest sensitivity that the inputs
/// allow.
///
/// A is n x n, B n x m; `poles` are n complex numbers closed under conjugation, none repeated more often than
/// the rank of B. They are eigenvalues of the matrix as it stands: 1/s for a continuous A, inside the unit circle
/// for a discrete one. Uncontrollable modes have to be among them.
///
/// Method and sources: see the [module](self).
///
/// # Errors
/// [`PlaceError`], which names the pole or mode that prevents the placement.
///
/// ```
/// use nalgebra::{Complex, dmatrix};
/// use whirlstand_control::place::place;
///
/// let (a, b) = (dmatrix![0.0, 1.0; 100.0, 0.0], dmatrix![0.0; 1.0]);
/// let poles = [Complex::new(-20.0, 10.0), Complex::new(-20.0, -10.0)];
/// let placed = place(&a, &b, &poles).unwrap();
/// assert!((placed.gain - dmatrix![600.0, 40.0]).norm() < 1e-9);
/// ```
pub fn place(a: &DMatrix<f64>, b: &DMatrix<f64>, poles: &[C64]) -> Result<Placement, PlaceError> {
    let (n, m) = b.shape();
    if a.shape() != (n, n) || n == 0 || m == 0 || a.iter().chain(b.iter()).any(|v| !v.is_finite()) {
        return Err(PlaceError::Matrices { a: a.shape(), b: b.shape() });
    }
    if poles.len() != n {
        return Err(PlaceError::Count { got: poles.len(), wanted: n });
    }
    let poles = conjugates_paired(poles)?;
    let svd = Svd::new(b)?;
    let sigma = &svd.values;
    let rank = svd.rank(sigma.max() * f64::EPSILON * n.max(m) as f64);
    check_multiplicity(&poles, rank)?;
    let poles = with_uncontrollable_modes(a, b, poles)?;
    if rank == 0 {
        return Err(PlaceError::Uncontrollable { mode: eigenvalues(a)?[0] });
    }
    // Singular values come sorted, so the first `rank` columns span the range of B.
    let range = svd.u.columns(0, rank).into_owned();
    let annihilator = null_space(&range.transpose(), n - rank)?;
    let mut vectors = Eigenvectors::new(a, &annihilator, &poles)?;
    let free = vectors.are_free();
    let lambda = real_modal(&poles);
    let weights = DMatrix::from_fn(m, rank, |i, j| svd.v_t[(j, i)] / sigma[j]);
    let gain_of = |x: &DMatrix<f64>| {
        // A_c X = X Lambda, solved transposed.
        let closed = x.transpose().lu().solve(&(x * &lambda).transpose())?.transpose();
        let gain = &weights * range.transpose() * (a - closed);
        gain.iter().all(|v| v.is_finite()).then_some(gain)
    };
    // The determinant has local maxima, and is often flat at the best of them: several start directions
    // handle both.
    let starts = if free && rank < n { STARTS } else { 1 };
    let mut found: Vec<(f64, DMatrix<f64>)> = Vec::new();
    let mut sweeps = 0;
    for start in 0..starts {
        vectors.start(start);
        sweeps += vectors.improve(if free { 200 } else { 0 })?;
        let condition = vectors.condition()?;
        found.extend(gain_of(vectors.matrix()).map(|gain| (condition, gain)));
    }
    let least = found.iter().map(|(condition, _)| *condition).fold(f64::INFINITY, f64::min);
    let as_good = found.into_iter().filter(|(condition, _)| *condition <= least * (1.0 + SAME_CONDITION));
    let (condition, gain) =
        as_good.min_by(|a, b| a.1.norm().total_cmp(&b.1.norm())).ok_or(PlaceError::Defective)?;
    let placed = eigenvalues(&(a - b * &gain))?;
    Ok(Placement { gain, poles: placed, condition, sweeps })
}

/// Sorts the poles: real ones, then pairs with the positive imaginary part first; pairs are made exactly
/// conjugate.
fn conjugates_paired(poles: &[C64]) -> Result<Vec<C64>, PlaceError> {
    if let Some(p) = poles.iter().find(|p| !p.re.is_finite() || !p.im.is_finite()) {
        return Err(PlaceError::NotConjugate { pole: *p });
    }
    let mut reals: Vec<C64> = poles.iter().copied().filter(|p| p.im == 0.0).collect();
    reals.sort_by(|x, y| x.re.total_cmp(&y.re));
    let upper: Vec<C64> = poles.iter().copied().filter(|p| p.im > 0.0).collect();
    let mut lower: Vec<C64> = poles.iter().copied().filter(|p| p.im < 0.0).collect();
    for p in upper {
        let tolerance = 1e-9 * p.norm();
        let Some(at) = lower.iter().position(|q| (q.conj() - p).norm() <= tolerance) else {
            return Err(PlaceError::NotConjugate { pole: p });
        };
        lower.swap_remove(at);
        reals.extend([p, p.conj()]);
    }
    match lower.first() {
        Some(p) => Err(PlaceError::NotConjugate { pole: *p }),
        None => Ok(reals),
    }
}

fn check_multiplicity(poles: &[C64], rank: usize) -> Result<(), PlaceError> {
    for p in poles {
        let times = poles.iter().filter(|q| (*q - p).norm() <= 1e-12 * p.norm()).count();
        if times > rank && rank > 0 {
            return Err(PlaceError::Multiplicity { pole: *p, times, rank });
        }
    }
    Ok(())
}

/// The poles with those of uncontrollable modes (Popov-Belevitch-Hautus test at every eigenvalue of A)
/// replaced by the exact values of these modes: they are independent of the gain, and a gain for a rounding
/// difference would be rounding divided by rounding.
fn with_uncontrollable_modes(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    mut poles: Vec<C64>,
) -> Result<Vec<C64>, PlaceError> {
    for (mode, distance) in uncontrollability(a, b)? {
        if distance > 1e-13 {
            continue;
        }
        let near = 1e-6 * mode.norm().max(1e-3 * a.norm());
        let away = |pole: &C64| (pole - mode).norm();
        let nearest = poles.iter_mut().min_by(|p, q| away(p).total_cmp(&away(q)));
        match nearest.filter(|pole| away(pole) <= near) {
            Some(pole) => *pole = mode,
            None => return Err(PlaceError::Uncontrollable { mode }),
        }
    }
    conjugates_paired(&poles)
}

/// For each eigenvalue of A, the smallest singular value of `[A - lambda I, B]` over the norm of `[A, B]`
/// with the columns of B scaled alike: the distance of the mode from being uncontrollable.
///
/// # Errors
/// [`DecompositionError`] when the eigenvalues of A do not converge.
pub fn uncontrollability(a: &DMatrix<f64>, b: &DMatrix<f64>) -> Result<Vec<(C64, f64)>, DecompositionError> {
    let (n, m) = b.shape();
    let norm_a = a.norm();
    let scale = if b.norm() > 0.0 && norm_a > 0.0 { norm_a / b.norm() } else { 1.0 };
    let mut pencil = DMatrix::<C64>::zeros(n, n + m);
    pencil.view_mut((0, 0), (n, n)).copy_from(&complex(a));
    pencil.view_mut((0, n), (n, m)).copy_from(&complex(&(b * scale)));
    let norm = pencil.norm().max(f64::MIN_POSITIVE);
    let distance = |mode: C64| {
        let mut shifted = pencil.clone();
        (0..n).for_each(|i| shifted[(i, i)] -= mode);
        Ok((mode, singular_values(&shifted.adjoint())?.min() / norm))
    };
    eigenvalues(a)?.into_iter().map(distance).collect()
}

/// Block-diagonal real form of the poles: 1 x 1 for real ones, `[[re, im], [-im, re]]` for pairs.
fn real_modal(poles: &[C64]) -> DMatrix<f64> {
    let n = poles.len();
    let mut lambda = DMatrix::zeros(n, n);
    let mut j = 0;
    while j < n {
        lambda[(j, j)] = poles[j].re;
        if poles[j].im != 0.0 {
            lambda[(j + 1, j + 1)] = poles[j].re;
            lambda[(j, j + 1)] = poles[j].im;
            lambda[(j + 1, j)] = -poles[j].im;
            j += 1;
        }
        j += 1;
    }
    lambda
}
