//! Noise of a sensor beyond what the vehicle file declares.

use whirlstand_logs::stats::{mean, rms};

use crate::data::record::{Channel, Data};
use crate::model::channel_noise::ChannelNoise;
use crate::model::fit::Fit;
use crate::thresholds::{EXCESS_NOISE_RATIO, OPPOSED_AGAIN};

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
    let total = rms(&kept);
    // Part of coloured noise is predictable: it is of another kind than the declared noise.
    let white = noise.variance().sqrt() > 0.8 * total;
    let error = 1.96 / (2.0 * kept.len() as f64).sqrt();
    if white { beyond((total, error), declared) } else { None }
}

/// Excess noise of a channel whose residual also has a motion that nothing explains.
///
/// A motion goes on: its changes over two steps in a row do not oppose each other. White noise that is added to it makes them
/// do so, with a covariance that is its negative variance (Roll, J. Finance 39, 1984: increments of a random walk measured with
/// noise); further apart they still go on. The noise is at least that.
pub fn beside_a_motion(residual: &[f64], channel: &Channel, declared: f64) -> Option<ExcessNoise> {
    let change = |k: usize| -> Option<f64> {
        let both = channel.good.get(k..k + 2)?.iter().all(|good| *good);
        both.then(|| residual[k + 1] - residual[k]).filter(|change| change.is_finite())
    };
    let products = |apart: usize| -> Vec<f64> {
        let all = 0..channel.good.len();
        all.filter_map(|k| Some(-change(k)? * change(k + apart)?)).collect()
    };
    let next = products(1);
    let variance = mean(&next);
    // An oscillation that is faster than the samples show opposes itself too, and again later.
    let again = |apart: usize| mean(&products(apart)) > OPPOSED_AGAIN * variance;
    if next.len() < 2 || variance <= 0.0 || (2..=4).any(again) {
        return None;
    }
    let spread = rms(&next.iter().map(|product| product - variance).collect::<Vec<_>>());
    // Of the standard deviation, relative to it.
    let error = 1.96 * 0.5 * spread / (next.len() as f64).sqrt() / variance;
    beyond((variance.sqrt(), error), declared).filter(|_| variance.sqrt() * (1.0 - error) > declared)
}

/// Channels of which more is left than the noise that the vehicle file declares allows, each with the ratio of the two; `noise`
/// are the standard deviations by output, rounding included. None where a predictor follows the record: it leaves motions in
/// the residual.
pub fn louder_than_declared(data: &Data, fit: &Fit, noise: &[f64]) -> Vec<(usize, f64)> {
    if data.memory_s.is_some() {
        return Vec::new();
    }
    let declared = |(c, channel): (usize, &Channel)| {
        let times = fit.profile.noise.std(c, data, &fit.residual) / noise[channel.output];
        (channel.declared > 0.0 && times > EXCESS_NOISE_RATIO).then_some((c, times))
    };
    data.channels.iter().enumerate().filter_map(declared).collect()
}

/// What a total standard deviation with its relative error has beyond the declared one.
fn beyond((total, error): (f64, f64), declared: f64) -> Option<ExcessNoise> {
    let times = total / declared;
    (declared > 0.0 && times > EXCESS_NOISE_RATIO).then(|| {
        let at = |factor: f64| ((total * factor).powi(2) - declared * declared).max(0.0).sqrt();
        ExcessNoise { std: (at(1.0), at(1.0 - error), at(1.0 + error)), times }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn channel(samples: usize) -> Channel {
        let (values, good) = (vec![0.0; samples], vec![true; samples]);
        Channel { output: 0, stride: 1, first: 0, values, good, early: Vec::new(), declared: 0.01 }
    }

    /// Gusts and drifts are no noise, however large; noise beside them is found with its size.
    #[test]
    fn noise_is_told_from_a_motion_that_nothing_explains() {
        let n = 3000;
        let push = whirlstand_test_harness::noise(n, 3);
        let noise = whirlstand_test_harness::noise(n, 4);
        let walk = |x: &mut f64, push: &f64| {
            *x += 0.03 * push;
            Some(*x)
        };
        let walk: Vec<f64> = push.iter().scan(0.0, walk).collect();
        let gust = |(force, x): &mut (f64, f64), push: &f64| {
            *force += 0.1 * (push - *force);
            *x = 0.98 * *x + 0.05 * *force;
            Some(*x)
        };
        let gust: Vec<f64> = push.iter().scan((0.0, 0.0), gust).collect();
        let slow: Vec<f64> = (0..n).map(|k| 0.1 * (0.1 * k as f64).sin()).collect();
        for motion in [walk, gust, slow] {
            let with =
                |std: f64| -> Vec<f64> { motion.iter().zip(&noise).map(|(x, e)| x + std * e).collect() };
            assert_eq!(beside_a_motion(&with(0.01), &channel(n), 0.01), None);
            let found = beside_a_motion(&with(0.03), &channel(n), 0.01).unwrap();
            let true_excess = (0.03f64.powi(2) - 0.01f64.powi(2)).sqrt();
            assert!((found.std.0 / true_excess - 1.0).abs() < 0.15, "{found:?}");
            assert!(found.std.1 < true_excess && true_excess < 1.05 * found.std.2, "{found:?}");
        }
    }

    #[test]
    fn an_oscillation_faster_than_the_samples_show_is_no_noise() {
        for angle in [1.7, 2.0, 2.4, 2.8, 3.1] {
            let tone: Vec<f64> = (0..3000).map(|k| 0.1 * (angle * f64::from(k)).sin()).collect();
            assert_eq!(beside_a_motion(&tone, &channel(3000), 0.01), None, "{angle}");
        }
        assert_eq!(beside_a_motion(&[0.0, 1.0], &channel(2), 0.01), None);
    }
}
