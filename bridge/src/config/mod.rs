//! The `[bridge]` table of a launch file: options of all bridges, documented in `docs/bridges.md`.

mod error;
mod link;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::arming::ArmBy;
use crate::autopilot::ardupilot::ArdupilotOptions;
use crate::autopilot::betaflight::BetaflightOptions;
use crate::autopilot::px4::Px4Options;
use crate::autopilot::{FlightOptions, RcOptions};
use crate::mixer::MixerOptions;
use crate::quantity;
use crate::sensors::SensorOptions;
pub use error::ConfigError;
pub use link::{
    AttitudeMessage, AttitudeTarget, CrsfConfig, MavlinkConfig, Output, Pace, RatesMessage, TargetKind,
};

/// Kind of bridge.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BridgeKind {
    /// A MAVLink autopilot is the vehicle.
    Mavlink,
    /// A vehicle behind a CRSF radio link.
    Crsf,
    /// PX4 in the loop flies the bench's vehicle.
    Px4Hil,
    /// ArduPilot in the loop flies the bench's vehicle.
    ArdupilotJson,
    /// Betaflight in the loop flies the bench's vehicle.
    BetaflightSitl,
}

impl BridgeKind {
    /// Every kind.
    pub const ALL: [Self; 5] =
        [Self::Mavlink, Self::Crsf, Self::Px4Hil, Self::ArdupilotJson, Self::BetaflightSitl];

    /// The name in launch files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mavlink => "mavlink",
            Self::Crsf => "crsf",
            Self::Px4Hil => "px4-hil",
            Self::ArdupilotJson => "ardupilot-json",
            Self::BetaflightSitl => "betaflight-sitl",
        }
    }

    /// True for a bridge that replaces the plant; otherwise it replaces estimator and controller.
    pub fn is_vehicle(self) -> bool {
        matches!(self, Self::Mavlink | Self::Crsf)
    }
}

impl std::fmt::Display for BridgeKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// A bridge and its options.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BridgeConfig {
    /// Kind of bridge.
    pub kind: BridgeKind,
    /// The `[bridge]` table.
    #[serde(default)]
    pub options: BridgeOptions,
}

/// The `[bridge]` table: options of all bridges, of which the one in use takes its own, so that variants can
/// change the bridge alone.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BridgeOptions {
    /// Arming and failsafe.
    pub safety: SafetyConfig,
    /// Sources of the channels; empty: roll on 1, pitch on 2, the pilot's throttle on 3 and yaw on 4.
    pub channels: Vec<ChannelConfig>,
    /// The pilot's stick.
    pub pilot: Option<PilotConfig>,
    /// Signs, scales and offsets of measurements, by name on the bus.
    pub measured: BTreeMap<String, Trim>,
    /// Options of `bridge = "mavlink"`.
    pub mavlink: Option<MavlinkConfig>,
    /// Options of `bridge = "crsf"`.
    pub crsf: Option<CrsfConfig>,
    /// Beginning and end conditions of a flight by an autopilot in the loop.
    pub flight: FlightOptions,
    /// Simulated sensors of an autopilot in the loop.
    pub sensors: SensorOptions,
    /// Mixer from the outputs of an autopilot in the loop to the vehicle's inputs.
    pub mixer: MixerOptions,
    /// Pilot's channels of an autopilot in the loop.
    pub rc: RcOptions,
    /// Options of `bridge = "px4-hil"`.
    pub px4: Px4Options,
    /// Options of `bridge = "ardupilot-json"`.
    pub ardupilot: ArdupilotOptions,
    /// Options of `bridge = "betaflight-sitl"`.
    pub betaflight: BetaflightOptions,
}

/// Options of arming and failsafe, table `[bridge.safety]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SafetyConfig {
    /// Event that arms the outputs.
    pub arm: ArmBy,
    /// Behaviour of the outputs after a failure.
    pub on_failure: OnFailure,
    /// Largest age of the attitude in flight, s.
    pub stale_s: f64,
    /// Longest time between two commands, s.
    pub command_timeout_s: f64,
    /// Longest silence of the vehicle's heartbeat, s.
    pub link_timeout_s: f64,
    /// Averaged normalised innovation squared, over its expectation, above which the estimator counts as diverged.
    pub max_innovation: f64,
    /// With `arm = "start"`: time without a failure after which the bridge rearms, s; absent: never.
    pub recover_after_s: Option<f64>,
}

impl Default for SafetyConfig {
    fn default() -> Self {
        Self {
            arm: ArmBy::Switch,
            on_failure: OnFailure::Neutral,
            stale_s: 0.25,
            command_timeout_s: 0.25,
            link_timeout_s: 3.0,
            max_innovation: 100.0,
            recover_after_s: None,
        }
    }
}

/// Behaviour of the outputs after a failure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OnFailure {
    /// The outputs go to neutral.
    Neutral,
    /// The outputs are handed over to the vehicle's own pilot or failsafe: nothing more is sent, an override
    /// is released.
    Release,
}

/// One channel, table `[[bridge.channels]]`: us = `trim_us` + `span_us` times the input over `full`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChannelConfig {
    /// Channel number, 1 to 16.
    pub channel: usize,
    /// Source: an input of the vehicle, or `pilot.roll`, `pilot.pitch`, `pilot.throttle`, `pilot.yaw`, or
    /// `pilot.N` for the pilot's channel N, or `arm` for the vehicle's arm switch; absent: the channel is
    /// `trim_us` while armed.
    #[serde(default)]
    pub from: Option<String>,
    /// Pulse width at an input of 0, us.
    #[serde(default = "middle")]
    pub trim_us: f64,
    /// Change for an input of `full`, us; negative to reverse the sign.
    #[serde(default = "span")]
    pub span_us: f64,
    /// Input that moves the channel by `span_us`; absent: the input's larger limit in the vehicle file.
    #[serde(default)]
    pub full: Option<f64>,
    /// Smallest pulse width, us.
    #[serde(default = "lowest")]
    pub lower_us: f64,
    /// Largest pulse width, us.
    #[serde(default = "highest")]
    pub upper_us: f64,
    /// Largest rate of change, us/s; absent: unlimited.
    #[serde(default)]
    pub rate_us_per_s: Option<f64>,
    /// Pulse width without a source in charge, us; absent: `trim_us`, or `lower_us` for the throttle.
    #[serde(default)]
    pub neutral_us: Option<f64>,
}

impl ChannelConfig {
    /// A channel with default values.
    pub fn new(channel: usize, from: Option<String>) -> Self {
        Self {
            channel,
            from,
            trim_us: middle(),
            span_us: span(),
            full: None,
            lower_us: lowest(),
            upper_us: highest(),
            rate_us_per_s: None,
            neutral_us: None,
        }
    }
}

/// Options of the pilot's stick, table `[bridge.pilot]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PilotConfig {
    /// Source of the stick.
    pub source: PilotSource,
    /// Serial port of an `sbus` or `crsf` receiver; name or part of the name of a gamepad.
    #[serde(default)]
    pub link: Option<String>,
    /// Channel of the roll stick.
    #[serde(default = "one")]
    pub roll: usize,
    /// Channel of the pitch stick.
    #[serde(default = "two")]
    pub pitch: usize,
    /// Channel of the throttle.
    #[serde(default = "three")]
    pub throttle: usize,
    /// Channel of the yaw stick.
    #[serde(default = "four")]
    pub yaw: usize,
    /// Channel of the arm switch.
    #[serde(default = "five")]
    pub arm: usize,
    /// Channel of the switch between manual (low) and automatic (high).
    #[serde(default = "six")]
    pub automatic: usize,
    /// Sticks with reversed sign: `roll`, `pitch`, `yaw`.
    #[serde(default)]
    pub reversed: Vec<String>,
    /// Longest silence, s.
    #[serde(default = "half")]
    pub timeout_s: f64,
}

/// Source of the pilot's stick.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PilotSource {
    /// An SBUS receiver on a serial port.
    Sbus,
    /// A CRSF receiver on a serial port.
    Crsf,
    /// `RC_CHANNELS` of the autopilot: the receiver that the vehicle carries.
    Mavlink,
    /// A gamepad or joystick of this computer.
    Gamepad,
}

/// Sign, scale and offset of a measured signal: `scale` times the measurement, plus `offset`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Trim {
    /// Factor; -1 reverses the sign.
    pub scale: f64,
    /// Added after scaling, SI.
    #[serde(deserialize_with = "quantity::any")]
    pub offset: f64,
}

impl Default for Trim {
    fn default() -> Self {
        Self { scale: 1.0, offset: 0.0 }
    }
}

fn middle() -> f64 {
    1500.0
}

fn span() -> f64 {
    500.0
}

fn lowest() -> f64 {
    1000.0
}

fn highest() -> f64 {
    2000.0
}

fn half() -> f64 {
    0.5
}

fn one() -> usize {
    1
}

fn two() -> usize {
    2
}

fn three() -> usize {
    3
}

fn four() -> usize {
    4
}

fn five() -> usize {
    5
}

fn six() -> usize {
    6
}
