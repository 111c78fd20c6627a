//! Robust statistics that the figures of a run rest on.

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
    v.sort_unstable_by(f64::total_cmp);
    let at = p.clamp(0.0, 1.0) * (v.len() - 1) as f64;
    let low = at.floor() as usize;
    let high = (low + 1).min(v.len() - 1);
    v[low] + (at - low as f64) * (v[high] - v[low])
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

/// Quantile of the chi-square distribution by Wilson and Hilferty's cube-root transformation (1931); within
/// 1 % for ten degrees of freedom and 0.01 % for a thousand, which is where it is used. `z` is the standard normal quantile.
pub fn chi_square_quantile(degrees: f64, z: f64) -> f64 {
    if degrees <= 0.0 {
        return 0.0;
    }
    let k = 2.0 / (9.0 * degrees);
    degrees * (1.0 - k + z * k.sqrt()).powi(3).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::window::tests::noise;

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
        // scipy.stats.chi2.ppf([0.025, 0.975], 10) and (0.975, 1000)
        assert!((chi_square_quantile(10.0, -1.959_964) / 3.246_973 - 1.0).abs() < 1e-2);
        assert!((chi_square_quantile(10.0, 1.959_964) / 20.483_177 - 1.0).abs() < 1e-2);
        assert!((chi_square_quantile(1000.0, 1.959_964) / 1_089.530_9 - 1.0).abs() < 1e-4);
    }

    #[test]
    fn a_moving_average_keeps_a_straight_line() {
        let line: Vec<f64> = (0..50).map(|i| 2.0 * i as f64 - 7.0).collect();
        for (a, b) in moving_average(&line, 6).iter().zip(&line) {
            assert!((a - b).abs() < 1e-12);
        }
    }
}
