//! ROS 2 messages of the relay, in the frames of REP 103: x forward, y to the left, z up. The bench's own
//! frames are those of flight: y to the right, and angles positive with the nose up and to the right.

use byteorder::{BigEndian, LittleEndian};
use cdr_encoding::{from_bytes, to_vec};
use serde::{Deserialize, Serialize};
use whirlstand_msgs as msgs;

/// CDR header: plain, little-endian, no options.
const LITTLE_ENDIAN: [u8; 4] = [0, 1, 0, 0];

/// Largest command in bytes: enough for the layout's labels, as a limit against abuse.
const LARGEST: usize = 4096;

/// A ROS 2 message type as named by its middleware.
pub trait RosType {
    /// Name in the key expressions of `rmw_zenoh`.
    const NAME: &'static str;
    /// Type hash (REP 2016), by which peers verify that they use the same layout.
    const HASH: &'static str;
}

macro_rules! ros_type {
    ($($type:ty: $name:literal, $hash:literal);+ $(;)?) => {$(
        impl RosType for $type {
            const NAME: &'static str = $name;
            const HASH: &'static str = concat!("RIHS01_", $hash);
        }
    )+};
}

ros_type!(
    Imu: "sensor_msgs::msg::dds_::Imu_",
        "7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b";
    Odometry: "nav_msgs::msg::dds_::Odometry_",
        "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0";
    TfMessage: "tf2_msgs::msg::dds_::TFMessage_",
        "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087";
    Float64MultiArray: "std_msgs::msg::dds_::Float64MultiArray_",
        "1025ddc6b9552d191f89ef1a8d2f60f3d373e28b283d8891ddcc974e8c55397f";
);

/// `builtin_interfaces/msg/Time`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Time {
    pub sec: i32,
    pub nanosec: u32,
}

impl Time {
    /// From nanoseconds since the Unix epoch.
    pub fn from_ns(ns: u64) -> Self {
        // Seconds exceed the message's range in 2038, as in all of ROS 2.
        Self { sec: (ns / 1_000_000_000) as i32, nanosec: (ns % 1_000_000_000) as u32 }
    }
}

/// `std_msgs/msg/Header`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Header {
    pub stamp: Time,
    pub frame_id: &'static str,
}

/// `geometry_msgs/msg/Vector3`, and `Point`, which has the same layout.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Vector3 {
    pub x: f64,
    pub y: f64,
    pub z: f64,
}

/// `geometry_msgs/msg/Quaternion`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Quaternion {
    pub x: f64,
    pub y: f64,
    pub z: f64,
    pub w: f64,
}

/// `sensor_msgs/msg/Imu`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Imu {
    pub header: Header,
    pub orientation: Quaternion,
    pub orientation_covariance: [f64; 9],
    pub angular_velocity: Vector3,
    pub angular_velocity_covariance: [f64; 9],
    pub linear_acceleration: Vector3,
    pub linear_acceleration_covariance: [f64; 9],
}

/// A 6 x 6 covariance, row after row.
type Covariance = [[f64; 6]; 6];

/// `nav_msgs/msg/Odometry`, with the nested pose and twist and their covariances.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Odometry {
    pub header: Header,
    pub child_frame_id: &'static str,
    pub position: Vector3,
    pub orientation: Quaternion,
    pub pose_covariance: Covariance,
    pub linear: Vector3,
    pub angular: Vector3,
    pub twist_covariance: Covariance,
}

/// `tf2_msgs/msg/TFMessage` with one transform.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TfMessage {
    pub transforms: Vec<Transform>,
}

/// `geometry_msgs/msg/TransformStamped`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Transform {
    pub header: Header,
    pub child_frame_id: &'static str,
    pub translation: Vector3,
    pub rotation: Quaternion,
}

/// `std_msgs/msg/Float64MultiArray`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Float64MultiArray {
    dim: Vec<Dimension>,
    data_offset: u32,
    /// The values.
    pub data: Vec<f64>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Dimension {
    label: String,
    size: u32,
    stride: u32,
}

/// Name of the frame in which the vehicle moves: its initial position and heading.
const WORLD: &str = "odom";

/// Name of the body frame.
const BODY: &str = "base_link";

/// Orientation of the vehicle from its angles, as rotations about the vertical, then the lateral, then the
/// longitudinal axis.
fn orientation(imu: &msgs::Imu) -> Quaternion {
    let (roll, pitch, yaw) = (imu.roll / 2.0, -imu.pitch / 2.0, -imu.yaw / 2.0);
    let ((sr, cr), (sp, cp), (sy, cy)) = (roll.sin_cos(), pitch.sin_cos(), yaw.sin_cos());
    Quaternion {
        x: sr * cp * cy - cr * sp * sy,
        y: cr * sp * cy + sr * cp * sy,
        z: cr * cp * sy - sr * sp * cy,
        w: cr * cp * cy + sr * sp * sy,
    }
}

fn rates(imu: &msgs::Imu) -> Vector3 {
    Vector3 { x: imu.roll_rate, y: -imu.pitch_rate, z: -imu.yaw_rate }
}

/// Messages published for a step.
pub fn of_step(imu: &msgs::Imu, odometry: &msgs::Odometry, stamp: Time) -> (Imu, Odometry, TfMessage) {
    let (orientation, angular) = (orientation(imu), rates(imu));
    // A first element of -1 means that there is no such measurement (sensor_msgs/msg/Imu); zeros mean an
    // unknown covariance.
    let absent = std::array::from_fn(|i| if i == 0 { -1.0 } else { 0.0 });
    let inertial = Imu {
        header: Header { stamp, frame_id: BODY },
        orientation,
        orientation_covariance: [0.0; 9],
        angular_velocity: angular,
        angular_velocity_covariance: [0.0; 9],
        linear_acceleration: Vector3::default(),
        linear_acceleration_covariance: absent,
    };
    let header = Header { stamp, frame_id: WORLD };
    let position =
        Vector3 { x: odometry.longitudinal_position, y: -odometry.lateral_position, z: odometry.height };
    let moved = Odometry {
        header,
        child_frame_id: BODY,
        position,
        orientation,
        pose_covariance: [[0.0; 6]; 6],
        linear: Vector3 {
            x: odometry.longitudinal_speed,
            y: -odometry.lateral_speed,
            z: odometry.vertical_speed,
        },
        angular,
        twist_covariance: [[0.0; 6]; 6],
    };
    let transform = Transform { header, child_frame_id: BODY, translation: position, rotation: orientation };
    (inertial, moved, TfMessage { transforms: vec![transform] })
}

/// Encodes a message as `rmw_zenoh` does.
pub fn encode(message: &impl Serialize) -> Option<Vec<u8>> {
    let body = to_vec::<_, LittleEndian>(message).ok()?;
    Some([&LITTLE_ENDIAN[..], &body].concat())
}

/// Decodes the values of a command.
///
/// # Errors
/// The error of the bytes, as the end of a sentence.
pub fn decode(bytes: &[u8]) -> Result<Vec<f64>, String> {
    if bytes.len() > LARGEST {
        return Err(format!("it has {} bytes, and at most {LARGEST} are taken", bytes.len()));
    }
    let (head, body) = bytes.split_first_chunk::<4>().ok_or("it is too short for CDR")?;
    let message: Float64MultiArray = match head {
        [0, 1, ..] => from_bytes::<_, LittleEndian>(body),
        [0, 0, ..] => from_bytes::<_, BigEndian>(body),
        _ => return Err("it is not in plain CDR".into()),
    }
    .map_err(|e| format!("it is not a std_msgs/Float64MultiArray: {e}"))?
    .0;
    let skipped = message.data_offset as usize;
    message
        .data
        .get(skipped..)
        .map(<[f64]>::to_vec)
        .ok_or_else(|| "its data_offset is behind its data".into())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn command(data: Vec<f64>, data_offset: u32) -> Float64MultiArray {
        let dim = vec![Dimension { label: "u".into(), size: 2, stride: 2 }];
        Float64MultiArray { dim, data_offset, data }
    }

    #[test]
    fn the_nose_up_is_a_turn_to_the_left_axis_backwards() {
        let imu = msgs::Imu { pitch: 0.2, pitch_rate: 0.3, ..bytemuck::Zeroable::zeroed() };
        let odometry = msgs::Odometry { lateral_position: 2.0, ..bytemuck::Zeroable::zeroed() };
        let (inertial, moved, tf) = of_step(&imu, &odometry, Time::from_ns(1_500_000_000));
        assert!((inertial.orientation.y + 0.1f64.sin()).abs() < 1e-15);
        assert_eq!(inertial.angular_velocity.y, -0.3);
        assert_eq!((moved.position.y, tf.transforms[0].translation.y), (-2.0, -2.0));
        assert_eq!(inertial.header.stamp, Time { sec: 1, nanosec: 500_000_000 });
    }

    #[test]
    fn a_command_reads_back_and_its_offset_counts() {
        let bytes = encode(&command(vec![9.0, 1.5, -2.0], 1)).unwrap();
        assert_eq!(decode(&bytes), Ok(vec![1.5, -2.0]));
        let bytes = encode(&command(vec![1.0], 2)).unwrap();
        assert!(decode(&bytes).unwrap_err().contains("data_offset"));
    }

    #[test]
    fn a_big_endian_command_reads_as_a_little_endian_one() {
        let body = to_vec::<_, BigEndian>(&command(vec![9.0, 1.5, -2.0], 1)).unwrap();
        assert_eq!(decode(&[&[0, 0, 0, 0], &body[..]].concat()), Ok(vec![1.5, -2.0]));
        // As published by hand: no labels, no offset, one value of 1.5.
        let by_hand =
            [&[0, 0, 0, 0][..], &[0; 8], &[0, 0, 0, 1], &[0; 4], &[0x3f, 0xf8, 0, 0, 0, 0, 0, 0]].concat();
        assert_eq!(decode(&by_hand), Ok(vec![1.5]));
        // Parameter lists and the second version of CDR are other encodings.
        for kind in [[0, 2], [0, 3], [0, 7], [1, 0]] {
            let framed = [&kind[..], &[0, 0], &body[..]].concat();
            assert!(decode(&framed).unwrap_err().contains("plain CDR"), "{kind:?}");
        }
    }

    /// The vector that `v` of the body is in the world.
    fn turned(q: Quaternion, v: [f64; 3]) -> [f64; 3] {
        let cross = |a: [f64; 3], b: [f64; 3]| {
            std::array::from_fn(|i| a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3])
        };
        let axis = [q.x, q.y, q.z];
        let once: [f64; 3] = cross(axis, v);
        let twice: [f64; 3] = cross(axis, once);
        std::array::from_fn(|i| v[i] + 2.0 * (q.w * once[i] + twice[i]))
    }

    #[test]
    fn angles_combine_as_yaw_then_pitch_then_roll() {
        for (roll, pitch, yaw) in
            [(0.3, 0.4, 0.0), (0.3, 0.0, 1.2), (0.0, -0.4, 1.2), (-0.3, 0.4, -2.0), (0.7, -0.2, 0.5)]
        {
            let imu = msgs::Imu { roll, pitch, yaw, ..bytemuck::Zeroable::zeroed() };
            let q = of_step(&imu, &bytemuck::Zeroable::zeroed(), Time::from_ns(0)).0.orientation;
            assert!((q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w - 1.0).abs() < 1e-12);
            // The nose is up by the pitch and right by the yaw; the left side is up by the roll, seen along the nose.
            let (nose, left) = (turned(q, [1.0, 0.0, 0.0]), turned(q, [0.0, 1.0, 0.0]));
            let want = [pitch.cos() * yaw.cos(), -pitch.cos() * yaw.sin(), pitch.sin()];
            let off = (0..3).map(|i| (nose[i] - want[i]).abs()).fold(0.0, f64::max);
            assert!(off < 1e-12, "{roll}, {pitch}, {yaw}: {nose:?}, not {want:?}");
            assert!((left[2] - roll.sin() * pitch.cos()).abs() < 1e-12, "{roll}, {pitch}, {yaw}: {left:?}");
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_a_command_or_an_error(bytes in proptest::collection::vec(any::<u8>(), 0..300), little in any::<bool>()) {
            let _ = decode(&bytes);
            let framed = [&[0, u8::from(little), 0, 0], &bytes[..]].concat();
            let _ = decode(&framed);
        }
    }
}
