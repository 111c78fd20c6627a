//! Noise of a record: one model per channel, which whitens residuals and signatures.

use crate::thresholds::{DECLARED_NOISE_LOG_STD, MAX_AR_ORDER};
use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;

use whirlstand_ident::identify::ar::Ar;

use whirlstand_logs::stats::rms;

use crate::data::record::{Channel, Data};
use crate::model::channel_noise::ChannelNoise;
use crate::model::innovations::Whitener;

/// Noise model of all channels.
#[derive(Debug, Clone, PartialEq)]
pub struct Noise {
    /// Models of the channels, in their order.
    pub channels: Vec<ChannelNoise>,
    /// Total standard deviation of each channel's noise, colour included.
    pub total: Vec<f64>,
    /// Joint model of turbulence and noise of all channels, used in place of the single channels' models.
    pub common: Option<Arc<Whitener>>,
    /// True for a model that is given and not fitted.
    pub given: bool,
}

/// Likelihood of a residual with the noise model that fits it best.
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// The noise model.
    pub noise: Noise,
    /// Log-likelihood, without constants.
    pub log_likelihood: f64,
    /// Number of rows that count.
    pub rows: usize,
    /// Number of parameters of the noise model.
    pub parameters: usize,
}

impl Profile {
    /// Bayesian information criterion with `parameters` further parameters of the model; smaller is better.
    pub fn bic(&self, parameters: usize) -> f64 {
        -2.0 * self.log_likelihood + (self.parameters + parameters) as f64 * (self.rows as f64).ln()
    }
}

impl Noise {
    /// White noise of the given standard deviations.
    pub fn white(stds: &[f64]) -> Self {
        Self {
            channels: stds.iter().map(|s| ChannelNoise::white(s * s)).collect(),
            total: stds.to_vec(),
            common: None,
            given: true,
        }
    }

    /// Fits the noise model to residuals (filled, all channels).
    ///
    /// The declared noise of a sensor is a prior: the logarithm of its standard deviation is normally
    /// distributed. Without it, an autoregressive model takes any offset for slow noise at hardly any cost.
    pub fn fit(data: &Data, residual: &[f64]) -> Profile {
        // A wander of any size would explain any slow misfit: it is noise where the size of the noise is known.
        Self::fit_where(data, residual, |channel| is_declared(data, channel))
    }

    /// [`Noise::fit`] as if the zero of every sensor could wander; `None` where it allows that of all anyway.
    pub fn fit_wandering(data: &Data, residual: &[f64]) -> Option<Profile> {
        let some = data.channels.iter().any(|channel| !is_declared(data, channel));
        some.then(|| Self::fit_where(data, residual, |_| true))
    }

    /// Fits the noise model, where a zero may wander in some channels.
    fn fit_where(data: &Data, residual: &[f64], may_wander: impl Fn(&Channel) -> bool + Sync) -> Profile {
        let ranges = data.ranges();
        let models = over_channels(data, |c| {
            let (channel, r) = (&data.channels[c], &residual[ranges[c].clone()]);
            let parts: Vec<Range<usize>> = data.parts(channel).collect();
            // Where a record begins after a gap, and its states are known least, the first errors are no noise.
            let settled = |part: &Range<usize>| {
                let from = if part.start == 0 { 0 } else { part.start + MAX_AR_ORDER };
                (from < part.end).then(|| &r[from..part.end])
            };
            let runs: Vec<&[f64]> = parts.iter().filter_map(settled).collect();
            let noise = ChannelNoise::fit(&runs, may_wander(channel));
            let mut white = vec![0.0; r.len()];
            parts.iter().for_each(|part| noise.filter(&r[part.clone()], &mut white[part.clone()]));
            let (mut sum, mut power, mut rows) = (0.0, 0.0, 0usize);
            for ((e, r), _) in
                white.iter().zip(r).zip(&channel.good).skip(MAX_AR_ORDER).filter(|(_, good)| **good)
            {
                sum += e * e;
                power += r * r;
                rows += 1;
            }
            let variance = (sum / rows.max(1) as f64).max(f64::MIN_POSITIVE);
            let total = (power / rows.max(1) as f64).sqrt().max(variance.sqrt());
            if rows == 0 {
                // Every sample is early: white noise of the size of what they leave.
                let known: Vec<f64> =
                    r.iter().zip(&*channel.known()).filter(|(_, k)| **k).map(|(r, _)| *r).collect();
                let total = rms(&known);
                return (ChannelNoise::white(total * total), total, rows, 0.0);
            }
            let log_det = parts.iter().map(|part| noise.log_det(part.len())).sum::<f64>();
            (noise.with_variance(variance), total, rows, log_det)
        });
        let mut profile = Profile {
            noise: Self { channels: Vec::new(), total: Vec::new(), common: None, given: false },
            log_likelihood: 0.0,
            rows: 0,
            parameters: 0,
        };
        for (channel, (noise, total, rows, log_det)) in data.channels.iter().zip(models) {
            profile.log_likelihood -= 0.5 * (rows as f64 * (noise.variance().ln() + 1.0) + log_det);
            profile.rows += rows;
            profile.parameters += noise.parameters() + 1;
            if is_declared(data, channel) {
                profile.log_likelihood -=
                    0.5 * ((total / channel.declared).ln() / DECLARED_NOISE_LOG_STD).powi(2);
            }
            profile.noise.total.push(total);
            profile.noise.channels.push(noise);
        }
        profile
    }

    /// This model with a joint model of all channels' noise.
    pub fn with_common(self, whitener: Whitener) -> Self {
        Self { common: Some(Arc::new(whitener)), given: true, ..self }
    }

    /// This model where it must not be refitted.
    pub fn shared(&self) -> Option<&Self> {
        self.given.then_some(self)
    }

    /// Likelihood of a residual (filled, all channels): with refitted models, or with a given one unchanged.
    pub fn again(&self, data: &Data, residual: &[f64]) -> Profile {
        if !self.given {
            return Self::fit(data, residual);
        }
        let (mut sum, mut rows) = (0.0, 0);
        let white = self.filter_all(data, residual);
        for (channel, range) in data.channels.iter().zip(data.ranges()) {
            for (e, _) in white[range].iter().zip(&channel.good).skip(MAX_AR_ORDER).filter(|(_, good)| **good)
            {
                sum += e * e;
                rows += 1;
            }
        }
        let steps = rows as f64 / data.channels.len().max(1) as f64;
        let (log_det, parameters) = match &self.common {
            Some(common) => (common.log_det(), common.parameters),
            None => (self.channels.iter().map(|noise| noise.variance().ln()).sum(), self.channels.len()),
        };
        Profile { noise: self.clone(), log_likelihood: -0.5 * (sum + steps * log_det), rows, parameters }
    }

    /// Whitened and normalised `samples`; 0 in rows that do not count. First rows that have no past to
    /// be predicted from, here and where a further record begins, are divided by the noise's total standard deviation:
    /// likelihoods leave them out, but fast modes of the initial state show nowhere else.
    pub fn whiten(&self, data: &Data, samples: &[f64]) -> Vec<f64> {
        let ranges = data.ranges();
        if let Some(common) = &self.common {
            return self.masked(data, samples, common.filter(data, samples));
        }
        let mut out = vec![0.0; samples.len()];
        let whiten = |(c, white): (usize, &mut [f64])| {
            let (channel, range) = (&data.channels[c], ranges[c].clone());
            let (noise, total, raw) = (&self.channels[c], self.total[c], &samples[range]);
            let Some(support) = support(raw) else { return };
            for part in data.parts(channel) {
                let within = support.start.max(part.start)..support.end.min(part.end);
                if within.start < within.end {
                    let within = within.start - part.start..within.end - part.start;
                    noise.filter_within(within, &raw[part.clone()], &mut white[part]);
                }
            }
            let over = |std: f64| if std > 0.0 { 1.0 / std } else { 0.0 };
            let (scale, early) = (over(noise.variance().sqrt()), over(total));
            let first = white.len().min(noise.unpredicted());
            white[first..].iter_mut().for_each(|e| *e *= scale);
            white[..first].iter_mut().zip(raw).for_each(|(e, raw)| *e = raw * early);
            white.iter_mut().zip(&channel.good).filter(|(_, good)| !**good).for_each(|(e, _)| *e = 0.0);
            channel.early.iter().for_each(|k| white[*k] = raw[*k] * early);
        };
        let parts = parts(&ranges, &mut out).into_iter().enumerate();
        if data.is_long() {
            parts.collect::<Vec<_>>().into_par_iter().for_each(whiten);
        } else {
            parts.for_each(whiten);
        }
        out
    }

    /// Masks rows that do not count and scales the first rows, as in [`Noise::whiten`].
    fn masked(&self, data: &Data, raw: &[f64], mut white: Vec<f64>) -> Vec<f64> {
        for ((channel, range), total) in data.channels.iter().zip(data.ranges()).zip(&self.total) {
            let early = if *total > 0.0 { 1.0 / total } else { 0.0 };
            for (k, good) in channel.good.iter().enumerate() {
                let at = range.start + k;
                if !good {
                    white[at] = 0.0;
                } else if k < MAX_AR_ORDER {
                    white[at] = raw[at] * early;
                }
            }
            channel.early.iter().for_each(|k| white[range.start + k] = raw[range.start + k] * early);
        }
        white
    }

    /// Whitens as [`Noise::whiten`], but keeps every row: for a response that is shifted in time afterwards.
    pub fn filter_all(&self, data: &Data, samples: &[f64]) -> Vec<f64> {
        if let Some(common) = &self.common {
            return common.filter(data, samples);
        }
        let mut out = vec![0.0; samples.len()];
        for (range, noise) in data.ranges().into_iter().zip(&self.channels) {
            let variance = noise.variance();
            let scale = if variance > 0.0 { 1.0 / variance.sqrt() } else { 0.0 };
            noise.filter_settled(&samples[range.clone()], &mut out[range.clone()]);
            out[range].iter_mut().for_each(|e| *e *= scale);
        }
        out
    }

    /// Total standard deviation of a channel's noise.
    pub fn std(&self, channel: usize, data: &Data, residual: &[f64]) -> f64 {
        let range = data.ranges()[channel].clone();
        let good = &data.channels[channel].good;
        let kept: Vec<f64> = residual[range].iter().zip(good).filter(|(_, g)| **g).map(|(r, _)| *r).collect();
        rms(&kept)
    }
}

/// The shortest range outside which all values are zero; none where all are.
fn support(values: &[f64]) -> Option<Range<usize>> {
    let first = values.iter().position(|v| *v != 0.0)?;
    let last = values.iter().rposition(|v| *v != 0.0)?;
    Some(first..last + 1)
}

/// True where the size of a residual's noise is known. The innovations of a predictor that follows the record exceed the noise
/// of its sensors.
fn is_declared(data: &Data, channel: &Channel) -> bool {
    data.memory_s.is_none() && channel.declared > 0.0
}

/// A result for each channel, all at once where the record is long.
fn over_channels<T: Send>(data: &Data, of: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    let channels = 0..data.channels.len();
    if data.is_long() { channels.into_par_iter().map(of).collect() } else { channels.map(of).collect() }
}

/// The parts of a vector of all samples, one per channel.
fn parts<'s>(ranges: &[Range<usize>], mut samples: &'s mut [f64]) -> Vec<&'s mut [f64]> {
    let mut parts = Vec::with_capacity(ranges.len());
    for range in ranges {
        let (part, rest) = samples.split_at_mut(range.len());
        parts.push(part);
        samples = rest;
    }
    parts
}

/// The filter A(q) applied to a sequence, with zeros before its beginning.
pub(crate) fn filtered(ar: &Ar, r: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; r.len()];
    ar.filter(r, &mut out);
    out
}
