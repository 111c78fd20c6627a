//! The matrix exponential and its derivatives in many directions.

use nalgebra::DMatrix;

/// exp(M) and the Frechet derivatives L(M, E) for each direction E, all N x N.
///
/// Taylor series on M / 2^s with 1-norm at most 1/2, then s squarings: exp(2M) = exp(M)^2 and
/// L(2M, 2E) = exp(M) L(M, E) + L(M, E) exp(M) (Higham, Functions of Matrices, SIAM 2008, section 3.2 and chapter
/// 10). Over one sample period M is small, so that this is cheaper than a Pade approximant and as exact.
///
/// Returns `None` when an entry is not finite.
pub fn exponential_with_derivatives(
    m: &DMatrix<f64>,
    directions: &[DMatrix<f64>],
) -> Option<(DMatrix<f64>, Vec<DMatrix<f64>>)> {
    /// Largest 1-norm for which the series below is cut off beneath the unit roundoff: 0.5^15 / 15! = 2.3e-17.
    const NORM: f64 = 0.5;
    const TERMS: usize = 15;
    let n = m.nrows();
    let norm = (0..n).map(|j| m.column(j).iter().map(|v| v.abs()).sum::<f64>()).fold(0.0, f64::max);
    if !norm.is_finite() {
        return None;
    }
    let squarings = if norm > NORM { (norm / NORM).log2().ceil() as i32 } else { 0 };
    if squarings > 200 {
        return None;
    }
    let scale = 2f64.powi(-squarings);
    let base = m * scale;
    // power = base^k / k!, slope = its derivative.
    let mut power = DMatrix::identity(n, n);
    let mut value = power.clone();
    let mut slopes = vec![DMatrix::<f64>::zeros(n, n); directions.len()];
    let mut derivatives = slopes.clone();
    let scaled: Vec<DMatrix<f64>> = directions.iter().map(|e| e * scale).collect();
    for k in 1..=TERMS {
        let factor = 1.0 / k as f64;
        for ((slope, derivative), e) in slopes.iter_mut().zip(&mut derivatives).zip(&scaled) {
            *slope = (&base * &*slope + e * &power) * factor;
            *derivative += &*slope;
        }
        power = &base * power * factor;
        value += &power;
    }
    for _ in 0..squarings {
        for derivative in &mut derivatives {
            *derivative = &value * &*derivative + &*derivative * &value;
        }
        value = &value * &value;
    }
    value.iter().all(|v| v.is_finite()).then_some((value, derivatives))
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_vehicle::matrix_exponential;

    #[test]
    fn derivatives_agree_with_differences_of_the_exponential() {
        for size in [0.1, 1.0, 8.0] {
            let m = DMatrix::from_fn(5, 5, |i, j| size * ((3 * i + 7 * j) as f64).sin());
            let direction = DMatrix::from_fn(5, 5, |i, j| f64::from(u8::from((i, j) == (2, 3))));
            let (value, derivatives) =
                exponential_with_derivatives(&m, std::slice::from_ref(&direction)).unwrap();
            let exact = matrix_exponential(&m).unwrap();
            assert!((&value - &exact).norm() < 1e-13 * exact.norm() * (1.0 + size), "{size}");
            let h = 1e-5;
            let up = matrix_exponential(&(&m + &direction * h)).unwrap();
            let down = matrix_exponential(&(&m - &direction * h)).unwrap();
            let difference = (up - down) / (2.0 * h);
            assert!((&derivatives[0] - &difference).norm() < 1e-8 * difference.norm(), "{size}");
        }
    }
}
