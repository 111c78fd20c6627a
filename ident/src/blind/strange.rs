//! An effect outside the table at a drawn place, with a range of sizes.

use super::facts::Facts;
use super::outside::{Outside, Strange};
use super::random::Dice;
use super::sense::Noise;

/// Draws place and all but the size: least and greatest size, and the effect at size 1, to which its size is
/// proportional. `None` where the vehicle has no place for it.
pub(crate) fn draft(
    strange: Strange,
    facts: &Facts,
    noise: &Noise,
    dice: &mut Dice,
) -> Option<((f64, f64), Outside)> {
    let moving: Vec<usize> = (0..facts.u.len()).filter(|i| facts.u[*i].peak() > 0.0).collect();
    let input = *dice.one_of(&moving)?;
    let output = dice.below(facts.y.len());
    let driven: Vec<usize> = facts.dynamic.iter().copied().filter(|i| facts.force[*i] > 0.0).collect();
    let onto = *dice.one_of(&driven)?;
    let alive: Vec<usize> = (0..facts.x.len()).filter(|i| facts.x[*i].rms > 0.0).collect();
    let first = *dice.one_of(&alive)?;
    let second = *dice.one_of(&alive)?;
    let peak = facts.u[input].peak();
    let force = facts.force[onto];
    let (x, y) = (facts.x[first], facts.y[output]);
    let (sizes, size, scale) = match strange {
        Strange::AsymmetricGain => ((0.08, 0.6), dice.sign(), 1.0),
        Strange::SquaredInput => ((0.08, 0.6), dice.sign(), peak),
        Strange::InputRelay => ((0.05, 0.5), peak, 0.2 * peak),
        Strange::SwingingGain => ((0.08, 0.7), 1.0, dice.scaled(0.08, 1.0)),
        Strange::StateProduct => ((0.03, 1.0), dice.sign() * force / (x.rms * facts.x[second].rms), 1.0),
        Strange::SineSpring => ((0.03, 0.6), force, dice.between(5.0, 10.0) / x.peak()),
        Strange::SwingingStiffness => ((0.03, 0.8), force / x.rms, dice.scaled(0.1, 1.5)),
        Strange::Bilinear => ((0.03, 0.8), dice.sign() * force / (facts.u[input].rms * x.rms), 1.0),
        Strange::LimitCycle => ((0.03, 0.6), force, 0.1 * x.rms),
        Strange::SensorCreep => ((0.05, 0.8), dice.sign(), dice.scaled(2.0, 10.0)),
        Strange::SquaredSensor => ((0.05, 0.6), dice.sign() / y.peak().max(1e-12), 1.0),
        Strange::SweepingTone => ((0.1, 5.0), noise.std[output], dice.scaled(0.5, 3.0)),
    };
    Some((sizes, Outside { strange, input, output, states: (first, second), onto, size, scale }))
}
