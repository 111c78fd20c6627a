//! Noise of one channel: which kind explains a residual best, and its whitening filter.

use std::f64::consts::TAU;
use std::ops::Range;

use nalgebra::Complex;
use whirlstand_ident::identify::ar::Ar;

use crate::model::wander::Wander;
use crate::thresholds::MAX_AR_ORDER;

/// Noise of a channel.
#[derive(Debug, Clone, PartialEq)]
pub enum ChannelNoise {
    /// Coloured noise of any spectrum.
    Coloured(Ar),
    /// White noise on a zero that wanders.
    Wandering(Wander),
}

impl ChannelNoise {
    /// White noise of the given variance.
    pub fn white(variance: f64) -> Self {
        Self::Coloured(Ar::white(variance))
    }

    /// Fits coloured noise to the runs of a residual, or a wander where it `may_wander` and is more likely, by BIC over the
    /// rows that have a past.
    pub fn fit(runs: &[&[f64]], may_wander: bool) -> Self {
        let free = Ar::fit(runs, MAX_AR_ORDER);
        let wander = if may_wander { Wander::fit(runs) } else { None };
        let Some(wander) = wander else { return Self::Coloured(free) };
        let rows: usize = runs.iter().map(|run| run.len().saturating_sub(MAX_AR_ORDER)).sum();
        let rows = rows as f64;
        let bic = |variance: f64, parameters: usize| rows * variance.ln() + parameters as f64 * rows.ln();
        let square = |run: &&[f64]| {
            let mut white = vec![0.0; run.len()];
            free.filter(run, &mut white);
            white.iter().skip(MAX_AR_ORDER).map(|e| e * e).sum::<f64>()
        };
        let variance = runs.iter().map(square).sum::<f64>() / rows;
        let log_det: f64 = runs.iter().map(|run| wander.log_det(run.len())).sum();
        if bic(wander.variance, Wander::PARAMETERS) + log_det < bic(variance, free.order()) {
            Self::Wandering(wander)
        } else {
            Self::Coloured(free)
        }
    }

    /// Variance of the innovation, of a settled filter.
    pub fn variance(&self) -> f64 {
        match self {
            Self::Coloured(ar) => ar.variance,
            Self::Wandering(wander) => wander.variance,
        }
    }

    /// The same spectrum with another variance of the innovation.
    pub fn with_variance(self, variance: f64) -> Self {
        match self {
            Self::Coloured(ar) => Self::Coloured(Ar { variance, ..ar }),
            Self::Wandering(wander) => Self::Wandering(wander.with_variance(variance)),
        }
    }

    /// Number of free parameters besides the variance.
    pub fn parameters(&self) -> usize {
        match self {
            Self::Coloured(ar) => ar.order(),
            Self::Wandering(_) => Wander::PARAMETERS,
        }
    }

    /// True for noise without memory.
    pub fn is_white(&self) -> bool {
        matches!(self, Self::Coloured(ar) if ar.order() == 0)
    }

    /// Logarithm of the determinant of the innovations that a likelihood counts of a run of so many values, beyond settled
    /// ones.
    pub fn log_det(&self, values: usize) -> f64 {
        match self {
            Self::Coloured(_) => 0.0,
            Self::Wandering(wander) => wander.log_det(values),
        }
    }

    /// Number of first innovations that are not white, because they have too little past.
    pub fn unpredicted(&self) -> usize {
        match self {
            Self::Coloured(_) => MAX_AR_ORDER,
            Self::Wandering(_) => 0,
        }
    }

    /// Innovations of a run, each with the variance of a settled one but for the first that are [unpredicted](Self::unpredicted).
    pub fn filter(&self, run: &[f64], out: &mut [f64]) {
        match self {
            Self::Coloured(ar) => ar.filter(run, out),
            Self::Wandering(wander) => wander.filter(run, out),
        }
    }

    /// [`Self::filter`] of a run that is zero outside `support`, into an `out` of zeros.
    pub fn filter_within(&self, support: Range<usize>, run: &[f64], out: &mut [f64]) {
        match self {
            Self::Coloured(ar) => {
                // A(q) has the memory of its order, and none before the first value.
                let within = support.start..(support.end + ar.order()).min(run.len());
                ar.filter(&run[within.clone()], &mut out[within]);
            }
            Self::Wandering(wander) => wander.filter(run, out),
        }
    }

    /// Innovations of the settled filter: the same at any time.
    pub fn filter_settled(&self, run: &[f64], out: &mut [f64]) {
        match self {
            Self::Coloured(ar) => ar.filter(run, out),
            Self::Wandering(wander) => wander.filter_settled(run, out),
        }
    }

    /// Spectral density, one-sided, at a frequency in Hz.
    pub fn density(&self, f: f64, period_s: f64) -> f64 {
        match self {
            Self::Coloured(ar) => {
                let mut a = Complex::new(1.0, 0.0);
                for (i, c) in ar.coefficients.iter().enumerate() {
                    a += Complex::from_polar(*c, -TAU * f * period_s * (i + 1) as f64);
                }
                2.0 * period_s * ar.variance / a.norm_sqr()
            }
            Self::Wandering(wander) => wander.density(f, period_s),
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::thresholds::MIN_BIC_GAIN;
    use whirlstand_vehicle::Stream;

    /// White noise on a zero that wanders by as much, with a time constant in steps.
    pub fn noise(seed: u64, wander: f64, time: f64, steps: usize) -> Vec<f64> {
        let mut stream = Stream::new(seed, "wander");
        let mut zero = wander * stream.normal();
        let keep = (-1.0 / time).exp();
        (0..steps)
            .map(|_| {
                zero = keep * zero + (1.0 - keep * keep).sqrt() * wander * stream.normal();
                zero + stream.normal()
            })
            .collect()
    }

    /// Mean of ln(density) over the true one at a frequency, cycles per step.
    fn density_error(of: impl Fn(&[f64]) -> ChannelNoise, f: f64) -> f64 {
        let (time, seeds) = (250.0, 40u32);
        let decay = (-1.0f64 / time).exp();
        let open = 1.0 - 2.0 * decay * (TAU * f).cos() + decay * decay;
        let truth = 2.0 * (1.0 + (1.0 - decay * decay) / open);
        let error = |seed| (of(&noise(seed, 1.0, time, 1000)).density(f, 1.0) / truth).ln();
        (0..seeds).map(|seed| error(u64::from(seed))).sum::<f64>() / f64::from(seeds)
    }

    #[test]
    fn a_wander_of_the_size_of_the_noise_is_told_and_has_its_power() {
        for f in [1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.4] {
            let error = density_error(|values| ChannelNoise::fit(&[values], true), f);
            assert!(error.abs() < 0.4, "{f}: {error}");
        }
        // Free coefficients, each at its price, spread that power over ten times its band.
        assert!(density_error(|values| ChannelNoise::fit(&[values], false), 1e-2) > 0.8);
        let white = noise(3, 0.0, 250.0, 1000);
        assert_eq!(
            ChannelNoise::fit(&[&white], true),
            ChannelNoise::fit(&[&white], false),
            "nothing wanders"
        );
    }

    /// Twice the gain in log-likelihood of an offset, which a wandering zero must not seem to have.
    #[test]
    fn a_slow_wander_is_no_offset() {
        let steps = 800;
        let gain = |seed: u64| {
            let values = noise(seed, 1.0, 500.0, steps);
            let mut lowest = f64::INFINITY;
            let cost = |values: &[f64]| {
                let noise = ChannelNoise::fit(&[values], true);
                let mut white = vec![0.0; steps];
                noise.filter(values, &mut white);
                let sum: f64 = white[MAX_AR_ORDER..].iter().map(|e| e * e).sum();
                (steps - MAX_AR_ORDER) as f64 * sum.ln() + noise.log_det(steps)
            };
            let offsets = (-60..=60).map(|i| 0.05 * f64::from(i));
            for offset in offsets {
                lowest = lowest.min(cost(&values.iter().map(|v| v - offset).collect::<Vec<_>>()));
            }
            cost(&values) - lowest
        };
        // What BIC and the least gain of a cause require of one parameter.
        let required = (steps as f64).ln() + MIN_BIC_GAIN;
        let named = (0..200).filter(|seed| gain(*seed) > required).count();
        assert!(named == 0, "{named} of 200");
    }
}
