//! Exact zero-order-hold discretisation by the matrix exponential.

use nalgebra::DMatrix;

/// Why a matrix exponential cannot be given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum DiscretiseError {
    /// An entry of a matrix, or of the result, is not finite.
    #[error("the matrix exponential over one period is not finite")]
    NotFinite,
    /// The matrices do not fit each other.
    #[error("A must be square and B must have as many rows")]
    Shape,
}

/// Transition and input matrix of dx/dt = A x + B u over `period_s` with u held: x+ = Phi x + Gamma u.
///
/// Both come from one exponential of [A B; 0 0] (Van Loan, "Computing integrals involving the matrix
/// exponential", IEEE TAC 23, 1978), so A may be singular.
///
/// # Errors
/// [`DiscretiseError::Shape`] unless `a` is n x n and `b` n x m; [`DiscretiseError::NotFinite`] when an entry is
/// not finite or the exponential overflows.
pub fn discretise(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    period_s: f64,
) -> Result<(DMatrix<f64>, DMatrix<f64>), DiscretiseError> {
    let (n, m) = (a.nrows(), b.ncols());
    if a.ncols() != n || b.nrows() != n {
        return Err(DiscretiseError::Shape);
    }
    let mut block = DMatrix::zeros(n + m, n + m);
    block.view_mut((0, 0), (n, n)).copy_from(a);
    block.view_mut((0, n), (n, m)).copy_from(b);
    let exponential = matrix_exponential(&(block * period_s))?;
    let phi = exponential.view((0, 0), (n, n)).into_owned();
    let gamma = exponential.view((0, n), (n, m)).into_owned();
    Ok((phi, gamma))
}

/// exp(M) by scaling and squaring with the [13/13] Pade approximant.
///
/// Source: Higham, "The scaling and squaring method for the matrix exponential revisited", SIAM J. Matrix Anal.
/// Appl. 26 (2005); accuracy about that of SciPy's `expm`. A diagonal similarity by powers of two balances the
/// rows and columns first (Parlett and Reinsch), because a model in mixed units is badly scaled.
///
/// # Errors
/// [`DiscretiseError::Shape`] unless M is square, [`DiscretiseError::NotFinite`] when an entry of M or of the
/// result is not finite.
pub fn matrix_exponential(m: &DMatrix<f64>) -> Result<DMatrix<f64>, DiscretiseError> {
    if m.nrows() != m.ncols() {
        return Err(DiscretiseError::Shape);
    }
    if m.iter().any(|v| !v.is_finite()) {
        return Err(DiscretiseError::NotFinite);
    }
    let n = m.nrows();
    let mut balanced = m.clone();
    let scale = balance(&mut balanced);
    let norm = (0..n).map(|j| balanced.column(j).iter().map(|v| v.abs()).sum::<f64>()).fold(0.0, f64::max);
    // Below this 1-norm the approximant's backward error is under the unit roundoff (Higham, Table 2.3).
    const THETA_13: f64 = 5.371_920_351_148_152;
    let squarings = if norm > THETA_13 { (norm / THETA_13).log2().ceil() as i32 } else { 0 };
    if squarings > 1000 {
        return Err(DiscretiseError::NotFinite);
    }
    let mut result = pade13(&(balanced * 2f64.powi(-squarings))).ok_or(DiscretiseError::NotFinite)?;
    for _ in 0..squarings {
        result = &result * &result;
    }
    for j in 0..n {
        for i in 0..n {
            result[(i, j)] *= scale[i] / scale[j];
        }
    }
    if result.iter().any(|v| !v.is_finite()) {
        return Err(DiscretiseError::NotFinite);
    }
    Ok(result)
}

fn pade13(a: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    const B: [f64; 14] = [
        64_764_752_532_480_000.0,
        32_382_376_266_240_000.0,
        7_771_770_303_897_600.0,
        1_187_353_796_428_800.0,
        129_060_195_264_000.0,
        10_559_470_521_600.0,
        670_442_572_800.0,
        33_522_128_640.0,
        1_323_241_920.0,
        40_840_800.0,
        960_960.0,
        16_380.0,
        182.0,
        1.0,
    ];
    let one = DMatrix::identity(a.nrows(), a.ncols());
    let a2 = a * a;
    let a4 = &a2 * &a2;
    let a6 = &a4 * &a2;
    let odd =
        &a6 * (&a6 * B[13] + &a4 * B[11] + &a2 * B[9]) + &a6 * B[7] + &a4 * B[5] + &a2 * B[3] + &one * B[1];
    let even =
        &a6 * (&a6 * B[12] + &a4 * B[10] + &a2 * B[8]) + &a6 * B[6] + &a4 * B[4] + &a2 * B[2] + &one * B[0];
    let odd = a * odd;
    (&even - &odd).lu().solve(&(even + odd))
}

/// Scales rows and columns by powers of two until their sizes agree within a factor of two; returns D of
/// D^-1 M D. Entries keep their digits.
///
/// A state that nothing depends on, or that depends on nothing (an input in Van Loan's block), has a free scale: it
/// is made small, or a large coupling would force squarings that the dynamics do not need (the overscaling of
/// Al-Mohy and Higham, SIAM J. Matrix Anal. Appl. 31, 2009).
fn balance(m: &mut DMatrix<f64>) -> Vec<f64> {
    let n = m.nrows();
    let mut scale = vec![1.0; n];
    let small = m.diagonal().amax().max(1.0);
    for _sweep in 0..20 {
        let mut settled = true;
        for i in 0..n {
            let sum = |values: &mut dyn Iterator<Item = f64>| values.map(f64::abs).sum::<f64>();
            let column = sum(&mut (0..n).filter(|&j| j != i).map(|j| m[(j, i)]));
            let row = sum(&mut (0..n).filter(|&j| j != i).map(|j| m[(i, j)]));
            let exponent = match (column > 0.0, row > 0.0) {
                (true, true) => ((row / column).log2() / 2.0).round(),
                (true, false) => (small / column).log2().floor().min(0.0),
                (false, true) => (row / small).log2().ceil().max(0.0),
                (false, false) => continue,
            };
            let factor = 2f64.powi(exponent as i32);
            if factor == 1.0 || !factor.is_normal() || column * factor + row / factor > 0.95 * (column + row)
            {
                continue;
            }
            settled = false;
            scale[i] *= factor;
            for j in 0..n {
                m[(j, i)] *= factor;
                m[(i, j)] /= factor;
            }
        }
        if settled {
            break;
        }
    }
    scale
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponentials_are_scipys() {
        let table: serde_json::Value = serde_json::from_str(include_str!("../reference/expm.json")).unwrap();
        let cases = table["cases"].as_array().unwrap();
        assert!(cases.len() >= 10);
        let mut worst: (f64, String) = (0.0, String::new());
        for case in cases {
            let matrix = |key: &str| {
                let rows = case[key].as_array().unwrap();
                let entry = |i: usize, j: usize| rows[i][j].as_f64().unwrap();
                DMatrix::from_fn(rows.len(), rows[0].as_array().unwrap().len(), entry)
            };
            let (m, expected) = (matrix("m"), matrix("expm"));
            let found = matrix_exponential(&m).unwrap();
            let error = (&found - &expected).norm() / expected.norm();
            let tolerance = case["tolerance"].as_f64().unwrap();
            assert!(error <= tolerance, "{}: {error:e} > {tolerance:e}", case["name"]);
            if error > worst.0 {
                worst = (error, case["name"].to_string());
            }
        }
        println!("largest relative error {:e} for {}", worst.0, worst.1);
    }

    #[test]
    fn double_integrator_in_closed_form() {
        let a = DMatrix::from_row_slice(2, 2, &[0.0, 1.0, 0.0, 0.0]);
        let b = DMatrix::from_row_slice(2, 1, &[0.0, 3.0]);
        let (phi, gamma) = discretise(&a, &b, 0.2).unwrap();
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-16, "{a} {b}");
        close(phi[(0, 1)], 0.2);
        close(phi[(0, 0)], 1.0);
        close(gamma[(0, 0)], 3.0 * 0.02);
        assert!((gamma[(1, 0)] - 0.6).abs() < 2e-16);
    }

    #[test]
    fn what_has_no_exponential_is_refused() {
        let m = |v: f64| DMatrix::from_element(2, 2, v);
        assert_eq!(matrix_exponential(&m(f64::NAN)), Err(DiscretiseError::NotFinite));
        assert_eq!(matrix_exponential(&m(1e4)), Err(DiscretiseError::NotFinite));
        assert_eq!(matrix_exponential(&DMatrix::zeros(2, 3)), Err(DiscretiseError::Shape));
        assert_eq!(matrix_exponential(&m(0.0)).unwrap(), DMatrix::identity(2, 2));
    }
}
