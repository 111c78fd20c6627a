//! A part of a record, its noise, and the time from which it stays inside a band.

use whirlstand_logs::stats::{mad_std, median, moving_average, noise_multiple, white_noise_std};

/// A part of one signal between two times, with enough samples before it to determine level and spread.
pub(crate) struct Window<'a> {
    t: &'a [f64],
    y: &'a [f64],
    from: usize,
    until: usize,
    /// Standard deviation of the white noise in the part.
    noise: f64,
}

/// The part of a [`Window`], smoothed as far as its noise makes it necessary.
pub(crate) struct Smoothed<'a> {
    /// Times, s.
    pub t: &'a [f64],
    /// Values.
    pub y: Vec<f64>,
    /// Level and spread before the part, of the equally smoothed signal.
    pub quiet: Quiet,
    /// Bound that the motion before the part and the noise in it are not expected to exceed.
    pub reach: f64,
}

impl<'a> Window<'a> {
    /// Samples with `from_s <= t <= until_s`; `None` with fewer than eight.
    pub fn new(t: &'a [f64], y: &'a [f64], from_s: f64, until_s: f64) -> Option<Self> {
        let from = t.partition_point(|&v| v < from_s - 1e-9);
        let until = t.partition_point(|&v| v <= until_s + 1e-9);
        (until >= from + 8).then(|| Self { t, y, from, until, noise: white_noise_std(&y[from..until]) })
    }

    /// Values of the part.
    pub fn values(&self) -> &'a [f64] {
        &self.y[self.from..self.until]
    }

    /// The part, averaged over just so many samples that its white noise falls to `wanted`, and at most over a
    /// fortieth of the part to either side; `quiet_s` is how far back the quiet time may reach.
    pub fn smoothed(&self, wanted: f64, quiet_s: f64) -> Smoothed<'a> {
        let n = self.until - self.from;
        let half = if self.noise <= wanted || wanted <= 0.0 {
            0
        } else {
            (((self.noise / wanted).powi(2) / 2.0).ceil() as usize).min(n / 40)
        };
        let y = moving_average(self.y, half);
        let noise = self.noise / ((2 * half + 1) as f64).sqrt();
        let quiet = quiet_before(self.t, &y, self.t[self.from], quiet_s);
        // The last samples of the record have too few neighbours to be as smooth as the rest.
        let until = self.until.min(y.len() - half);
        Smoothed {
            t: &self.t[self.from..until],
            y: y[self.from..until].to_vec(),
            quiet,
            reach: noise_multiple(n) * noise.max(quiet.std),
        }
    }
}

/// Level and spread of a signal before an event.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Quiet {
    /// Median.
    pub level: f64,
    /// Standard deviation about a straight line, robust.
    pub std: f64,
    /// Whether the signal was stationary: the medians of both halves differ by no more than a tenth of the
    /// level, or than six standard errors of a median.
    pub stands: bool,
}

/// Level and spread over up to `length_s` before `at_s`. Without a sample before it, the first one after it.
pub(crate) fn quiet_before(t: &[f64], y: &[f64], at_s: f64, length_s: f64) -> Quiet {
    let until = t.partition_point(|&v| v < at_s - 1e-9);
    let from = t.partition_point(|&v| v < at_s - length_s - 1e-9);
    let part = &y[from..until];
    if part.is_empty() {
        return Quiet { level: y.get(until).copied().unwrap_or(0.0), std: 0.0, stands: false };
    }
    if part.len() < 8 {
        return Quiet { level: median(part), std: 0.0, stands: false };
    }
    // A slope from the medians of both halves keeps a slow drift out of the spread.
    let half = part.len() / 2;
    let change = median(&part[part.len() - half..]) - median(&part[..half]);
    let slope = change / (part.len() - half) as f64;
    let straight: Vec<f64> = part.iter().enumerate().map(|(i, v)| v - slope * i as f64).collect();
    let (level, std) = (median(part), mad_std(&straight));
    // The variance of a median of n Gaussian values is pi / 2n of theirs; two medians are compared.
    let chance = 6.0 * std * (std::f64::consts::PI / half as f64).sqrt();
    Quiet { level, std, stands: change.abs() <= (0.1 * level.abs()).max(chance) }
}

/// Time from which `|error| <= band` holds until the end, interpolated; `None` when it does not hold at the end.
/// The first time when it holds all along.
pub(crate) fn last_exit(t: &[f64], error: &[f64], band: f64) -> Option<f64> {
    let Some(i) = error.iter().rposition(|e| e.is_nan() || e.abs() > band) else {
        return t.first().copied();
    };
    let (e0, e1) = (error[i].abs(), error.get(i + 1)?.abs());
    if !e0.is_finite() {
        return Some(t[i + 1]);
    }
    Some(t[i] + (t[i + 1] - t[i]) * (e0 - band) / (e0 - e1))
}

#[cfg(test)]
mod tests {
    use whirlstand_test_harness::noise;

    use super::*;

    #[test]
    fn the_last_exit_is_interpolated() {
        let t = [0.0, 1.0, 2.0, 3.0];
        assert_eq!(last_exit(&t, &[4.0, 3.0, 1.0, 0.0], 2.0), Some(1.5));
        assert_eq!(last_exit(&t, &[0.0, 0.0, 0.0, 0.0], 2.0), Some(0.0));
        assert_eq!(last_exit(&t, &[0.0, 0.0, 0.0, 3.0], 2.0), None);
        assert_eq!(last_exit(&t, &[0.0, f64::NAN, 0.0, 0.0], 2.0), Some(2.0));
    }

    #[test]
    fn quiet_level_and_spread_ignore_a_drift() {
        let t: Vec<f64> = (0..1000).map(|i| i as f64 * 0.01).collect();
        let y: Vec<f64> = noise(1000, 3).iter().enumerate().map(|(i, e)| 0.1 * e + 0.01 * i as f64).collect();
        let q = quiet_before(&t, &y, 10.0, 2.0);
        assert!((q.level - 9.0).abs() < 0.1 && (q.std - 0.1).abs() < 0.03, "{q:?}");
    }
}
