//! Scaling by powers of two that keeps the squares of a matrix's entries within the range of floating-point
//! numbers. It loses no digit.

use nalgebra::DMatrix;

use super::C64;

/// Range of sizes, as powers of two, in which nothing is scaled: fourth powers of the entries are far from
/// overflow.
const SAFE: i32 = 200;

/// Whether all entries are finite.
pub fn is_finite(m: &DMatrix<C64>) -> bool {
    m.iter().all(|v| v.re.is_finite() && v.im.is_finite())
}

/// Exponent e such that `2^-e` scales the largest entry of `m` to about one; zero when no scaling is needed.
pub fn unit_exponent(m: &DMatrix<C64>) -> i32 {
    let largest = m.iter().map(|v| v.re.abs().max(v.im.abs())).fold(0.0, f64::max);
    if largest == 0.0 {
        return 0;
    }
    let exponent = largest.log2() as i32;
    if exponent.abs() > SAFE { exponent } else { 0 }
}

/// Multiplies `m` by `2^exponent`.
pub fn scale(m: &mut DMatrix<C64>, exponent: i32) {
    if exponent == 0 {
        return;
    }
    // In two steps, as the power itself may overflow.
    let half = exponent / 2;
    for factor in [half, exponent - half].map(|e| f64::powi(2.0, e)) {
        m.iter_mut().for_each(|v| *v *= factor);
    }
}
