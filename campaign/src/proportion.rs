//! Proportions of events, with confidence intervals.

use serde::Serialize;
use statrs::distribution::{Beta, Binomial, ChiSquared, ContinuousCDF, DiscreteCDF, Normal};

/// A share of independent trials, with an interval of 95 %.
///
/// Wilson's score interval (Wilson 1927; the one that Brown, Cai and DasGupta, "Interval estimation for a binomial
/// proportion", Statistical Science 16, 2001, recommend), but the exact one of Clopper and Pearson (1934) where nothing or
/// everything happened: there the score interval is too short.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Proportion {
    /// Number of events.
    pub count: u64,
    /// Number of trials.
    pub of: u64,
    /// Share, 0 to 1; 0 without trials.
    pub share: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

/// Probability outside the interval.
const ALPHA: f64 = 0.05;

/// Whether an event is significantly more frequent under one condition than under another, when every trial was
/// made under both. It occurred only under the first on `first` trials, and only under the second on `second`.
/// McNemar's exact test, two-sided at 5 % (McNemar, Psychometrika 12, 1947): under the null hypothesis either is
/// equally likely on each of these trials.
pub fn more_often_in_pairs(first: u64, second: u64) -> bool {
    first > second && Binomial::new(0.5, first + second).is_ok_and(|either| 2.0 * either.cdf(second) < ALPHA)
}

impl Proportion {
    /// `count` of `of` trials; a count above `of` is taken for `of`.
    pub fn new(count: u64, of: u64) -> Self {
        let count = count.min(of);
        if of == 0 {
            return Self { count, of, share: 0.0, low: 0.0, high: 1.0 };
        }
        let share = count as f64 / of as f64;
        let (low, high) = if count == 0 || count == of { exact(count, of) } else { score(share, of as f64) };
        Self { count, of, share, low, high }
    }

    /// Probability of an event, from the weights of the trials in which it occurred, out of `of` trials with
    /// weights of at most `most`.
    ///
    /// The interval for a weighted sum of Poisson counts (Fay and Feuer, Statistics in Medicine 16, 1997), which
    /// is exact for equal weights of a rare event and conservative for others.
    pub fn weighted(weights: &[f64], of: u64, most: f64) -> Self {
        let n = of.max(1) as f64;
        let share = weights.iter().sum::<f64>() / n;
        let variance = weights.iter().map(|w| w * w).sum::<f64>() / (n * n);
        let chi_square = |p: f64, degrees: f64| ChiSquared::new(degrees).map_or(0.0, |d| d.inverse_cdf(p));
        let scaled = |p: f64, mean: f64, variance: f64| {
            variance / (2.0 * mean) * chi_square(p, 2.0 * mean * mean / variance)
        };
        let greatest = weights.iter().copied().reduce(f64::max).unwrap_or(most) / n;
        let low = if weights.is_empty() { 0.0 } else { scaled(ALPHA / 2.0, share, variance) };
        let high = scaled(1.0 - ALPHA / 2.0, share + greatest, variance + greatest * greatest);
        Self { count: weights.len() as u64, of, share, low: low.min(1.0), high: high.min(1.0) }
    }

    /// Length of the interval.
    pub fn width(&self) -> f64 {
        self.high - self.low
    }
}

fn score(share: f64, n: f64) -> (f64, f64) {
    let z = Normal::standard().inverse_cdf(1.0 - ALPHA / 2.0);
    let scale = 1.0 + z * z / n;
    let middle = (share + z * z / (2.0 * n)) / scale;
    let half = z / scale * (share * (1.0 - share) / n + z * z / (4.0 * n * n)).sqrt();
    ((middle - half).max(0.0), (middle + half).min(1.0))
}

/// Clopper and Pearson's interval, by the quantiles of the beta distribution.
fn exact(count: u64, of: u64) -> (f64, f64) {
    let (k, n) = (count as f64, of as f64);
    // Shapes are positive: count < of for the upper end, count > 0 for the lower.
    let quantile = |a: f64, b: f64, p: f64| Beta::new(a, b).map_or(f64::NAN, |beta| beta.inverse_cdf(p));
    let low = if count == 0 { 0.0 } else { quantile(k, n - k + 1.0, ALPHA / 2.0) };
    let high = if count == of { 1.0 } else { quantile(k + 1.0, n - k, 1.0 - ALPHA / 2.0) };
    (low, high)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `scipy.stats.binomtest(k, n).proportion_ci(method=...)`, SciPy 1.17: "wilson", and "exact" at the ends.
    #[test]
    fn pairs_decide_only_where_chance_would_not() {
        // Of n that differ all one way, 2 / 2^n: below 5 % from six on.
        assert!(more_often_in_pairs(6, 0) && !more_often_in_pairs(5, 0));
        assert!(!more_often_in_pairs(0, 0) && !more_often_in_pairs(0, 30) && !more_often_in_pairs(12, 12));
        // Nine of ten: 2 * 11 / 1024 = 0.021; eight of ten: 0.109.
        assert!(more_often_in_pairs(9, 1) && !more_often_in_pairs(8, 2));
    }

    #[test]
    fn intervals_are_those_of_scipy() {
        for (count, of, low, high) in [
            (3, 40, 0.025_836_025_774_588_198, 0.198_642_335_243_105_43),
            (500, 1000, 0.469_069_600_368_104_2, 0.530_930_399_631_895_8),
            (0, 100, 0.0, 0.036_216_692_645_190_54),
            (100, 100, 0.963_783_307_354_809_4, 1.0),
        ] {
            let p = Proportion::new(count, of);
            assert!((p.low - low).abs() < 1e-9 && (p.high - high).abs() < 1e-9, "{p:?}");
        }
    }

    #[test]
    fn nothing_flown_says_nothing() {
        let p = Proportion::new(0, 0);
        assert_eq!((p.low, p.high, p.width()), (0.0, 1.0, 1.0));
    }
}
