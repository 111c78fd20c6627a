//! How a vehicle's named signals travel in the fixed messages of the bus.

use whirlstand_bridge::vehicle::FIELDS;
use whirlstand_msgs::{Imu, MAX_INPUTS, MAX_STATES, Odometry, valid};
use whirlstand_vehicle::Vehicle;

use crate::error::NodeError;
use crate::gate::InputLimits;

/// Number of fields in front of those of `Odometry`.
const IMU_FIELDS: usize = 6;

/// Fields that share a validity bit.
const GROUP: usize = 3;

/// The validity bit of each group, within its message.
const GROUP_BITS: [u32; FIELDS.len() / GROUP] = [valid::FIRST, valid::SECOND, valid::FIRST, valid::SECOND];

/// The message field in which each output of a vehicle travels.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OutputMap {
    /// Field of output i, an index into [`FIELDS`].
    fields: Vec<usize>,
    odometry: bool,
}

impl OutputMap {
    /// Greatest number of outputs that a vehicle on the bus can have.
    pub const MAX_OUTPUTS: usize = FIELDS.len();

    /// The map for a vehicle.
    ///
    /// # Errors
    /// [`NodeError::NotOnBus`] when an output has no place in `Imu` or `Odometry`, or when outputs that share a
    /// validity bit have sensors of different rates.
    pub fn new(vehicle: &Vehicle) -> Result<Self, NodeError> {
        let refuse = |reason| NodeError::NotOnBus { vehicle: vehicle.name.clone(), reason };
        let mut fields = Vec::with_capacity(vehicle.outputs.len());
        for output in &vehicle.outputs {
            let field = FIELDS.iter().position(|f| *f == output.name).ok_or_else(|| {
                refuse(format!(
                    "the bus has no field for output \"{}\"; the messages imu and odometry carry {}",
                    output.name,
                    FIELDS.join(", ")
                ))
            })?;
            fields.push(field);
        }
        for (i, a) in vehicle.outputs.iter().enumerate() {
            for (j, b) in vehicle.outputs.iter().enumerate().skip(i + 1) {
                if fields[i] / GROUP == fields[j] / GROUP && a.every != b.every {
                    return Err(refuse(format!(
                        "outputs \"{}\" (every = {}) and \"{}\" (every = {}) come from one sensor on the bus and \
                         need the same rate divider",
                        a.name, a.every, b.name, b.every
                    )));
                }
            }
        }
        let odometry = fields.iter().any(|&f| f >= IMU_FIELDS);
        Ok(Self { fields, odometry })
    }

    /// Whether any output travels in `Odometry`.
    pub fn has_odometry(&self) -> bool {
        self.odometry
    }

    /// Puts measured outputs, SI, into the two messages. The caller fills in the heads.
    pub fn fill(&self, y: &[f64], fresh: &[bool], imu: &mut Imu, odometry: &mut Odometry) {
        let mut values = [0.0; FIELDS.len()];
        let mut bits = [0; GROUP_BITS.len()];
        for ((&field, &value), &fresh) in self.fields.iter().zip(y).zip(fresh) {
            values[field] = value;
            bits[field / GROUP] = if fresh { GROUP_BITS[field / GROUP] } else { 0 };
        }
        [imu.roll, imu.pitch, imu.yaw, imu.roll_rate, imu.pitch_rate, imu.yaw_rate] =
            [values[0], values[1], values[2], values[3], values[4], values[5]];
        imu.valid = bits[0] | bits[1];
        let o = odometry;
        [o.longitudinal_position, o.lateral_position, o.height] = [values[6], values[7], values[8]];
        [o.longitudinal_speed, o.lateral_speed, o.vertical_speed] = [values[9], values[10], values[11]];
        o.valid = bits[2] | bits[3];
    }

    /// Reads outputs back. An output is fresh when its validity bit is set and its value is finite; returns
    /// false when a value claimed to be fresh is not finite.
    pub fn read(&self, imu: &Imu, odometry: Option<&Odometry>, y: &mut [f64], fresh: &mut [bool]) -> bool {
        let none = Odometry { valid: 0, ..whirlstand_msgs::Message::zeroed() };
        let o = odometry.unwrap_or(&none);
        let values = [
            imu.roll,
            imu.pitch,
            imu.yaw,
            imu.roll_rate,
            imu.pitch_rate,
            imu.yaw_rate,
            o.longitudinal_position,
            o.lateral_position,
            o.height,
            o.longitudinal_speed,
            o.lateral_speed,
            o.vertical_speed,
        ];
        let bits = [imu.valid, imu.valid, o.valid, o.valid];
        let mut clean = true;
        for ((&field, value), fresh) in self.fields.iter().zip(y).zip(fresh) {
            let claimed = bits[field / GROUP] & GROUP_BITS[field / GROUP] != 0;
            let finite = values[field].is_finite();
            clean &= finite || !claimed;
            *fresh = claimed && finite;
            *value = if finite { values[field] } else { 0.0 };
        }
        clean
    }
}

/// The limits of the vehicle's inputs.
///
/// # Errors
/// [`NodeError::NotOnBus`] for more states or inputs than the messages have room for.
pub fn input_limits(vehicle: &Vehicle) -> Result<InputLimits, NodeError> {
    let refuse = |reason| NodeError::NotOnBus { vehicle: vehicle.name.clone(), reason };
    if vehicle.states.len() > MAX_STATES {
        return Err(refuse(format!(
            "it has {} states, the messages hold at most {MAX_STATES}",
            vehicle.states.len()
        )));
    }
    if vehicle.inputs.len() > MAX_INPUTS {
        return Err(refuse(format!(
            "it has {} inputs, the messages hold at most {MAX_INPUTS}",
            vehicle.inputs.len()
        )));
    }
    let mut limits =
        InputLimits { count: vehicle.inputs.len(), lower: [0.0; MAX_INPUTS], upper: [0.0; MAX_INPUTS] };
    for (i, input) in vehicle.inputs.iter().enumerate() {
        limits.lower[i] = input.lower;
        limits.upper[i] = input.upper;
    }
    Ok(limits)
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_msgs::Message;

    #[test]
    fn every_built_in_vehicle_travels_and_reads_back() {
        for name in whirlstand_vehicle::builtin_names() {
            let vehicle = Vehicle::builtin(name).unwrap();
            let map = OutputMap::new(&vehicle).unwrap();
            let n = vehicle.outputs.len();
            let y = (0..n).map(|i| 0.5 + i as f64).collect::<Vec<_>>();
            let (mut imu, mut odometry) = (Imu::zeroed(), Odometry::zeroed());
            map.fill(&y, &vec![true; n], &mut imu, &mut odometry);
            let (mut back, mut fresh) = (vec![0.0; n], vec![false; n]);
            assert!(map.read(&imu, Some(&odometry), &mut back, &mut fresh));
            assert_eq!(back, y, "{name}");
            assert!(fresh.iter().all(|f| *f), "{name}");
            assert_eq!(map.has_odometry(), odometry.valid != 0, "{name}");
            imu.roll = f64::NAN;
            assert!(!map.read(&imu, None, &mut back, &mut fresh));
            let roll = vehicle.output_index("roll").unwrap();
            assert!(!fresh[roll] && back[roll] == 0.0);
        }
    }

    #[test]
    fn what_has_no_field_is_refused_by_name() {
        let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
        vehicle.outputs[0].name = "rotor_speed".into();
        let error = OutputMap::new(&vehicle).unwrap_err().to_string();
        assert!(error.contains("rotor_speed") && error.contains("longitudinal_position"), "{error}");
        let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
        let roll = vehicle.output_index("roll").unwrap();
        vehicle.outputs[roll].every = 3;
        let error = OutputMap::new(&vehicle).unwrap_err().to_string();
        assert!(error.contains("rate divider"), "{error}");
        let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
        let input = vehicle.inputs[0].clone();
        vehicle.inputs = vec![input; 9];
        assert!(input_limits(&vehicle).unwrap_err().to_string().contains("9 inputs"));
    }
}
