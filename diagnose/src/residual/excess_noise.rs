//! Noise of a sensor beyond what the vehicle file declares.

use crate::data::record::Data;
use crate::model::channel_noise::ChannelNoise;
use crate::thresholds::EXCESS_NOISE_RATIO;

/// White noise of a channel in excess of the declared noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExcessNoise {
    /// Standard deviation of the additional noise, with its 95 % interval, SI.
    pub std: (f64, f64, f64),
    /// Ratio of the total to the declared standard deviation.
    pub times: f64,
}

/// Excess noise of a channel whose noise is more than twice the declared one and about white.
pub fn excess_noise(
    data: &Data,
    residual: &[f64],
    noise: &ChannelNoise,
    channel: usize,
    declared: f64,
) -> Option<ExcessNoise> {
    let range = data.ranges()[channel].clone();
    let good = &data.channels[channel].good;
    let kept: Vec<f64> = residual[range].iter().zip(good).filter(|(_, g)| **g).map(|(r, _)| *r).collect();
    let total = whirlstand_logs::stats::rms(&kept);
    let times = total / declared;
    // Part of coloured noise is predictable: it is of another kind than the declared noise.
    let white = noise.variance().sqrt() > 0.8 * total;
    (declared > 0.0 && times > EXCESS_NOISE_RATIO && white).then(|| {
        let at = |factor: f64| ((total * factor).powi(2) - declared * declared).max(0.0).sqrt();
        let error = 1.96 / (2.0 * kept.len() as f64).sqrt();
        ExcessNoise { std: (at(1.0), at(1.0 - error), at(1.0 + error)), times }
    })
}
