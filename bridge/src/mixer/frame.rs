//! Geometry of the actuators, with the effect of each on every axis.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use crate::config::ConfigError;

/// Largest number of actuator outputs of an autopilot.
pub const MAX_OUTPUTS: usize = 32;

/// Arrangement of the actuators.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FrameKind {
    /// Four motors between the axes: front right, rear left, front left, rear right. The first two turn
    /// counter-clockwise, seen from above.
    #[default]
    QuadX,
    /// Four motors on the axes: right, left, front, rear. The first two turn counter-clockwise.
    QuadPlus,
    /// A swashplate on servos at any azimuths (cyclic and collective pitch mixing); three at -60, 60 and 180 degrees by
    /// default, so front left, front right and rear.
    Ccpm,
}

/// Demands on the actuators.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Demand {
    /// Moment about the longitudinal axis.
    Roll,
    /// Moment about the lateral axis.
    Pitch,
    /// Moment about the vertical axis.
    Yaw,
    /// Force along the vertical axis.
    Vertical,
}

impl Demand {
    /// Name of the demand in configurations.
    pub fn name(self) -> &'static str {
        match self {
            Self::Roll => "roll",
            Self::Pitch => "pitch",
            Self::Yaw => "yaw",
            Self::Vertical => "vertical",
        }
    }

    /// The state whose derivative the demand changes.
    pub(super) fn state(self) -> &'static str {
        match self {
            Self::Roll => "roll_rate",
            Self::Pitch => "pitch_rate",
            Self::Yaw => "yaw_rate",
            Self::Vertical => "vertical_speed",
        }
    }
}

/// Share of each actuator in roll, pitch, yaw and collective.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    shares: Vec<[f64; 4]>,
    motors: bool,
}

impl Frame {
    /// The frame of an arrangement; `azimuths` in rad, for a swashplate only.
    ///
    /// # Errors
    /// [`ConfigError`] for azimuths that cannot tilt a swashplate.
    pub fn new(kind: FrameKind, azimuths: Option<&[f64]>) -> Result<Self, ConfigError> {
        let wrong = |reason: &str| Err(ConfigError::new(&["mixer", "azimuths"], reason));
        match (kind, azimuths) {
            (FrameKind::Ccpm, given) => {
                let third = TAU / 3.0;
                let azimuths =
                    given.map_or_else(|| vec![-third / 2.0, third / 2.0, 1.5 * third], <[f64]>::to_vec);
                if !(3..=MAX_OUTPUTS).contains(&azimuths.len()) || azimuths.iter().any(|a| !a.is_finite()) {
                    return wrong("three or more finite angles are expected, one for each servo");
                }
                match swashplate(&azimuths) {
                    Some(shares) => Ok(Self { shares, motors: false }),
                    None => wrong("servos on one line cannot tilt a swashplate to both sides: spread them"),
                }
            }
            (_, Some(_)) => wrong("only the frame \"ccpm\" has servos at azimuths: leave it out"),
            (FrameKind::QuadX, None) => Ok(Self::quad([-0.5, 0.5, 0.5, -0.5], [0.5, -0.5, 0.5, -0.5])),
            (FrameKind::QuadPlus, None) => Ok(Self::quad([-1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -1.0])),
        }
    }

    /// Number of actuators.
    pub fn count(&self) -> usize {
        self.shares.len()
    }

    /// True when the actuators are motors, from 0 to 1, and not servos, from -1 to 1.
    pub fn is_motors(&self) -> bool {
        self.motors
    }

    /// Contribution of a fully deflected actuator to a demand.
    pub fn share(&self, demand: Demand, actuator: usize) -> f64 {
        self.shares.get(actuator).map_or(0.0, |s| s[demand as usize])
    }

    /// Four motors with these shares in roll and pitch, scaled so that their largest demand is 1. The first
    /// two turn counter-clockwise, so that their drag turns the nose to the right.
    fn quad(roll: [f64; 4], pitch: [f64; 4]) -> Self {
        let shares = (0..4).map(|i| [roll[i], pitch[i], if i < 2 { 0.5 } else { -0.5 }, 0.25]);
        Self { shares: shares.collect(), motors: true }
    }
}

/// Servo i at azimuth a is raised by collective + pitch cos a - roll sin a, where a positive pitch raises the
/// front and a positive roll the left. The shares are the least-squares inverse, by the normal equations.
fn swashplate(azimuths: &[f64]) -> Option<Vec<[f64; 4]>> {
    let rows: Vec<nalgebra::RowVector3<f64>> =
        azimuths.iter().map(|a| nalgebra::RowVector3::new(-a.sin(), a.cos(), 1.0)).collect();
    let forward = nalgebra::MatrixXx3::from_rows(&rows);
    let normal = forward.transpose() * &forward;
    // So small a determinant means that the servos are on a line.
    if normal.determinant() < 1e-6 {
        return None;
    }
    let inverse = normal.try_inverse()? * forward.transpose();
    Some((0..azimuths.len()).map(|i| [inverse[(0, i)], inverse[(1, i)], 0.0, inverse[(2, i)]]).collect())
}
