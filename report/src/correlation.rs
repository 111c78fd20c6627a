//! Correlation of a residual with an input. Both are prewhitened, so that chance correlations have the same
//! size at every lag.

use whirlstand_ident::identify::ar::Ar;

/// Greatest number of lags.
const LAGS: usize = 400;
/// Greatest number of samples used: the middle of longer records.
const SAMPLES: usize = 20_000;
/// Highest order of the prewhitening filter.
const ORDER: usize = 20;
/// Quantile of the normal distribution for 99 %.
const NORMAL: f64 = 2.576;

/// Correlation of a residual with the past of an input.
#[derive(Debug, Clone, PartialEq)]
pub struct Correlation {
    /// Lag of the residual behind the input, s; negative where it leads.
    pub lag_s: Vec<f64>,
    /// Correlation, -1 to 1.
    pub value: Vec<f64>,
    /// Half-width of the band that chance correlations stay within at 99 % of the lags.
    pub band: f64,
}

/// Correlates a residual with an input at equal times, `period_s` apart. The filter that whitens the input is
/// applied to both first (Box and Jenkins' prewhitening): without it, any slow residual correlates with any slow
/// input.
///
/// `None` when the record is too short, or either signal does not vary.
pub fn correlation(input: &[f64], residual: &[f64], period_s: f64) -> Option<Correlation> {
    let n = input.len().min(residual.len());
    let from = n.saturating_sub(SAMPLES) / 2;
    let part = from..(from + SAMPLES).min(n);
    let centred = |v: &[f64]| {
        let mean = whirlstand_logs::stats::mean(v);
        v.iter().map(|v| v - mean).collect::<Vec<f64>>()
    };
    let (u, r) = (centred(&input[part.clone()]), centred(&residual[part]));
    let reach = ((2.0 / period_s) as usize).clamp(10, LAGS);
    if u.len() < 8 * reach && u.len() < 400 {
        return None;
    }
    let reach = reach.min(u.len() / 8);
    let filter = Ar::fit(&[&u], ORDER);
    let (u, r) = (filter.whiten(&u), filter.whiten(&r));
    let power = |v: &[f64]| v.iter().map(|v| v * v).sum::<f64>();
    let scale = (power(&u) * power(&r)).sqrt();
    if !(scale > 0.0 && scale.is_finite()) {
        return None;
    }
    let n = u.len();
    let lags = -(reach as i64) / 4..=reach as i64;
    let value = |lag: i64| {
        let (a, b) = (lag.max(0) as usize, (-lag).max(0) as usize);
        let pairs = r[a..].iter().zip(&u[b..]);
        pairs.map(|(r, u)| r * u).sum::<f64>() / scale
    };
    Some(Correlation {
        lag_s: lags.clone().map(|l| l as f64 * period_s).collect(),
        value: lags.map(value).collect(),
        band: NORMAL / (n as f64).sqrt(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_vehicle::Stream;

    fn slow(seed: u64, pole: f64) -> Vec<f64> {
        let mut stream = Stream::new(seed, "test");
        let mut y = 0.0;
        (0..4000)
            .map(|_| {
                y = pole * y + stream.normal();
                y
            })
            .collect()
    }

    #[test]
    fn slow_signals_of_no_kinship_stay_within_the_band() {
        let outside: usize = (0..10)
            .map(|seed| {
                let c = correlation(&slow(seed, 0.98), &slow(seed + 100, 0.97), 0.02).unwrap();
                c.value.iter().filter(|v| v.abs() > c.band).count()
            })
            .sum();
        let all = 10 * correlation(&slow(0, 0.98), &slow(100, 0.97), 0.02).unwrap().value.len();
        assert!(outside * 50 < all, "{outside} of {all}");
    }

    #[test]
    fn what_follows_an_input_shows_at_its_lag() {
        let u = slow(1, 0.95);
        let noise = slow(2, 0.9);
        let r: Vec<f64> = (0..u.len()).map(|k| 0.5 * u[k.saturating_sub(12)] + noise[k]).collect();
        let c = correlation(&u, &r, 0.02).unwrap();
        let best = (0..c.value.len()).max_by(|a, b| c.value[*a].abs().total_cmp(&c.value[*b].abs())).unwrap();
        assert!((c.lag_s[best] - 0.24).abs() < 1e-9 && c.value[best] > 3.0 * c.band);
        assert!(correlation(&[1.0; 4000], &r, 0.02).is_none());
    }
}
