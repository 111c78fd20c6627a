//! Commands that a pilot or a test engineer would give: drawn, scaled and sampled.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use super::random::Dice;

/// Kind of excitation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Excitation {
    /// A step to each side, one input after the other, again and again.
    Doublets,
    /// Steps of 3, 2, 1 and 1 units of time to alternating sides.
    Steps3211,
    /// Sine of rising or falling frequency.
    Sweep,
    /// Band-limited random motion, as of a pilot's hand.
    Pilot,
    /// Given by the user.
    Given,
}

impl Excitation {
    /// Name, for tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Doublets => "doublets",
            Self::Steps3211 => "3-2-1-1",
            Self::Sweep => "sweep",
            Self::Pilot => "pilot",
            Self::Given => "given",
        }
    }

    /// One of the drawn kinds.
    pub(crate) fn draw(dice: &mut Dice) -> Self {
        [Self::Doublets, Self::Steps3211, Self::Sweep, Self::Pilot][dice.below(4)]
    }

    /// `inputs` commands between -1 and 1, of `samples` samples. `highest_hz`: what the vehicle can follow.
    pub(crate) fn commands(
        self,
        inputs: usize,
        samples: usize,
        period_s: f64,
        highest_hz: f64,
        dice: &mut Dice,
    ) -> Vec<Vec<f64>> {
        match self {
            Self::Doublets => steps(inputs, samples, period_s, highest_hz, &[1.0, 1.0], dice),
            Self::Steps3211 => steps(inputs, samples, period_s, highest_hz, &[3.0, 2.0, 1.0, 1.0], dice),
            Self::Sweep => sweeps(inputs, samples, period_s, highest_hz, dice),
            Self::Pilot | Self::Given => pilot(inputs, samples, period_s, highest_hz, dice),
        }
    }
}

/// Manoeuvres of steps to alternating sides, the inputs in turn, with pauses between.
fn steps(
    inputs: usize,
    samples: usize,
    period_s: f64,
    highest_hz: f64,
    lengths: &[f64],
    dice: &mut Dice,
) -> Vec<Vec<f64>> {
    let mut all = vec![vec![0.0; samples]; inputs];
    let mut k = (dice.between(0.3, 1.5) / period_s) as usize;
    let mut turn = 0;
    while k < samples {
        let unit_s = dice.between(0.25, 1.0) / highest_hz;
        let mut level = dice.sign() * dice.between(0.5, 1.0);
        for length in lengths {
            let end = k + ((length * unit_s / period_s).round() as usize).max(1);
            for value in all[turn % inputs].iter_mut().take(end).skip(k) {
                *value = level;
            }
            k = end;
            level = -level;
        }
        k += (dice.between(0.3, 2.0) * unit_s / period_s) as usize;
        turn += 1;
    }
    all
}

/// Sweeps in the logarithm of the frequency, one input up while the next goes down.
fn sweeps(inputs: usize, samples: usize, period_s: f64, highest_hz: f64, dice: &mut Dice) -> Vec<Vec<f64>> {
    let duration = samples as f64 * period_s;
    let lowest = (highest_hz * dice.between(0.03, 0.08)).max(1.5 / duration);
    let highest = highest_hz.max(2.0 * lowest);
    let rate = (highest / lowest).ln() / duration;
    let fade = (0.5 / lowest).min(0.05 * duration);
    let sweep = |falling: bool| -> Vec<f64> {
        let phase = |t: f64| TAU * lowest * ((rate * t).exp() - 1.0) / rate;
        (0..samples)
            .map(|k| {
                let t = k as f64 * period_s;
                let along = if falling { duration - t } else { t };
                (t / fade).min(1.0) * phase(along).sin()
            })
            .collect()
    };
    (0..inputs).map(|i| sweep(i % 2 == 1)).collect()
}

/// White noise behind two lags, of unit peak four standard deviations wide at most.
fn pilot(inputs: usize, samples: usize, period_s: f64, highest_hz: f64, dice: &mut Dice) -> Vec<Vec<f64>> {
    let decay = (-TAU * 0.5 * highest_hz * period_s).exp();
    let mut one = || -> Vec<f64> {
        let (mut first, mut second) = (0.0, 0.0);
        let raw: Vec<f64> = (0..samples)
            .map(|_| {
                first = decay * first + (1.0 - decay) * dice.normal();
                second = decay * second + (1.0 - decay) * first;
                second
            })
            .collect();
        let rms = (raw.iter().map(|x| x * x).sum::<f64>() / samples.max(1) as f64).sqrt().max(1e-12);
        raw.iter().map(|x| (x / rms * 0.4).clamp(-1.0, 1.0)).collect()
    };
    (0..inputs).map(|_| one()).collect()
}
