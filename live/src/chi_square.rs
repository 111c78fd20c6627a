//! The band that contains the normalised innovation squared of a filter with a correct model.

use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Share of the values inside the band.
const SHARE: f64 = 0.95;

/// Limits of a chi-square variable divided by its degrees of freedom, for 0 to a greatest number of degrees
/// of freedom.
#[derive(Debug, Clone)]
pub(crate) struct ChiSquareBand {
    limits: Vec<(f64, f64)>,
}

impl ChiSquareBand {
    /// The limits for up to `most` degrees of freedom.
    pub fn new(most: usize) -> Self {
        let limits = (0..=most).map(|degrees| {
            let Ok(distribution) = ChiSquared::new(degrees as f64) else { return (f64::NAN, f64::NAN) };
            let at = |p: f64| distribution.inverse_cdf(p) / degrees as f64;
            (at(0.5 - 0.5 * SHARE), at(0.5 + 0.5 * SHARE))
        });
        Self { limits: limits.collect() }
    }

    /// The limits for `degrees` degrees of freedom; NaN where there are none.
    pub fn of(&self, degrees: u32) -> (f64, f64) {
        self.limits.get(degrees as usize).copied().unwrap_or((f64::NAN, f64::NAN))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limits_are_those_of_the_tables() {
        let band = ChiSquareBand::new(4);
        let (low, high) = band.of(4);
        assert!((4.0 * low - 0.484).abs() < 1e-3 && (4.0 * high - 11.143).abs() < 1e-3, "{low} {high}");
        assert!(band.of(0).0.is_nan() && band.of(9).1.is_nan());
    }
}
