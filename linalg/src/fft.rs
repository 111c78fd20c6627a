//! Fourier transforms, by rustfft. Its algorithms are generic and would be compiled again in every room that plans
//! one.

use std::sync::Arc;

pub use rustfft::Fft;
use rustfft::FftPlanner;

/// The transform of `length` complex samples, `X_k = sum of x_n exp(-2 pi i k n / length)`, not scaled.
pub fn forward(length: usize) -> Arc<dyn Fft<f64>> {
    FftPlanner::new().plan_fft_forward(length)
}

/// The inverse of [`forward`] times `length`.
pub fn inverse(length: usize) -> Arc<dyn Fft<f64>> {
    FftPlanner::new().plan_fft_inverse(length)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::C64;

    #[test]
    fn the_inverse_returns_what_was_transformed_times_its_length() {
        for length in [1, 7, 64, 100] {
            let signal: Vec<C64> = (0..length).map(|k| C64::new(f64::from(k), 1.0)).collect();
            let mut values = signal.clone();
            forward(length as usize).process(&mut values);
            let sum: C64 = signal.iter().sum();
            assert!((values[0] - sum).norm() < 1e-9 * sum.norm());
            inverse(length as usize).process(&mut values);
            assert!(values.iter().zip(&signal).all(|(v, s)| (v / f64::from(length) - s).norm() < 1e-9));
        }
    }
}
