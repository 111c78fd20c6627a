//! Draws an effect outside the table at a random place, with a range of sizes.

use super::facts::Facts;
use super::out_of_library::{OutOfLibrary, OutOfLibraryEffect};
use super::random::RandomStream;
use super::ranges::{Interval, OutOfLibraryRange};
use super::sense::Noise;

/// Draws the place and all parameters except the size. Returns the least and greatest size, and the effect at
/// size 1, to which its size is proportional; `None` where the vehicle has no place for it.
pub(crate) fn draft(
    range: &OutOfLibraryRange,
    facts: &Facts,
    noise: &Noise,
    stream: &mut RandomStream,
) -> Option<(Interval, OutOfLibraryEffect)> {
    use OutOfLibrary as O;
    let moving: Vec<usize> = (0..facts.u.len()).filter(|i| facts.u[*i].peak() > 0.0).collect();
    let input = *stream.one_of(&moving)?;
    let output = stream.below(facts.y.len());
    let driven: Vec<usize> = facts.dynamic.iter().copied().filter(|i| facts.force[*i] > 0.0).collect();
    let mut onto = *stream.one_of(&driven)?;
    let alive: Vec<usize> = (0..facts.x.len()).filter(|i| facts.x[*i].rms > 0.0).collect();
    let first = *stream.one_of(&alive)?;
    let second = *stream.one_of(&alive)?;
    let mut other_input = input;
    let peak = facts.u[input].peak();
    let (x, y) = (facts.x[first], facts.y[output]);
    if range.kind == O::SelfExcitation {
        onto = *stream.one_of(&alive.into_iter().filter(|i| driven.contains(i)).collect::<Vec<_>>())?;
    }
    let force = facts.force[onto];
    let (size, scale) = match range.kind {
        O::AsymmetricGain => (stream.sign(), 1.0),
        O::SquaredInput | O::SquareLawGain => (stream.sign(), peak),
        O::InputRelay => (peak, stream.scaled_within(range.scale) * peak),
        O::SwingingGain => (1.0, stream.scaled_within(range.scale)),
        O::StickingInput => (peak, 1.0),
        O::InputProduct => {
            let others: Vec<usize> = moving.into_iter().filter(|i| *i != input).collect();
            other_input = *stream.one_of(&others)?;
            (stream.sign() * force / (facts.u[input].rms * facts.u[other_input].rms), 1.0)
        }
        O::StateProduct => (stream.sign() * force / (x.rms * facts.x[second].rms), 1.0),
        O::SineSpring => (force, stream.within(range.scale) / x.peak()),
        O::YieldingSpring => (force, stream.scaled_within(range.scale) * x.peak()),
        O::SwingingStiffness => (force / x.rms, stream.scaled_within(range.scale)),
        O::StiffnessRamp => (stream.sign() * force / x.rms, 1.0),
        O::Bilinear => (stream.sign() * force / (facts.u[input].rms * x.rms), 1.0),
        O::SelfExcitation => {
            let own = facts.x[onto].rms;
            (force / own, stream.scaled_within(range.scale) * own)
        }
        O::LimitCycle => (force, stream.scaled_within(range.scale) * x.rms),
        O::SensorCreep => (stream.sign(), stream.scaled_within(range.scale)),
        O::SlewingSensor => (1.0, stream.scaled_within(range.scale) * y.rms),
        O::SquaredSensor => (stream.sign() / y.peak().max(1e-12), 1.0),
        O::CubedSensor => (stream.sign() / y.peak().max(1e-12).powi(2), 1.0),
        O::SweepingTone => (noise.std[output], stream.scaled_within(range.scale)),
    };
    let dead_time_s = stream.within(range.dead_time_s);
    let (kind, states) = (range.kind, (first, second));
    Some((
        range.size,
        OutOfLibraryEffect { kind, input, other_input, output, states, onto, size, scale, dead_time_s },
    ))
}
