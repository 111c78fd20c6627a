//! Options of the links to a vehicle: `[bridge.mavlink]` and `[bridge.crsf]`.

use serde::{Deserialize, Serialize};

use crate::peer::Pin;

/// `[bridge.mavlink]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MavlinkConfig {
    /// Where the autopilot is, for example `serial:///dev/ttyACM0:921600` or `udpin://0.0.0.0:14550`.
    pub link: String,
    /// The only address that is believed on `udpin` and `tcpin`; absent: the first that speaks validly.
    #[serde(default)]
    pub peer: Option<Pin>,
    /// Kind of message that carries the outputs.
    #[serde(default)]
    pub output: Output,
    /// Where `crsf` or `sbus` channels go: a serial port.
    #[serde(default)]
    pub output_link: Option<String>,
    /// Most outputs in a second; absent: one for each command.
    #[serde(default)]
    pub output_rate_hz: Option<f64>,
    /// Number of this system.
    #[serde(default = "ground_station")]
    pub system: u8,
    /// Number of this component.
    #[serde(default = "ground_component")]
    pub component: u8,
    /// Number of the vehicle; absent: the first autopilot that is heard.
    #[serde(default)]
    pub target_system: Option<u8>,
    /// Rate of the attitude that is asked for, Hz; absent: that of the loop; 0: nothing is asked for.
    #[serde(default)]
    pub message_rate_hz: Option<f64>,
    /// Which message carries the attitude.
    #[serde(default)]
    pub attitude: AttitudeMessage,
    /// Which messages carry the angular rates.
    #[serde(default)]
    pub rates: RatesMessage,
    /// Heading of the longitudinal axis, rad clockwise from north; absent: that of the vehicle at the start.
    #[serde(default)]
    pub heading: Option<f64>,
    /// What paces the loop.
    #[serde(default)]
    pub pace: Pace,
    /// What the inputs mean with `output = "attitude-target"`.
    #[serde(default)]
    pub attitude_target: AttitudeTarget,
    /// File with the secret key of signed links: 32 bytes as 64 hexadecimal digits, or a passphrase.
    #[serde(default)]
    pub signing_key: Option<String>,
    /// Where a ground station listens to the vehicle through this bridge, for example `udpout://127.0.0.1:14550`.
    #[serde(default)]
    pub forward: Option<String>,
}

/// What is sent to the vehicle.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Output {
    /// `RC_CHANNELS_OVERRIDE`.
    #[default]
    RcOverride,
    /// `MANUAL_CONTROL`.
    ManualControl,
    /// `SET_ATTITUDE_TARGET`.
    AttitudeTarget,
    /// CRSF channels to a transmitter module on a serial port.
    Crsf,
    /// SBUS channels on a serial port.
    Sbus,
}

/// The message of the attitude.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AttitudeMessage {
    /// `ATTITUDE`.
    #[default]
    Euler,
    /// `ATTITUDE_QUATERNION`.
    Quaternion,
}

/// The messages of the angular rates.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RatesMessage {
    /// The message that carries the attitude.
    #[default]
    Attitude,
    /// `HIGHRES_IMU`, or `SCALED_IMU` with its numbers 2 and 3.
    Imu,
}

/// What paces the loop.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Pace {
    /// This computer's clock, at the rate of the loop.
    #[default]
    Clock,
    /// Each attitude as it comes, which must be at the rate of the loop; the clock where one is missing.
    Telemetry,
}

/// What roll and pitch mean in `SET_ATTITUDE_TARGET`, for a channel at 1000 or 2000 us.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AttitudeTarget {
    /// Angles or rates.
    pub kind: TargetKind,
    /// Full roll and pitch, rad or rad/s.
    pub full: f64,
    /// Full yaw rate, rad/s.
    pub full_yaw_rate: f64,
}

impl Default for AttitudeTarget {
    fn default() -> Self {
        Self { kind: TargetKind::Rates, full: 1.0, full_yaw_rate: 1.0 }
    }
}

/// Angles or rates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TargetKind {
    /// Body rates.
    Rates,
    /// Angles.
    Angles,
}

/// `[bridge.crsf]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CrsfConfig {
    /// Serial port of the transmitter module, for example `serial:///dev/ttyUSB0:420000`.
    pub link: String,
    /// Most frames of channels in a second; absent: one for each command.
    #[serde(default)]
    pub output_rate_hz: Option<f64>,
    /// What paces the loop.
    #[serde(default)]
    pub pace: Pace,
}

fn ground_station() -> u8 {
    255
}

fn ground_component() -> u8 {
    190
}
