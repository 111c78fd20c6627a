//! The pilot's channels, as a receiver would send them to the autopilot: neutral until the explicit arm.
//!
//! An autopilot is armed by its pilot's switch, and requires the switch off and the throttle low first, until
//! it has started. So the channels go through stages: [`Stage::Grace`] (everything low), [`Stage::Arming`]
//! (switch on, throttle low), [`Stage::Flying`] (throttle up). Disarming returns to the beginning.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::config::ConfigError;

/// Number of channels of a receiver.
pub const RC_CHANNELS: usize = 16;

/// Time with the switch on, without an armed autopilot, after which the switch goes off.
const IN_VAIN: Duration = Duration::from_secs(2);

/// Time for which the switch then stays off.
const OFF: Duration = Duration::from_millis(500);

/// Pulse of a centred stick, us.
const MIDDLE: u16 = 1500;
/// Pulse of a low throttle or switch, us.
const LOW: u16 = 1000;
/// Pulse of a high throttle or switch, us.
const HIGH: u16 = 2000;

/// Options of the pilot's channels.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RcOptions {
    /// True to arm the autopilot; otherwise the switch stays off.
    pub arm: bool,
    /// Channel of the arming switch, from 1.
    pub arm_channel: usize,
    /// Channel of the throttle, from 1.
    pub throttle_channel: usize,
    /// Throttle while flying, 0 to 1.
    pub throttle: f64,
    /// Start-up time of the autopilot with everything low, s.
    pub grace_s: f64,
    /// Time from switching on until the throttle goes up, s.
    pub arming_s: f64,
    /// Constant channels, such as a flight mode switch: number, from 1, and pulse in us.
    pub channels: BTreeMap<String, u16>,
}

impl Default for RcOptions {
    fn default() -> Self {
        Self {
            arm: false,
            arm_channel: 5,
            throttle_channel: 3,
            throttle: 0.5,
            grace_s: 8.0,
            arming_s: 1.0,
            channels: BTreeMap::new(),
        }
    }
}

/// Stage of the arming sequence.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Stage {
    /// Arming is not requested, or the autopilot is not connected.
    #[default]
    Off,
    /// Everything low, until the autopilot has started.
    Grace,
    /// Switch on, throttle low.
    Arming,
    /// Throttle up.
    Flying,
}

/// State of the pilot's channels.
#[derive(Debug, Clone, PartialEq)]
pub struct Rc {
    options: RcOptions,
    still: [u16; RC_CHANNELS],
    stage: Stage,
    since: Duration,
}

impl Default for Rc {
    fn default() -> Self {
        let mut still = [MIDDLE; RC_CHANNELS];
        still[4..].fill(LOW);
        Self { options: RcOptions::default(), still, stage: Stage::Off, since: Duration::ZERO }
    }
}

impl Rc {
    /// Channels with everything low.
    ///
    /// # Errors
    /// [`ConfigError`] for an invalid channel, pulse, throttle or time.
    pub fn new(options: RcOptions) -> Result<Self, ConfigError> {
        let wrong = |key: &str, reason: String| Err(ConfigError::new(&["rc", key], reason));
        let mut rc = Self::default();
        for (key, channel) in
            [("arm_channel", options.arm_channel), ("throttle_channel", options.throttle_channel)]
        {
            if !(1..=RC_CHANNELS).contains(&channel) {
                return wrong(key, format!("a channel from 1 to {RC_CHANNELS} is expected, not {channel}"));
            }
        }
        if options.arm_channel == options.throttle_channel {
            return wrong("arm_channel", "the switch and the throttle need channels of their own".into());
        }
        if !(0.0..=1.0).contains(&options.throttle) {
            return wrong("throttle", format!("0 to 1 is expected, not {}", options.throttle));
        }
        for (key, time) in [("grace_s", options.grace_s), ("arming_s", options.arming_s)] {
            if !(0.0..=600.0).contains(&time) {
                return wrong(key, format!("a time from 0 to 600 s is expected, not {time}"));
            }
        }
        for (name, &pulse) in &options.channels {
            let channel = name.parse::<usize>().ok().filter(|c| (1..=RC_CHANNELS).contains(c));
            let Some(channel) = channel else {
                return wrong("channels", format!("'{name}' is no channel: 1 to {RC_CHANNELS} is expected"));
            };
            if channel == options.arm_channel || channel == options.throttle_channel {
                return wrong("channels", format!("channel {channel} is the switch or the throttle"));
            }
            if !(LOW..=HIGH).contains(&pulse) {
                return wrong("channels", format!("a pulse of {LOW} to {HIGH} us is expected, not {pulse}"));
            }
            rc.still[channel - 1] = pulse;
        }
        rc.options = options;
        Ok(rc)
    }

    /// Current stage of arming.
    pub fn stage(&self) -> Stage {
        self.stage
    }

    /// The channel of the arming switch, from 1, and its pulse when it is on, us.
    pub fn switch(&self) -> (usize, u16) {
        (self.options.arm_channel, HIGH)
    }

    /// Time for which everything stays low before the switch goes on; zero where arming is not requested.
    pub fn grace(&self) -> Duration {
        if self.options.arm { Duration::from_secs_f64(self.options.grace_s) } else { Duration::ZERO }
    }

    /// Advances in time; `linked` means that the autopilot is connected, `permitted` that it may be armed.
    /// Without permission it is disarmed at once.
    pub fn turn(&mut self, linked: bool, permitted: bool, now: Duration) -> Stage {
        let spent = now.saturating_sub(self.since).as_secs_f64();
        let next = match self.stage {
            _ if !(linked && permitted && self.options.arm) => Stage::Off,
            Stage::Off => Stage::Grace,
            Stage::Grace if spent >= self.options.grace_s => Stage::Arming,
            Stage::Arming if spent >= self.options.arming_s => Stage::Flying,
            stage => stage,
        };
        if next != self.stage {
            (self.stage, self.since) = (next, now);
        }
        self.stage
    }

    /// Moves the switch off and on again when it has been on without effect for its longest time; true if it
    /// does.
    pub fn retry(&mut self, now: Duration) -> bool {
        let waited = self.stage == Stage::Flying && now.saturating_sub(self.since) >= IN_VAIN;
        if waited {
            // End of the first stage: everything low.
            let low = Duration::from_secs_f64(self.options.grace_s).saturating_sub(OFF);
            (self.stage, self.since) = (Stage::Grace, now.saturating_sub(low));
        }
        waited
    }

    /// The pulses of all channels, us.
    pub fn pulses(&self) -> [u16; RC_CHANNELS] {
        let mut pulses = self.still;
        let on = matches!(self.stage, Stage::Arming | Stage::Flying);
        pulses[self.options.arm_channel - 1] = if on { HIGH } else { LOW };
        let throttle = if self.stage == Stage::Flying { self.options.throttle } else { 0.0 };
        pulses[self.options.throttle_channel - 1] = LOW + (throttle * f64::from(HIGH - LOW)).round() as u16;
        pulses
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options() -> RcOptions {
        RcOptions { arm: true, channels: [("6".to_string(), 2000)].into(), ..RcOptions::default() }
    }

    #[test]
    fn nothing_moves_before_the_explicit_arm() {
        let mut rc = Rc::new(RcOptions::default()).unwrap();
        for s in 0..100 {
            assert_eq!(rc.turn(true, true, Duration::from_secs(s)), Stage::Off);
            assert_eq!(rc.pulses()[..6], [1500, 1500, 1000, 1500, 1000, 1000]);
        }
    }

    #[test]
    fn arming_takes_its_stages_and_ends_at_once() {
        let mut rc = Rc::new(options()).unwrap();
        let at = |ms: u64| Duration::from_millis(ms);
        assert_eq!(rc.turn(false, true, at(0)), Stage::Off);
        assert_eq!(rc.turn(true, true, at(1000)), Stage::Grace);
        assert_eq!(rc.turn(true, true, at(8999)), Stage::Grace);
        assert_eq!(rc.pulses()[2..6], [1000, 1500, 1000, 2000]);
        assert_eq!(rc.turn(true, true, at(9000)), Stage::Arming);
        assert_eq!(rc.pulses()[2..6], [1000, 1500, 2000, 2000], "switch on at low throttle");
        assert_eq!(rc.turn(true, true, at(10_000)), Stage::Flying);
        assert_eq!(rc.pulses()[2..6], [1500, 1500, 2000, 2000]);
        assert_eq!(rc.turn(true, false, at(10_001)), Stage::Off);
        assert_eq!(rc.pulses()[2..6], [1000, 1500, 1000, 2000]);
        assert_eq!(rc.turn(true, true, at(10_002)), Stage::Grace, "and from the beginning");
    }

    #[test]
    fn a_switch_that_was_on_in_vain_goes_off_and_on_again() {
        let mut rc = Rc::new(options()).unwrap();
        let at = |ms: u64| Duration::from_millis(ms);
        for ms in [0, 8000, 9000] {
            rc.turn(true, true, at(ms));
        }
        assert_eq!((rc.stage(), rc.retry(at(10_999)), rc.retry(at(11_000))), (Stage::Flying, false, true));
        assert_eq!(rc.turn(true, true, at(11_499)), Stage::Grace);
        assert_eq!(rc.pulses()[2..5], [1000, 1500, 1000], "off, throttle low");
        assert_eq!(rc.turn(true, true, at(11_500)), Stage::Arming);
        assert_eq!(rc.turn(true, true, at(12_500)), Stage::Flying);
    }

    #[test]
    fn impossible_channels_are_refused_with_their_key() {
        let refuse = |change: fn(&mut RcOptions)| {
            let mut options = options();
            change(&mut options);
            Rc::new(options).unwrap_err().to_string()
        };
        for (error, words) in [
            (refuse(|o| o.arm_channel = 17), "arm_channel: a channel from 1 to 16"),
            (refuse(|o| o.throttle_channel = 5), "channels of their own"),
            (refuse(|o| o.throttle = 1.5), "throttle: 0 to 1"),
            (refuse(|o| o.grace_s = f64::NAN), "grace_s"),
            (refuse(|o| o.channels = [("x".to_string(), 1500)].into()), "'x' is no channel"),
            (refuse(|o| o.channels = [("3".to_string(), 1500)].into()), "channel 3 is the switch"),
            (refuse(|o| o.channels = [("7".to_string(), 3000)].into()), "not 3000"),
        ] {
            assert!(error.contains(words), "{error}");
        }
    }
}
