//! Estimation of the time lag between two signals that show the same motion.

use std::f64::consts::PI;

use whirlstand_linalg::{C64, fft};

use crate::resample::{Clock, onto};
use crate::sampling::median_interval;
use crate::series::Series;

/// Relative height of a second peak that makes the answer ambiguous.
const RIVAL: f64 = 0.9;

/// The lag of one signal behind another.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct TimeOffset {
    /// Lag of the second signal behind the first, s.
    pub lag_s: f64,
    /// Correlation coefficient at that lag, -1 to 1; negative when one has the opposite sign.
    pub correlation: f64,
    /// Whether another lag fits almost as well, as with periodic motion.
    pub ambiguous: bool,
}

/// The reason why the lag cannot be estimated.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum OffsetError {
    /// The signals share too little time.
    #[error("{a} and {b} have only {points} samples in common; at least {needed} are needed for this lag")]
    TooShort {
        /// The first signal.
        a: String,
        /// The second signal.
        b: String,
        /// Common samples.
        points: usize,
        /// Required samples.
        needed: usize,
    },
    /// A signal is constant.
    #[error("{0} is constant: there is nothing to align")]
    Constant(String),
}

/// Estimates the lag of `b` behind `a`, between `-max_lag_s` and `max_lag_s`.
///
/// Both are resampled to the clock of the faster one, and mean and trend are removed. The lag is where their
/// cross-correlation (by FFT, zero-padded; Knapp, Carter 1976) has its greatest magnitude, refined between
/// samples on its band-limited interpolation.
///
/// # Errors
/// [`OffsetError`].
pub fn time_offset(a: &Series, b: &Series, max_lag_s: f64) -> Result<TimeOffset, OffsetError> {
    const FEWEST: usize = 16;
    let too_short =
        |points, needed| OffsetError::TooShort { a: a.name.clone(), b: b.name.clone(), points, needed };
    let period = [a, b].iter().filter_map(|s| median_interval(s.time())).fold(f64::INFINITY, f64::min);
    let ends = |s: &Series| Some((*s.time().first()?, *s.time().last()?));
    let (Some((a0, a1)), Some((b0, b1))) = (ends(a), ends(b)) else { return Err(too_short(0, FEWEST)) };
    let clock = Clock::over(a0.max(b0), a1.min(b1), period).map_err(|_| too_short(0, FEWEST))?;
    let lags = (max_lag_s.abs() / period).ceil() as usize;
    let needed = FEWEST.max(lags.saturating_add(FEWEST));
    if clock.points < needed {
        return Err(too_short(clock.points, needed));
    }
    let prepare = |s: &Series| {
        let mut values = onto(s, &clock, false);
        detrend(&mut values);
        let energy = values.iter().map(|v| v * v).sum::<f64>();
        if energy > 0.0 { Ok((values, energy)) } else { Err(OffsetError::Constant(s.name.clone())) }
    };
    let ((x, x_energy), (y, y_energy)) = (prepare(a)?, prepare(b)?);

    // Zero-padding prevents circular correlation.
    let n = (2 * clock.points).next_power_of_two();
    let spectrum = |values: &[f64]| {
        let mut buffer: Vec<C64> = values.iter().map(|v| C64::new(*v, 0.0)).collect();
        buffer.resize(n, C64::default());
        fft::forward(n).process(&mut buffer);
        buffer
    };
    let (fx, fy) = (spectrum(&x), spectrum(&y));
    let cross: Vec<C64> = fx.iter().zip(&fy).map(|(a, b)| a.conj() * b).collect();
    let mut correlation = cross.clone();
    fft::inverse(n).process(&mut correlation);
    let scale = 1.0 / (n as f64 * (x_energy * y_energy).sqrt());
    let at = |lag: isize| correlation[lag.rem_euclid(n as isize) as usize].re * scale;
    let lags = lags as isize;
    let best = (-lags..=lags).max_by(|i, j| at(*i).abs().total_cmp(&at(*j).abs())).unwrap_or(0);
    let peak = at(best).abs();
    let rival = (-lags..=lags).any(|lag| {
        let top = at(lag).abs();
        let is_peak = top >= at(lag - 1).abs() && top >= at(lag + 1).abs();
        lag != best && (lag - best).abs() > 1 && is_peak && top > RIVAL * peak
    });
    let (fraction, value) = refine(&cross, best as f64, at(best).signum());
    Ok(TimeOffset { lag_s: fraction * period, correlation: value * scale * n as f64, ambiguous: rival })
}

/// Subtracts the least-squares line; gaps become 0, which has no weight.
fn detrend(values: &mut [f64]) {
    let mut sums = [0.0; 5];
    for (k, v) in values.iter().enumerate().filter(|(_, v)| !v.is_nan()) {
        let t = k as f64;
        for (sum, term) in sums.iter_mut().zip([1.0, t, t * t, *v, t * v]) {
            *sum += term;
        }
    }
    let [n, t, tt, v, tv] = sums;
    let determinant = n * tt - t * t;
    let slope = if determinant.abs() > 0.0 { (n * tv - t * v) / determinant } else { 0.0 };
    let level = if n > 0.0 { (v - slope * t) / n } else { 0.0 };
    // The rounding errors of a straight line must not count as motion.
    let crumb = 1e-12 * (level.abs() + slope.abs() * values.len() as f64);
    for (k, value) in values.iter_mut().enumerate() {
        let rest = *value - level - slope * k as f64;
        *value = if rest.is_nan() || rest.abs() <= crumb { 0.0 } else { rest };
    }
}

/// Greatest value of the band-limited correlation within one sample of `around`, by golden-section search.
fn refine(cross: &[C64], around: f64, sign: f64) -> (f64, f64) {
    const GOLDEN: f64 = 0.618_033_988_749_894_8;
    let n = cross.len();
    let at = |lag: f64| {
        let turn = C64::from_polar(1.0, 2.0 * PI * lag / n as f64);
        let mut phase = C64::new(1.0, 0.0);
        let mut sum = 0.5 * cross[0].re;
        for s in &cross[1..n / 2] {
            phase *= turn;
            sum += (s * phase).re;
        }
        2.0 * sum / n as f64
    };
    let (mut low, mut high) = (around - 1.0, around + 1.0);
    let (mut left, mut right) = (high - GOLDEN * (high - low), low + GOLDEN * (high - low));
    let (mut at_left, mut at_right) = (sign * at(left), sign * at(right));
    while high - low > 1e-4 {
        if at_left > at_right {
            (high, right, at_right) = (right, left, at_left);
            left = high - GOLDEN * (high - low);
            at_left = sign * at(left);
        } else {
            (low, left, at_left) = (left, right, at_right);
            right = low + GOLDEN * (high - low);
            at_right = sign * at(right);
        }
    }
    let lag = 0.5 * (low + high);
    (lag, at(lag))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A doublet of smooth pulses and a chirp: motion that never repeats.
    fn motion(t: f64) -> f64 {
        let pulse = |at: f64| (-((t - at) / 0.3).powi(2)).exp();
        2.0 * pulse(2.0) - 2.0 * pulse(3.0) + (2.0 * PI * (0.2 + 0.1 * t) * t).sin()
    }

    fn sampled(name: &str, rate: f64, f: impl Fn(f64) -> f64) -> Series {
        Series::new(
            name,
            "",
            (0..(rate * 20.0) as usize).map(|k| k as f64 / rate).map(|t| (t, f(t))).collect(),
        )
    }

    #[test]
    fn lags_are_found_between_samples() {
        let a = sampled("a", 100.0, motion);
        for lag in [0.0, 0.081, -0.1234, 0.5] {
            let b = sampled("b", 100.0, |t| 3.0 + 2.0 * motion(t - lag));
            let found = time_offset(&a, &b, 1.0).unwrap();
            assert!((found.lag_s - lag).abs() < 1e-3, "{lag}: {found:?}");
            assert!(found.correlation > 0.95 && !found.ambiguous, "{found:?}");
        }
    }

    #[test]
    fn clocks_may_differ_and_signs_too() {
        let a = sampled("a", 200.0, motion);
        let b = sampled("b", 73.0, |t| -motion(t - 0.05));
        let found = time_offset(&a, &b, 0.5).unwrap();
        assert!((found.lag_s - 0.05).abs() < 2e-3 && found.correlation < -0.95, "{found:?}");
    }

    #[test]
    fn periodic_motion_is_ambiguous_and_none_is_an_error() {
        let wave = |t: f64| (2.0 * PI * 2.0 * t).sin();
        assert!(time_offset(&sampled("a", 100.0, wave), &sampled("b", 100.0, wave), 1.0).unwrap().ambiguous);
        let still = sampled("still", 100.0, |t| 3.0 + 0.1 * t);
        assert_eq!(
            time_offset(&sampled("a", 100.0, wave), &still, 1.0),
            Err(OffsetError::Constant("still".into()))
        );
        let short = Series::new("short", "", vec![(0.0, 1.0), (0.1, 2.0)]);
        assert!(matches!(time_offset(&still, &short, 1.0), Err(OffsetError::TooShort { .. })));
    }
}
