//! From inputs and sticks to channels: mapping, trims, limits and rates, the last stage before the wire.
//!
//! An increasing channel turns the vehicle right, nose up or clockwise; one with a negative `span_us` does
//! the opposite. The sign from an input to its channel follows from B of the vehicle file: an input that
//! accelerates its axis to the left, nose down or counter-clockwise decreases the channel.

mod sentences;

use std::time::Duration;

use crate::arming::Mode;
use crate::config::{ChannelConfig, ConfigError};
use crate::limit::{Limiter, OutputLimit};
use crate::pilot::{Axis, Pilot};
pub use sentences::Steering;

/// Number of channels on the wire.
pub const CHANNELS: usize = 16;

/// Valid pulse widths, us.
const POSSIBLE_US: std::ops::RangeInclusive<f64> = 800.0..=2200.0;

/// The channel that arms a vehicle behind an RC transmitter, from 0; the first four are sticks.
const ARM: usize = 4;

/// Pulse of a switch that is off, and of one that is on, us.
const LOW_US: f64 = 1000.0;
const HIGH_US: f64 = 2000.0;

/// Source of a channel.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Source {
    /// Index of an input of the vehicle, and the stick that replaces it in manual mode.
    Input(usize, Option<Axis>),
    /// A stick of the pilot.
    Stick(Axis),
    /// A channel of the pilot.
    Pilot(usize),
    /// The vehicle's arm switch.
    Arm,
    /// Constant, at its trim.
    Fixed,
}

#[derive(Debug, Clone)]
struct Mapped {
    index: usize,
    source: Source,
    trim_us: f64,
    /// Change for an input of 1, with the sign of B, us.
    span_us: f64,
    /// True when the channel increases for a negative rotation of the vehicle: `span_us` of the launch file
    /// is negative.
    reversed: bool,
}

/// An input of the vehicle.
#[derive(Debug, Clone, PartialEq)]
pub struct Input {
    /// Name of the channel.
    pub name: String,
    /// The larger magnitude of its limits; infinite without limits.
    pub full: f64,
    /// Acceleration about roll, pitch and yaw per unit of the input, rad/s^2.
    pub turns: [f64; 3],
}

impl Input {
    /// Index of the axis that it controls, 0 to 2: that of its name, or else the one that it accelerates
    /// most.
    pub fn axis(&self) -> Option<usize> {
        let acts = |axis: usize| self.turns[axis] != 0.0;
        let named = ANGLES.iter().position(|axis| self.name.contains(axis.name()));
        named
            .or_else(|| (0..3).max_by(|a, b| self.turns[*a].abs().total_cmp(&self.turns[*b].abs())))
            .filter(|a| acts(*a))
    }

    /// Sign of its rotation about its axis; 1 for an input without an axis.
    fn sign(&self) -> f64 {
        self.axis().map_or(1.0, |axis| self.turns[axis].signum())
    }
}

/// The rotational axes, in the order of [`Input::turns`].
pub(crate) const ANGLES: [Axis; 3] = [Axis::Roll, Axis::Pitch, Axis::Yaw];

/// Mapping to sixteen channels.
#[derive(Debug, Clone)]
pub struct Mapping {
    mapped: Vec<Mapped>,
    limiter: Limiter,
    limits: Vec<OutputLimit>,
    wanted: Vec<f64>,
    us: [f64; CHANNELS],
    in_use: [bool; CHANNELS],
    pushed: Option<(usize, f64)>,
}

/// One entry of `[[bridge.channels]]` with its index in the list.
struct Row<'a> {
    at: String,
    config: &'a ChannelConfig,
}

impl Row<'_> {
    fn wrong(&self, key: &str, message: impl Into<String>) -> ConfigError {
        ConfigError::new(&["channels", &self.at, key], message)
    }

    /// Index of the channel, from 0.
    fn index(&self) -> Result<usize, ConfigError> {
        let channel = self.config.channel;
        channel.checked_sub(1).filter(|c| *c < CHANNELS).ok_or_else(|| {
            self.wrong("channel", format!("a channel from 1 to {CHANNELS} is expected, not {channel}"))
        })
    }

    /// Source of the channel.
    fn source(&self, inputs: &[Input], has_pilot: bool) -> Result<Source, ConfigError> {
        let Some(name) = &self.config.from else { return Ok(Source::Fixed) };
        match source(name, inputs) {
            Some(Source::Stick(_) | Source::Pilot(_)) if !has_pilot => {
                Err(self.wrong("from", format!("'{name}' needs a pilot: add [bridge.pilot]")))
            }
            Some(source) => Ok(source),
            None => {
                let known = inputs.iter().map(|i| i.name.as_str()).collect::<Vec<_>>().join(", ");
                let message = format!(
                    "there is no '{name}': an input of the vehicle ({known}), pilot.roll, pilot.pitch, \
                     pilot.throttle, pilot.yaw, pilot.1 to pilot.16 or arm is expected"
                );
                Err(self.wrong("from", message))
            }
        }
    }

    /// Limits of the channel's pulses.
    fn limit(&self, source: Source) -> Result<OutputLimit, ConfigError> {
        let config = self.config;
        let neutral = config.neutral_us.unwrap_or(match source {
            Source::Stick(Axis::Throttle) | Source::Arm => config.lower_us,
            _ => config.trim_us,
        });
        let limit = OutputLimit {
            neutral,
            lower: config.lower_us,
            upper: config.upper_us,
            rate_per_s: config.rate_us_per_s.unwrap_or(f64::INFINITY),
        };
        let widths = [
            ("lower_us", config.lower_us),
            ("upper_us", config.upper_us),
            ("trim_us", config.trim_us),
            ("neutral_us", neutral),
        ];
        if let Some((key, value)) = widths.iter().find(|(_, v)| !POSSIBLE_US.contains(v)) {
            let message = format!("a pulse width from 800 to 2200 us is expected, not {value}");
            return Err(self.wrong(key, message));
        }
        if let Some((key, value)) = widths.iter().find(|(_, v)| !(limit.lower..=limit.upper).contains(v)) {
            let range = format!("{} to {} us", limit.lower, limit.upper);
            let message = format!("{value} us is not within the limits of this channel, {range}");
            return Err(self.wrong(key, message));
        }
        if limit.rate_per_s.is_nan() || limit.rate_per_s <= 0.0 {
            return Err(self.wrong("rate_us_per_s", "a rate above 0 is expected; leave it out for none"));
        }
        Ok(limit)
    }

    /// Change of the pulse width for a source of one, us.
    fn span_us(&self, source: Source, inputs: &[Input]) -> Result<f64, ConfigError> {
        if !self.config.span_us.is_finite() {
            return Err(self.wrong("span_us", "a finite number is expected"));
        }
        let (full, sign) = match source {
            Source::Input(i, _) => (self.config.full.unwrap_or(inputs[i].full), inputs[i].sign()),
            _ => (1.0, 1.0),
        };
        if !(full > 0.0 && full.is_finite()) {
            let message =
                "the input's value at full span is expected here, above 0: the vehicle file has no limits";
            return Err(self.wrong("full", message));
        }
        Ok(sign * self.config.span_us / full)
    }
}

impl Mapping {
    /// The channels of a vehicle with these inputs.
    ///
    /// # Errors
    /// For a channel or an input that does not exist, a channel used twice, an input on no channel, limits that do
    /// not hold trim and neutral.
    pub fn new(configs: &[ChannelConfig], inputs: &[Input], has_pilot: bool) -> Result<Self, ConfigError> {
        let usual = if configs.is_empty() { usual(inputs, has_pilot)? } else { Vec::new() };
        let configs = if configs.is_empty() { &usual } else { configs };
        let (mut mapped, mut limits, mut in_use) = (Vec::new(), Vec::new(), [false; CHANNELS]);
        for (i, config) in configs.iter().enumerate() {
            let row = Row { at: i.to_string(), config };
            let index = row.index()?;
            if std::mem::replace(&mut in_use[index], true) {
                return Err(row.wrong("channel", format!("channel {} is used twice", config.channel)));
            }
            let source = row.source(inputs, has_pilot)?;
            limits.push(row.limit(source)?);
            let span_us = row.span_us(source, inputs)?;
            let reversed = config.span_us < 0.0;
            mapped.push(Mapped { index, source, trim_us: config.trim_us, span_us, reversed });
        }
        for (i, Input { name, .. }) in inputs.iter().enumerate() {
            if !mapped.iter().any(|m| matches!(m.source, Source::Input(input, _) if input == i)) {
                let message = format!("no channel carries the input {name}: add one with from = \"{name}\"");
                return Err(ConfigError::new(&["channels"], message));
            }
        }
        let (limiter, wanted) = (Limiter::new(limits.clone()), vec![0.0; mapped.len()]);
        let mut new = Self { mapped, limiter, limits, wanted, us: [1500.0; CHANNELS], in_use, pushed: None };
        new.place();
        Ok(new)
    }

    /// Sets unnamed channels from 5 on as a vehicle behind an RC transmitter expects them: 5 is its arm
    /// switch, as for ExpressLRS; the others are the pilot's own, or low, where no mode is on. `switches` are
    /// the pilot's two switches for this bench, which are no modes of the vehicle.
    #[must_use]
    pub fn with_switches(mut self, switches: Option<[usize; 2]>) -> Self {
        for index in (ARM..CHANNELS).filter(|index| !self.in_use[*index]) {
            let number = index + 1;
            let source = match switches {
                _ if index == ARM => Source::Arm,
                Some(own) if !own.contains(&number) => Source::Pilot(number),
                _ => Source::Fixed,
            };
            let trim_us = LOW_US;
            let limit =
                OutputLimit { neutral: LOW_US, lower: LOW_US, upper: HIGH_US, rate_per_s: f64::INFINITY };
            self.mapped.push(Mapped { index, source, trim_us, span_us: 1.0, reversed: false });
            self.limits.push(limit);
        }
        self.limiter = Limiter::new(self.limits.clone());
        self.wanted.resize(self.mapped.len(), 0.0);
        self.place();
        self
    }

    /// The channels, us, for the mode in charge. `inputs` are the controller's, in the vehicle's order.
    pub fn apply(
        &mut self,
        mode: Mode,
        inputs: &[f64],
        pilot: Option<&Pilot>,
        now: Duration,
    ) -> &[f64; CHANNELS] {
        let pilot = pilot.filter(|p| p.is_present(now));
        for ((wanted, m), limit) in self.wanted.iter_mut().zip(&self.mapped).zip(&self.limits) {
            *wanted = match (mode, m.source) {
                (Mode::Disarmed, _) => match self.pushed {
                    Some((index, by_us)) if index == m.index => limit.neutral + by_us,
                    _ => limit.neutral,
                },
                (Mode::Automatic, Source::Input(i, _)) => {
                    m.trim_us + m.span_us * inputs.get(i).copied().unwrap_or(f64::NAN)
                }
                (Mode::Manual, Source::Input(_, Some(axis))) => pilot.map_or(limit.neutral, |p| {
                    let stick = p.axis_us(axis) - 1500.0;
                    m.trim_us + if m.reversed { -stick } else { stick }
                }),
                (_, Source::Input(..)) => limit.neutral,
                // A flying vehicle needs its throttle even when the controller has failed.
                (_, Source::Stick(axis)) => pilot.map_or(limit.neutral, |p| p.axis_us(axis)),
                (_, Source::Pilot(channel)) => pilot.map_or(limit.neutral, |p| p.channel_us(channel)),
                // After a failure it stays on only while the pilot's arm switch is on.
                (Mode::Failed(_), Source::Arm) if !pilot.is_some_and(Pilot::arm) => limit.neutral,
                (_, Source::Arm) => limit.upper,
                (_, Source::Fixed) => m.trim_us,
            };
        }
        self.limiter.apply(Some(&self.wanted), now);
        self.place();
        &self.us
    }

    /// Moves a channel, from 0, off its neutral while disarmed, or no channel.
    pub(crate) fn push(&mut self, pushed: Option<(usize, f64)>) {
        self.pushed = pushed;
    }

    /// The last channels, us; unused ones are 1500.
    pub fn us(&self) -> &[f64; CHANNELS] {
        &self.us
    }

    /// The inputs represented by the last channels: the command after limits and rates. An input without a
    /// channel is 0.
    pub fn acting(&self, inputs: &mut [f64]) {
        inputs.fill(0.0);
        for m in &self.mapped {
            if let Source::Input(i, _) = m.source
                && m.span_us != 0.0
                && let Some(input) = inputs.get_mut(i)
            {
                *input = (self.us[m.index] - m.trim_us) / m.span_us;
            }
        }
    }

    /// True for each channel in use.
    pub fn in_use(&self) -> &[bool; CHANNELS] {
        &self.in_use
    }

    /// True for each channel with a stick or channel of the pilot.
    pub fn pilots(&self) -> [bool; CHANNELS] {
        let mut pilots = [false; CHANNELS];
        for m in self.mapped.iter().filter(|m| matches!(m.source, Source::Stick(_) | Source::Pilot(_))) {
            pilots[m.index] = true;
        }
        pilots
    }

    /// True while a channel is moved off its neutral for a check.
    pub(crate) fn is_pushed(&self) -> bool {
        self.pushed.is_some()
    }

    /// Resets to neutral at once, after the outputs were handed over.
    pub fn reset(&mut self) {
        self.limiter.reset();
        self.place();
    }

    /// Number of values held by a limit or a rate.
    pub fn clamped(&self) -> u64 {
        self.limiter.clamped()
    }

    /// Longest time until the slowest channel reaches neutral, s.
    pub fn return_s(&self) -> f64 {
        self.limits.iter().map(OutputLimit::return_s).fold(0.0, f64::max)
    }

    fn place(&mut self) {
        for (m, us) in self.mapped.iter().zip(self.limiter.last()) {
            self.us[m.index] = *us;
        }
    }
}

fn source(name: &str, inputs: &[Input]) -> Option<Source> {
    if name == "arm" {
        return Some(Source::Arm);
    }
    if let Some(i) = inputs.iter().position(|n| n.name == name) {
        let stick = inputs[i].axis().map(|axis| ANGLES[axis]);
        let stick = stick.or_else(|| ANGLES.into_iter().find(|a| name.contains(a.name())));
        return Some(Source::Input(i, stick));
    }
    let stick = name.strip_prefix("pilot.")?;
    let axis = Axis::ALL.into_iter().find(|a| a.name() == stick).map(Source::Stick);
    axis.or_else(|| stick.parse().ok().filter(|n| (1..=CHANNELS).contains(n)).map(Source::Pilot))
}

/// Aileron, elevator, throttle, rudder: the order of most receivers.
fn usual(inputs: &[Input], has_pilot: bool) -> Result<Vec<ChannelConfig>, ConfigError> {
    let mut channels = Vec::new();
    for Input { name, .. } in inputs {
        let number = match name.as_str() {
            "u_roll" => 1,
            "u_pitch" => 2,
            "u_yaw" => 4,
            _ => {
                let message =
                    format!("the input {name} has no default channel: set it with [[bridge.channels]]");
                return Err(ConfigError::new(&["channels"], message));
            }
        };
        channels.push(ChannelConfig::new(number, Some(name.clone())));
    }
    for (number, name) in [(3, "pilot.throttle"), (4, "pilot.yaw")] {
        if has_pilot && channels.iter().all(|c| c.channel != number) {
            channels.push(ChannelConfig::new(number, Some(name.into())));
        }
    }
    Ok(channels)
}

#[cfg(test)]
mod tests;
