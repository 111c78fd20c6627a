//! Robust statistics and the chi-square distribution, which are used for the figures of a run.

use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Median; 0 for an empty slice. Values that are not finite are ignored.
pub fn median(values: &[f64]) -> f64 {
    quantile(values, 0.5)
}

/// Quantile by linear interpolation between order statistics (Hyndman and Fan 1996, type 7); 0 for an empty
/// slice. Values that are not finite are ignored. `p` in `[0, 1]`.
pub fn quantile(values: &[f64], p: f64) -> f64 {
    let mut v: Vec<f64> = values.iter().copied().filter(|x| x.is_finite()).collect();
    if v.is_empty() {
        return 0.0;
    }
    let at = p.clamp(0.0, 1.0) * (v.len() - 1) as f64;
    let low = at.floor() as usize;
    let (_, below, above) = v.select_nth_unstable_by(low, f64::total_cmp);
    let below = *below;
    let next = above.iter().copied().min_by(f64::total_cmp).unwrap_or(below);
    below + (at - low as f64) * (next - below)
}

/// Arithmetic mean; 0 for an empty slice.
pub fn mean(values: &[f64]) -> f64 {
    if values.is_empty() { 0.0 } else { values.iter().sum::<f64>() / values.len() as f64 }
}

/// Root of the mean square; 0 for an empty slice.
pub fn rms(values: &[f64]) -> f64 {
    if values.is_empty() {
        0.0
    } else {
        (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
    }
}

/// Pearson's correlation of two equally long slices; 0 when either is constant.
pub fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let (ma, mb) = (mean(a), mean(b));
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (x, y) in a.iter().zip(b) {
        ab += (x - ma) * (y - mb);
        aa += (x - ma) * (x - ma);
        bb += (y - mb) * (y - mb);
    }
    let scale = (aa * bb).sqrt();
    if scale > 0.0 { ab / scale } else { 0.0 }
}

/// Standard deviation estimated from the median absolute deviation about the median, consistent for Gaussian
/// data (factor 1.4826; Rousseeuw and Croux 1993).
pub fn mad_std(values: &[f64]) -> f64 {
    let m = median(values);
    let deviations: Vec<f64> = values.iter().map(|v| (v - m).abs()).collect();
    1.4826 * median(&deviations)
}

/// Standard deviation of the white noise on a smooth signal, from second differences over every other sample:
/// `1.482602 / sqrt(6) median|2 y_i - y_(i-2) - y_(i+2)|` (DER_SNR; Stoehr et al. 2008, ASP Conf. Ser. 394, 505).
/// A noise-free smooth signal gives nearly 0.
pub fn white_noise_std(y: &[f64]) -> f64 {
    if y.len() < 5 {
        return 0.0;
    }
    let differences: Vec<f64> = y.windows(5).map(|w| (2.0 * w[2] - w[0] - w[4]).abs()).collect();
    1.482_602 / 6f64.sqrt() * median(&differences)
}

/// Multiple of a standard deviation below which all of `n` Gaussian samples stay with at least 95 % probability,
/// by the union bound: `sqrt(2 ln(n / 0.05))`; correlated samples stay below it all the more.
pub fn noise_multiple(n: usize) -> f64 {
    (2.0 * (n.max(1) as f64 / 0.05).ln()).sqrt()
}

/// Centred moving average over `2 half + 1` samples, shorter at the ends.
pub fn moving_average(y: &[f64], half: usize) -> Vec<f64> {
    if half == 0 {
        return y.to_vec();
    }
    let mut sums = Vec::with_capacity(y.len() + 1);
    sums.push(0.0);
    let mut sum = 0.0;
    for v in y {
        sum += v;
        sums.push(sum);
    }
    (0..y.len())
        .map(|i| {
            // Symmetric at the ends too, so that a slope is not shifted in time.
            let h = half.min(i).min(y.len() - 1 - i);
            (sums[i + h + 1] - sums[i - h]) / (2 * h + 1) as f64
        })
        .collect()
}

/// Quantile of the chi-square distribution: the value that a variable with `degrees` degrees of freedom does not
/// exceed with probability `p`, in `[0, 1]`. Without a degree of freedom the variable is always 0.
pub fn chi_square_quantile(p: f64, degrees: f64) -> f64 {
    ChiSquared::new(degrees).map_or(0.0, |distribution| distribution.inverse_cdf(p))
}

/// Probability that a chi-square variable with `degrees` degrees of freedom exceeds `x`. It is accurate far into
/// the tail, where 1 minus the cumulative probability would be nothing but rounding error. NaN for a NaN; without
/// a degree of freedom the variable is always 0.
pub fn chi_square_tail(x: f64, degrees: f64) -> f64 {
    match ChiSquared::new(degrees) {
        _ if x.is_nan() => f64::NAN,
        Ok(distribution) => distribution.sf(x),
        Err(_) => f64::from(u8::from(x < 0.0)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_test_harness::noise;

    /// Probability, degrees of freedom and the quantile by `scipy.stats.chi2.ppf`.
    const CHI_SQUARE_QUANTILES: [(f64, f64, f64); 5] = [
        (0.025, 10.0, 3.246_972_780_236_841_3),
        (0.975, 10.0, 20.483_177_350_807_388),
        (0.025, 1_000.0, 914.257_153_799_259),
        (0.975, 1_000.0, 1_089.530_912_774_913_5),
        (0.975, 240_000.0, 241_359.796_192_816_25),
    ];

    /// Value, degrees of freedom and the tail probability by `scipy.stats.chi2.sf`.
    const CHI_SQUARE_TAILS: [(f64, f64, f64); 7] = [
        (18.307, 10.0, 0.050_000_589_091_398_12),
        (50.892, 30.0, 0.010_000_441_157_962_71),
        (45.0, 1.0, 1.970_344_471_179_912e-11),
        (80.0, 2.0, 4.248_354_255_291_595e-18),
        (150.0, 6.0, 7.737_242_864_182_583e-30),
        (400.0, 30.0, 2.795_493_857_656_505_7e-66),
        (1_300.0, 1_000.0, 3.889_736_499_486_836_6e-10),
    ];

    #[test]
    fn noise_is_measured_on_a_moving_signal() {
        let n = noise(4000, 1);
        let y: Vec<f64> = n.iter().enumerate().map(|(i, e)| (i as f64 * 0.02).sin() + 0.05 * e).collect();
        let s = white_noise_std(&y);
        assert!((s - 0.05).abs() < 0.004, "{s}");
        let clean: Vec<f64> = (0..4000).map(|i| (i as f64 * 0.02).sin()).collect();
        assert!(white_noise_std(&clean) < 2e-3);
    }

    #[test]
    fn quantiles_interpolate() {
        assert_eq!(median(&[3.0, 1.0, 2.0]), 2.0);
        assert_eq!(quantile(&[0.0, 1.0, 2.0, 3.0], 0.5), 1.5);
        assert_eq!(quantile(&[4.0], 0.99), 4.0);
        assert_eq!(median(&[f64::NAN, 1.0]), 1.0);
    }

    #[test]
    fn chi_square_agrees_with_tables() {
        for (p, degrees, expected) in CHI_SQUARE_QUANTILES {
            let found = chi_square_quantile(p, degrees);
            assert!((found / expected - 1.0).abs() < 1e-9, "{p} {degrees}: {found}");
        }
        for (x, degrees, expected) in CHI_SQUARE_TAILS {
            let found = chi_square_tail(x, degrees);
            assert!((found / expected - 1.0).abs() < 1e-9, "{x} {degrees}: {found:e}");
        }
        assert_eq!((chi_square_tail(-1.0, 3.0), chi_square_tail(1e6, 3.0)), (1.0, 0.0));
        assert_eq!((chi_square_tail(1.0, 0.0), chi_square_tail(-1.0, 0.0)), (0.0, 1.0));
        assert!(chi_square_tail(f64::NAN, 3.0).is_nan());
    }

    #[test]
    fn a_moving_average_keeps_a_straight_line() {
        let line: Vec<f64> = (0..50).map(|i| 2.0 * i as f64 - 7.0).collect();
        for (a, b) in moving_average(&line, 6).iter().zip(&line) {
            assert!((a - b).abs() < 1e-12);
        }
    }
}
