//! Options of the links to a vehicle: `[bridge.mavlink]` and `[bridge.crsf]`.

use serde::{Deserialize, Serialize};

use crate::peer::Pin;

/// Options of a MAVLink link, table `[bridge.mavlink]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MavlinkConfig {
    /// Address of the autopilot, for example `serial:///dev/ttyACM0:921600` or `udpin://0.0.0.0:14550`.
    pub link: String,
    /// The only accepted sender on `udpin` and `tcpin`; absent: the first one with a valid message.
    #[serde(default)]
    pub peer: Option<Pin>,
    /// Kind of message that carries the outputs.
    #[serde(default)]
    pub output: Output,
    /// Serial port for `crsf` or `sbus` channels.
    #[serde(default)]
    pub output_link: Option<String>,
    /// Largest number of outputs per second; absent: one for each command.
    #[serde(default)]
    pub output_rate_hz: Option<f64>,
    /// System id of this program.
    #[serde(default = "ground_station")]
    pub system: u8,
    /// Component id of this program.
    #[serde(default = "ground_component")]
    pub component: u8,
    /// System id of the vehicle; absent: the first autopilot heard.
    #[serde(default)]
    pub target_system: Option<u8>,
    /// Requested rate of the attitude, Hz; absent: that of the loop; 0: no request.
    #[serde(default)]
    pub message_rate_hz: Option<f64>,
    /// Message with the attitude.
    #[serde(default)]
    pub attitude: AttitudeMessage,
    /// Messages with the angular rates.
    #[serde(default)]
    pub rates: RatesMessage,
    /// Heading of the longitudinal axis, rad clockwise from north; absent: the vehicle's initial heading.
    #[serde(default)]
    pub heading: Option<f64>,
    /// Pace of the loop.
    #[serde(default)]
    pub pace: Pace,
    /// Meaning of the inputs with `output = "attitude-target"`.
    #[serde(default)]
    pub attitude_target: AttitudeTarget,
    /// File with the secret key of signed links: 32 bytes as 64 hexadecimal digits, or a passphrase.
    #[serde(default)]
    pub signing_key: Option<String>,
    /// Address at which a ground station receives the vehicle through this bridge, for example
    /// `udpout://127.0.0.1:14550`.
    #[serde(default)]
    pub forward: Option<String>,
}

/// Kind of output to the vehicle.
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

/// Message with the attitude.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AttitudeMessage {
    /// `ATTITUDE`.
    #[default]
    Euler,
    /// `ATTITUDE_QUATERNION`.
    Quaternion,
}

/// Messages with the angular rates.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RatesMessage {
    /// The message with the attitude.
    #[default]
    Attitude,
    /// `HIGHRES_IMU`, or `SCALED_IMU` with its numbers 2 and 3.
    Imu,
}

/// Pace of the loop.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Pace {
    /// This computer's clock, at the rate of the loop.
    #[default]
    Clock,
    /// Each attitude when it arrives, which must be at the rate of the loop; the clock where one is missing.
    Telemetry,
}

/// Meaning of roll and pitch in `SET_ATTITUDE_TARGET`, for a channel at 1000 or 2000 us.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AttitudeTarget {
    /// Kind of target: angles or rates.
    pub kind: TargetKind,
    /// Roll and pitch at full deflection, rad or rad/s.
    pub full: f64,
    /// Yaw rate at full deflection, rad/s.
    pub full_yaw_rate: f64,
}

impl Default for AttitudeTarget {
    fn default() -> Self {
        Self { kind: TargetKind::Rates, full: 1.0, full_yaw_rate: 1.0 }
    }
}

/// Kind of target.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TargetKind {
    /// Body rates.
    Rates,
    /// Angles.
    Angles,
}

/// Options of a CRSF link, table `[bridge.crsf]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CrsfConfig {
    /// Serial port of the transmitter module, for example `serial:///dev/ttyUSB0:420000`.
    pub link: String,
    /// Largest number of channel frames per second; absent: one for each command.
    #[serde(default)]
    pub output_rate_hz: Option<f64>,
    /// Pace of the loop.
    #[serde(default)]
    pub pace: Pace,
}

fn ground_station() -> u8 {
    255
}

fn ground_component() -> u8 {
    190
}
