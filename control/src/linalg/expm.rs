//! The matrix exponential and zero-order-hold discretisation.

use nalgebra::DMatrix;

/// `exp(a)` by scaling and squaring with the [13/13] Pade approximant (Higham, SIAM J. Matrix Anal. Appl. 26,
/// 2005). An input with entries that are not finite gives entries that are not finite.
pub fn expm(a: &DMatrix<f64>) -> DMatrix<f64> {
    const B: [f64; 14] = [
        64764752532480000.0,
        32382376266240000.0,
        7771770303897600.0,
        1187353796428800.0,
        129060195264000.0,
        10559470521600.0,
        670442572800.0,
        33522128640.0,
        1323241920.0,
        40840800.0,
        960960.0,
        16380.0,
        182.0,
        1.0,
    ];
    const THETA_13: f64 = 5.371920351148152;
    let n = a.nrows();
    let norm = (0..n).map(|j| a.column(j).iter().map(|v| v.abs()).sum::<f64>()).fold(0.0, f64::max);
    if !norm.is_finite() {
        return DMatrix::from_element(n, n, f64::NAN);
    }
    let squarings = if norm > THETA_13 { (norm / THETA_13).log2().ceil() as i32 } else { 0 };
    let a = a * f64::powi(2.0, -squarings);
    let identity = DMatrix::identity(n, n);
    let a2 = &a * &a;
    let a4 = &a2 * &a2;
    let a6 = &a4 * &a2;
    let odd = &a6 * (&a6 * B[13] + &a4 * B[11] + &a2 * B[9])
        + &a6 * B[7]
        + &a4 * B[5]
        + &a2 * B[3]
        + &identity * B[1];
    let u = &a * odd;
    let v = &a6 * (&a6 * B[12] + &a4 * B[10] + &a2 * B[8])
        + &a6 * B[6]
        + &a4 * B[4]
        + &a2 * B[2]
        + &identity * B[0];
    // The denominator is well conditioned for norms below theta, so the solve cannot fail on finite input.
    let mut e = (&v - &u).lu().solve(&(&v + &u)).unwrap_or_else(|| DMatrix::from_element(n, n, f64::NAN));
    for _ in 0..squarings {
        e = &e * &e;
    }
    e
}

/// Exact zero-order-hold discretisation of `x' = a x + b u` (a: n x n, b: n x m) with period `dt` in s:
/// `(phi, gamma)` with `x+ = phi x + gamma u`, from the exponential of the block matrix `[[a, b], [0, 0]] dt`
/// (Van Loan, IEEE Trans. Autom. Control 23, 1978).
pub fn discretise(a: &DMatrix<f64>, b: &DMatrix<f64>, dt: f64) -> (DMatrix<f64>, DMatrix<f64>) {
    let (n, m) = (a.nrows(), b.ncols());
    let mut block = DMatrix::zeros(n + m, n + m);
    block.view_mut((0, 0), (n, n)).copy_from(&(a * dt));
    block.view_mut((0, n), (n, m)).copy_from(&(b * dt));
    let e = expm(&block);
    (e.view((0, 0), (n, n)).into_owned(), e.view((0, n), (n, m)).into_owned())
}
