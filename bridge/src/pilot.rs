//! The pilot's stick: channels of a receiver or a gamepad, with their meaning.

use std::time::Duration;

use crate::arming::PilotView;
use crate::config::{ConfigError, PilotConfig};

/// Number of channels of a stick.
pub const STICKS: usize = 16;

/// Pulse width from which a switch is on; its middle position is off.
const SWITCH_ON_US: f64 = 1700.0;

/// Largest distance of a neutral stick from its centre, us.
const MIDDLE_US: f64 = 25.0;

/// Valid pulse widths of a receiver, us; others are a fault.
const POSSIBLE_US: std::ops::RangeInclusive<f64> = 800.0..=2200.0;

/// Axes of the four sticks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    /// Roll; right is positive.
    Roll,
    /// Pitch; nose up is positive.
    Pitch,
    /// Throttle; up is positive.
    Throttle,
    /// Yaw; clockwise is positive.
    Yaw,
}

impl Axis {
    /// Every axis.
    pub const ALL: [Self; 4] = [Self::Roll, Self::Pitch, Self::Throttle, Self::Yaw];

    /// The name in launch files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Roll => "roll",
            Self::Pitch => "pitch",
            Self::Throttle => "throttle",
            Self::Yaw => "yaw",
        }
    }
}

/// The newest channels of the pilot.
#[derive(Debug, Clone)]
pub struct Pilot {
    config: PilotConfig,
    timeout: Duration,
    us: [f64; STICKS],
    at: Option<Duration>,
    failsafe: bool,
    refused: u64,
}

impl Pilot {
    /// A pilot without any data yet.
    ///
    /// # Errors
    /// For a channel that does not exist, a stick that cannot be reversed, or an invalid time.
    pub fn new(config: &PilotConfig) -> Result<Self, ConfigError> {
        for (key, number) in [
            ("roll", config.roll),
            ("pitch", config.pitch),
            ("throttle", config.throttle),
            ("yaw", config.yaw),
            ("arm", config.arm),
            ("automatic", config.automatic),
        ] {
            if !(1..=STICKS).contains(&number) {
                let message = format!("a channel from 1 to {STICKS} is expected, not {number}");
                return Err(ConfigError::new(&["pilot", key], message));
            }
        }
        if let Some(name) = config.reversed.iter().find(|n| !["roll", "pitch", "yaw"].contains(&n.as_str())) {
            let message = format!("roll, pitch or yaw is expected, not '{name}'");
            return Err(ConfigError::new(&["pilot", "reversed"], message));
        }
        if !(config.timeout_s > 0.0 && config.timeout_s <= 10.0) {
            let message = format!("a time above 0 and up to 10 s is expected, not {}", config.timeout_s);
            return Err(ConfigError::new(&["pilot", "timeout_s"], message));
        }
        Ok(Self {
            timeout: Duration::from_secs_f64(config.timeout_s),
            config: config.clone(),
            us: [1500.0; STICKS],
            at: None,
            failsafe: false,
            refused: 0,
        })
    }

    /// Updates the channels, us. A receiver in failsafe counts as silent. Channels beyond the range of a
    /// receiver are refused as a whole and counted.
    pub fn update(&mut self, us: &[f64], failsafe: bool, now: Duration) {
        if us.is_empty() || us.iter().any(|v| !POSSIBLE_US.contains(v)) {
            self.refused += 1;
            return;
        }
        for (held, value) in self.us.iter_mut().zip(us) {
            *held = *value;
        }
        self.failsafe = failsafe;
        self.at = Some(now);
    }

    /// Number of refused updates.
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// True while the pilot's channels are received.
    pub fn is_present(&self, now: Duration) -> bool {
        !self.failsafe && self.at.is_some_and(|at| now.saturating_sub(at) <= self.timeout)
    }

    /// The state of the stick for arming.
    pub fn view(&self, now: Duration) -> PilotView {
        let middle = |axis| (self.axis_us(axis) - 1500.0).abs() <= MIDDLE_US;
        PilotView {
            present: self.is_present(now),
            neutral: middle(Axis::Roll) && middle(Axis::Pitch),
            automatic: self.channel_us(self.config.automatic) >= SWITCH_ON_US,
        }
    }

    /// True when the arm switch is on.
    pub fn arm(&self) -> bool {
        self.channel_us(self.config.arm) >= SWITCH_ON_US
    }

    /// Pulse width of a stick, us, with its sign.
    pub fn axis_us(&self, axis: Axis) -> f64 {
        let number = match axis {
            Axis::Roll => self.config.roll,
            Axis::Pitch => self.config.pitch,
            Axis::Throttle => self.config.throttle,
            Axis::Yaw => self.config.yaw,
        };
        let us = self.channel_us(number);
        if self.config.reversed.iter().any(|n| n == axis.name()) { 3000.0 - us } else { us }
    }

    /// All channels as last received, us.
    pub fn all_us(&self) -> &[f64; STICKS] {
        &self.us
    }

    /// Pulse width of a channel, 1 to 16, us.
    pub fn channel_us(&self, number: usize) -> f64 {
        self.us.get(number.wrapping_sub(1)).copied().unwrap_or(1500.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pilot(text: &str) -> Pilot {
        let mut config: PilotConfig = serde_json::from_str(r#"{"source": "sbus"}"#).unwrap();
        config.reversed = text.split_whitespace().map(Into::into).collect();
        Pilot::new(&config).unwrap()
    }

    const NOW: Duration = Duration::from_secs(1);

    #[test]
    fn sticks_and_switches_are_those_of_the_channels() {
        let mut p = pilot("pitch");
        assert!(!p.view(NOW).present);
        p.update(&[1510.0, 1300.0, 1100.0, 1500.0, 1800.0, 1500.0], false, NOW);
        let view = p.view(NOW);
        assert!(view.present && !view.neutral && !view.automatic && p.arm());
        assert_eq!((p.axis_us(Axis::Pitch), p.axis_us(Axis::Throttle)), (1700.0, 1100.0));
        p.update(&[1510.0, 1490.0, 1100.0, 1500.0, 1000.0, 2000.0], false, NOW);
        let view = p.view(NOW);
        assert!(view.neutral && view.automatic && !p.arm());
    }

    #[test]
    fn silence_failsafe_and_nonsense_are_noticed() {
        let mut p = pilot("");
        p.update(&[1500.0; 16], false, NOW);
        assert!(p.is_present(NOW + Duration::from_millis(500)));
        assert!(!p.is_present(NOW + Duration::from_millis(501)));
        p.update(&[1500.0; 16], true, NOW);
        assert!(!p.is_present(NOW));
        for nonsense in [&[f64::NAN][..], &[1500.0, 0.0], &[65535.0], &[]] {
            p.update(nonsense, false, NOW);
        }
        assert_eq!(p.refused(), 4);
        assert!(!p.is_present(NOW), "nonsense does not bring the pilot back");
    }
}
