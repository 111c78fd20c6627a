//! The path of a command to the vehicle: limits, rate limit, static effects, backlash and delay.

use std::f64::consts::TAU;

use whirlstand_vehicle::{Effect, Input, Kind, Vehicle};

use super::hidden::value;
use super::out_of_library::{OutOfLibrary, OutOfLibraryEffect};
use super::signal::Signal;

/// Order in which the effects of one input act.
const ORDER: [Kind; 8] = [
    Kind::InputGain,
    Kind::GainDrift,
    Kind::InputBias,
    Kind::DeadZone,
    Kind::InputSaturation,
    Kind::RateLimit,
    Kind::Backlash,
    Kind::InputDelay,
];

/// The path of the commands of one input, passed piece by piece, so that the caller need not know future
/// commands.
pub(crate) struct Chain<'a> {
    limits: &'a Input,
    links: Vec<Link<'a>>,
    /// Final value of each link's output, `None` before anything has passed the link.
    ends: Vec<Option<f64>>,
}

#[derive(Clone, Copy)]
enum Link<'a> {
    /// The vehicle's own rate limit, per second.
    Rate(f64),
    Outside(&'a OutOfLibraryEffect),
    Table(&'a Effect),
}

impl<'a> Chain<'a> {
    /// The path of input `index`; `effects` are the effects at this input.
    pub fn new(
        vehicle: &'a Vehicle,
        index: usize,
        effects: &[&'a Effect],
        outside: Option<&'a OutOfLibraryEffect>,
    ) -> Self {
        let limits = &vehicle.inputs[index];
        let rate = Some(limits.rate_limit).filter(|limit| limit.is_finite()).map(Link::Rate);
        let outside = outside.filter(|o| o.input == index).map(Link::Outside);
        let table = ORDER.into_iter().flat_map(|kind| effects.iter().filter(move |e| e.kind() == kind));
        let links: Vec<Link<'a>> =
            rate.into_iter().chain(outside).chain(table.map(|e| Link::Table(e))).collect();
        Self { limits, ends: vec![None; links.len()], links }
    }

    /// Passes the commands of successive periods, the first of which begins at `from_s`, to the vehicle.
    /// Calls must be consecutive in time.
    pub fn pass(&mut self, commands: &[f64], from_s: f64, period_s: f64) -> Signal {
        let held = commands.iter().map(|u| u.max(self.limits.lower).min(self.limits.upper));
        let mut signal = Signal::held(held, period_s, self.limits.neutral()).moved(from_s);
        for (link, end) in self.links.iter().zip(&mut self.ends) {
            let goes_on = end.is_some();
            if let Some(end) = *end {
                // The link's last value is its initial state: a rate limit, a backlash or a stuck actuator
                // continues from there.
                signal = signal.resting(end);
            }
            signal = match link {
                Link::Rate(limit) => signal.limited(*limit),
                Link::Outside(effect) => out_of_library(signal, effect),
                Link::Table(effect) if goes_on && effect.kind() == Kind::InputDelay => {
                    signal.moved(value(effect, "delay_s"))
                }
                Link::Table(effect) => act(signal, effect),
            };
            *end = Some(signal.end());
        }
        signal
    }
}

fn act(signal: Signal, effect: &Effect) -> Signal {
    let get = |name| value(effect, name);
    match effect.kind() {
        Kind::InputGain => signal.affine(get("factor"), 0.0),
        Kind::GainDrift => signal.drifting(get("rate_per_s")),
        Kind::InputBias => signal.affine(1.0, get("offset")),
        Kind::DeadZone => {
            let width = get("width");
            signal.bent(&[-width, width], |u| {
                if u > width {
                    u - width
                } else if u < -width {
                    u + width
                } else {
                    0.0
                }
            })
        }
        Kind::InputSaturation => {
            let (lower, upper) = (get("lower"), get("upper"));
            signal.bent(&[lower, upper], |u| u.max(lower).min(upper))
        }
        Kind::RateLimit => signal.limited(get("limit_per_s")),
        Kind::Backlash => signal.played(get("width")),
        Kind::InputDelay => signal.delayed(get("delay_s")),
        _ => signal,
    }
}

fn out_of_library(signal: Signal, outside: &OutOfLibraryEffect) -> Signal {
    let (size, scale) = (outside.size, outside.scale);
    match outside.kind {
        OutOfLibrary::AsymmetricGain => signal.bent(&[0.0], |u| u + size * u.abs()),
        OutOfLibrary::SquaredInput => signal.curved(|_, u| u + size * u * u / scale),
        OutOfLibrary::SquareLawGain => signal.curved(|_, u| u + size * u * u.abs() / scale),
        OutOfLibrary::StickingInput => signal.sticking(size),
        OutOfLibrary::SwingingGain => signal.curved(|t, u| u * (1.0 + size * (TAU * scale * t).sin())),
        OutOfLibrary::InputRelay => signal.relayed(size, scale),
        _ => signal,
    }
}
