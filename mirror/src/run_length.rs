//! Thresholds of the tests from the average run length until a false alarm.

/// Mean overshoot of a Gaussian random walk over a boundary, in standard deviations (Siegmund, "Sequential
/// Analysis", 1985, chapter 10).
const OVERSHOOT: f64 = 0.583;

/// Threshold of the cumulative sum of log-likelihood ratios for a mean shift of `size` standard deviations
/// with an average run length of `steps` without a change. Siegmund's approximation with the overshoot at
/// both ends: with b = threshold / size + 2 x 0.583 the run length is (exp(size b) - size b - 1) / (size^2 /
/// 2) steps.
pub fn mean_threshold(size: f64, steps: f64) -> f64 {
    let wanted = steps * size * size / 2.0;
    // Solve exp(x) - x - 1 = wanted by Newton's method from above; the function is convex.
    let mut x = (wanted + 1.0).ln() + 3.0;
    for _ in 0..50 {
        x -= (x.exp() - x - 1.0 - wanted) / x.exp_m1();
    }
    (x - 2.0 * OVERSHOOT * size).max(1.0)
}

/// Threshold of any cumulative sum of log-likelihood ratios with an average run length of at least `steps`:
/// the bound of Lorden (Ann. Math. Stat. 42, 1971) and Wald, which holds for any distribution.
pub fn variance_threshold(steps: f64) -> f64 {
    steps.ln().max(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_vehicle::Stream;

    /// Average run length of a cumulative sum of Gaussian log-likelihood ratios without a change, over `runs`
    /// runs.
    fn average(size: f64, threshold: f64, runs: usize) -> f64 {
        let mut stream = Stream::new(1, "run length");
        let mut steps = 0u64;
        for _ in 0..runs {
            let mut sum: f64 = 0.0;
            while sum < threshold {
                sum = (sum + size * (stream.normal() - 0.5 * size)).max(0.0);
                steps += 1;
            }
        }
        steps as f64 / runs as f64
    }

    #[test]
    fn a_test_alarms_as_rarely_as_asked() {
        for size in [0.2, 1.0, 3.0] {
            let threshold = mean_threshold(size, 5000.0);
            let average = average(size, threshold, 400);
            // Run lengths are nearly exponentially distributed: four standard errors of 400 of them are 20 %.
            assert!((3500.0..7500.0).contains(&average), "size {size}: {average}");
        }
    }
}
