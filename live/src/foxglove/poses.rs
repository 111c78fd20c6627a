//! Where the vehicle is, for a panel that draws in three dimensions: as it is simulated, as it is measured, and as it is believed to be.
//!
//! Frames are those of REP 103, as Foxglove draws them: x forward, y to the left, z up. Ours are those of flight: y to the right, and
//! angles positive with the nose up and to the right.

use foxglove::messages::{FrameTransform, FrameTransforms, Quaternion, Timestamp, Vector3};
use nalgebra::UnitQuaternion;
use whirlstand_vehicle::Vehicle;

use crate::heard::Heard;

/// The frame in which the vehicle moves: where it started, as it was turned.
const WORLD: &str = "world";

/// As it is: simulated, or measured where nothing is simulated.
pub(super) const VEHICLE: &str = "vehicle";

/// As the sensors have it.
const MEASURED: &str = "measured";

/// As the estimator believes.
pub(super) const ESTIMATED: &str = "estimated";

/// Poses that are told in a second of bench time, at most.
const RATE: f64 = 50.0;

/// Where roll, pitch, yaw, longitudinal and lateral position, and height stand among the states.
type Places = [Option<usize>; 6];

const NAMES: [&str; 6] = ["roll", "pitch", "yaw", "longitudinal_position", "lateral_position", "height"];

/// Makes poses of messages.
pub(super) struct Poses {
    states: Places,
    /// Every so many steps.
    every: u64,
    /// Measured angles and positions.
    measured: [f64; 6],
    is_simulated: bool,
}

impl Poses {
    pub fn new(vehicle: &Vehicle, period_s: f64) -> Self {
        let every = (1.0 / (RATE * period_s)).ceil().max(1.0) as u64;
        Self {
            states: NAMES.map(|name| vehicle.state_index(name)),
            every,
            measured: [0.0; 6],
            is_simulated: false,
        }
    }

    /// What a message says of the pose, now and then.
    pub fn hear(&mut self, heard: &Heard) -> Option<FrameTransforms> {
        let head = *heard.head();
        let is_due = head.step.is_multiple_of(self.every);
        let of_states = |x: &[f64]| self.states.map(|at| at.map_or(0.0, |at| x[at]));
        let (frames, pose): (&[&str], _) = match heard {
            Heard::Truth(m) => {
                self.is_simulated = true;
                (&[VEHICLE], of_states(&m.x))
            }
            Heard::Estimate(m) => (&[ESTIMATED], of_states(&m.x)),
            Heard::Odometry(m) => {
                self.measured[3..].copy_from_slice(&[m.longitudinal_position, m.lateral_position, m.height]);
                return None;
            }
            Heard::Imu(m) => {
                self.measured[..3].copy_from_slice(&[m.roll, m.pitch, m.yaw]);
                (if self.is_simulated { &[MEASURED] } else { &[MEASURED, VEHICLE] }, self.measured)
            }
            _ => return None,
        };
        if !is_due {
            return None;
        }
        let of = |frame: &&str| transform(frame, pose, head.stamp_ns);
        Some(FrameTransforms { transforms: frames.iter().map(of).collect() })
    }
}

fn transform(frame: &str, pose: [f64; 6], ns: u64) -> FrameTransform {
    let [roll, pitch, yaw, forward, right, height] = pose;
    let q = UnitQuaternion::from_euler_angles(roll, -pitch, -yaw);
    FrameTransform {
        timestamp: Some(timestamp(ns)),
        parent_frame_id: WORLD.into(),
        child_frame_id: frame.into(),
        translation: Some(Vector3 { x: forward, y: -right, z: height }),
        rotation: Some(Quaternion { x: q.i, y: q.j, z: q.k, w: q.w }),
    }
}

/// Bench time as the SDK has it.
pub(super) fn timestamp(ns: u64) -> Timestamp {
    let seconds = u32::try_from(ns / 1_000_000_000).unwrap_or(u32::MAX);
    Timestamp::new_checked(seconds, (ns % 1_000_000_000) as u32).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_msgs::{Head, Imu, Message, Truth};

    fn head(step: u64) -> Head {
        Head { seq: step, step, stamp_ns: step * 5_000_000 }
    }

    #[test]
    fn the_nose_up_is_a_turn_to_the_left_axis_backwards_and_the_simulation_leads() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let mut poses = Poses::new(&vehicle, 0.005);
        let imu = |step| Heard::Imu(Imu { head: head(step), pitch: 0.4, ..Imu::zeroed() });
        let told = poses.hear(&imu(0)).unwrap();
        let names: Vec<_> = told.transforms.iter().map(|t| t.child_frame_id.as_str()).collect();
        assert_eq!(names, [MEASURED, VEHICLE]);
        let q = told.transforms[0].rotation.unwrap();
        assert!((q.y + 0.2f64.sin()).abs() < 1e-12 && (q.w - 0.2f64.cos()).abs() < 1e-12, "{q:?}");
        let mut truth = Truth { head: head(0), ..Truth::zeroed() };
        truth.x[vehicle.state_index("roll").unwrap()] = 0.2;
        let told = poses.hear(&Heard::Truth(truth)).unwrap();
        assert!((told.transforms[0].rotation.unwrap().x - 0.1f64.sin()).abs() < 1e-12);
        assert!(poses.hear(&imu(1)).is_none(), "200 Hz are told at 50 Hz");
        let told = poses.hear(&imu(4)).unwrap();
        assert_eq!((told.transforms.len(), told.transforms[0].child_frame_id.as_str()), (1, MEASURED));
        assert_eq!(told.transforms[0].timestamp, Some(timestamp(20_000_000)));
    }
}
