//! Poses of the vehicle for three-dimensional panels: the simulated, the measured and the estimated pose.
//!
//! The frames are those of REP 103, which Foxglove draws: x forward, y to the left, z up. The vehicle's own frame
//! is that of flight: y to the right, and angles positive with the nose up and to the right.

use std::collections::VecDeque;

use foxglove::messages::{FrameTransform, FrameTransforms, Quaternion, Timestamp, Vector3};

use crate::bench_info::BenchInfo;
use crate::bench_log::BenchMessage;

/// Name of the frame in which the vehicle moves: its origin and orientation are those of the start.
const WORLD: &str = "world";

/// Name of the vehicle's frame: simulated, or measured where nothing is simulated.
pub(super) const VEHICLE: &str = "vehicle";

/// Name of the frame of the measured pose.
const MEASURED: &str = "measured";

/// Name of the frame of the estimated pose.
pub(super) const ESTIMATED: &str = "estimated";

/// Greatest number of poses per second of bench time.
const RATE: f64 = 50.0;

/// Number of positions that wait for the angles of their step: more than the queue of a topic holds.
const WAITING: usize = 2048;

/// Indices of roll, pitch, yaw, longitudinal and lateral position, and height among the states.
type Places = [Option<usize>; 6];

const NAMES: [&str; 6] = ["roll", "pitch", "yaw", "longitudinal_position", "lateral_position", "height"];

/// Derives poses from messages.
pub(super) struct Poses {
    states: Places,
    /// Number of steps between two poses.
    every: u64,
    /// Measured positions by their step, the next ones last. Where topics are read one after the other, positions
    /// come before the angles.
    positions: VecDeque<(u64, [f64; 3])>,
    is_simulated: bool,
}

impl Poses {
    pub fn new(info: &BenchInfo) -> Self {
        let every = (1e9 / (RATE * info.period_ns.max(1) as f64)).ceil().max(1.0) as u64;
        Self {
            states: NAMES.map(|name| info.states.iter().position(|s| s.name == name)),
            every,
            positions: VecDeque::new(),
            is_simulated: false,
        }
    }

    /// The plant begins a new run.
    pub fn begin_run(&mut self) {
        self.positions.clear();
    }

    /// The pose in a message, at the reduced rate.
    pub fn hear(&mut self, heard: &BenchMessage) -> Option<FrameTransforms> {
        let head = *heard.head();
        if !head.step.is_multiple_of(self.every) {
            return None;
        }
        let of_states = |x: &[f64]| self.states.map(|at| at.and_then(|at| x.get(at)).copied().unwrap_or(0.0));
        let (frames, pose): (&[&str], _) = match heard {
            BenchMessage::Truth(m) => {
                self.is_simulated = true;
                (&[VEHICLE], of_states(&m.x))
            }
            BenchMessage::Estimate(m) => (&[ESTIMATED], of_states(&m.x)),
            BenchMessage::Odometry(m) => {
                if self.positions.len() == WAITING {
                    self.positions.pop_front();
                }
                let position = [m.longitudinal_position, m.lateral_position, m.height];
                self.positions.push_back((head.step, position));
                return None;
            }
            BenchMessage::Imu(m) => {
                let [x, y, z] = self.position(head.step);
                let pose = [m.roll, m.pitch, m.yaw, x, y, z];
                (if self.is_simulated { &[MEASURED] } else { &[MEASURED, VEHICLE] }, pose)
            }
            _ => return None,
        };
        let of = |frame: &&str| transform(frame, pose, head.stamp_ns);
        Some(FrameTransforms { transforms: frames.iter().map(of).collect() })
    }

    /// The measured position at a step, or the last one before it; the start where no position is measured.
    fn position(&mut self, step: u64) -> [f64; 3] {
        while self.positions.get(1).is_some_and(|next| next.0 <= step) {
            self.positions.pop_front();
        }
        self.positions.front().map_or([0.0; 3], |(_, position)| *position)
    }
}

/// Rotation by yaw, then pitch, then roll, each about the axis after the preceding rotations (Diebel, Representing
/// attitude, 2006, equation 290). Pitch and yaw have the opposite sign, for axes to the left and up.
fn turned(roll: f64, pitch: f64, yaw: f64) -> Quaternion {
    let ((sr, cr), (sp, cp), (sy, cy)) =
        ((0.5 * roll).sin_cos(), (-0.5 * pitch).sin_cos(), (-0.5 * yaw).sin_cos());
    Quaternion {
        x: sr * cp * cy - cr * sp * sy,
        y: cr * sp * cy + sr * cp * sy,
        z: cr * cp * sy - sr * sp * cy,
        w: cr * cp * cy + sr * sp * sy,
    }
}

fn transform(frame: &str, pose: [f64; 6], ns: u64) -> FrameTransform {
    let [roll, pitch, yaw, forward, right, height] = pose;
    FrameTransform {
        timestamp: Some(timestamp(ns)),
        parent_frame_id: WORLD.into(),
        child_frame_id: frame.into(),
        translation: Some(Vector3 { x: forward, y: -right, z: height }),
        rotation: Some(turned(roll, pitch, yaw)),
    }
}

/// Bench time in the type of the SDK.
pub(super) fn timestamp(ns: u64) -> Timestamp {
    let seconds = u32::try_from(ns / 1_000_000_000).unwrap_or(u32::MAX);
    Timestamp::new_checked(seconds, (ns % 1_000_000_000) as u32).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SignalInfo;
    use whirlstand_msgs::{Head, Imu, Message, Odometry, Truth};

    fn head(step: u64) -> Head {
        Head { seq: step, step, stamp_ns: step * 5_000_000 }
    }

    fn poses() -> Poses {
        let states = ["pitch", "roll"].map(|name| SignalInfo::new(name, "rad")).into();
        Poses::new(&BenchInfo { period_ns: 5_000_000, states, ..BenchInfo::default() })
    }

    #[test]
    fn a_measured_position_is_that_of_its_step_however_many_of_one_topic_come_before_the_other() {
        let mut poses = poses();
        for step in 0..40 {
            let m = Odometry { head: head(step), lateral_position: step as f64, ..Odometry::zeroed() };
            assert!(poses.hear(&m.into()).is_none());
        }
        for step in [0, 12, 36] {
            let told = poses.hear(&Imu { head: head(step), ..Imu::zeroed() }.into()).unwrap();
            assert_eq!(told.transforms[0].translation.unwrap().y, -(step as f64));
        }
    }

    #[test]
    fn the_nose_up_is_a_turn_to_the_left_axis_backwards_and_the_simulation_leads() {
        let mut poses = poses();
        let imu = |step| BenchMessage::Imu(Imu { head: head(step), pitch: 0.4, ..Imu::zeroed() });
        let told = poses.hear(&imu(0)).unwrap();
        let names: Vec<_> = told.transforms.iter().map(|t| t.child_frame_id.as_str()).collect();
        assert_eq!(names, [MEASURED, VEHICLE]);
        let q = told.transforms[0].rotation.unwrap();
        assert!((q.y + 0.2f64.sin()).abs() < 1e-12 && (q.w - 0.2f64.cos()).abs() < 1e-12, "{q:?}");
        let mut truth = Truth { head: head(0), ..Truth::zeroed() };
        truth.x[1] = 0.2;
        let told = poses.hear(&BenchMessage::Truth(truth)).unwrap();
        assert!((told.transforms[0].rotation.unwrap().x - 0.1f64.sin()).abs() < 1e-12);
        // The nose turns to the right by a quarter turn and then up by an eighth: the nose's axis points to the
        // right and up.
        let (q, v) = (turned(0.0, 45f64.to_radians(), 90f64.to_radians()), 0.5f64.sqrt());
        let nose = [
            1.0 - 2.0 * (q.y * q.y + q.z * q.z),
            2.0 * (q.x * q.y + q.w * q.z),
            2.0 * (q.x * q.z - q.w * q.y),
        ];
        let wanted = [0.0, -v, v];
        assert!(nose.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-12), "{nose:?}");
        assert!(poses.hear(&imu(1)).is_none(), "200 Hz are told at 50 Hz");
        let told = poses.hear(&imu(4)).unwrap();
        assert_eq!((told.transforms.len(), told.transforms[0].child_frame_id.as_str()), (1, MEASURED));
        assert_eq!(told.transforms[0].timestamp, Some(timestamp(20_000_000)));
    }
}
