//! Mapping of a vehicle's named signals to the fixed messages of the bus.

use whirlstand_bridge::vehicle::FIELDS;
use whirlstand_msgs::{Head, Imu, MAX_INPUTS, MAX_OUTPUTS, MAX_STATES, Message, Odometry, Outputs, valid};
use whirlstand_vehicle::Vehicle;

use crate::error::NodeError;
use crate::gate::InputLimits;

/// Number of `Imu` fields, which come before those of `Odometry`.
const IMU_FIELDS: usize = 6;

/// Number of fields that share a validity bit.
const GROUP: usize = 3;

/// The validity bit of each group, within its message.
const GROUP_BITS: [u32; FIELDS.len() / GROUP] = [valid::FIRST, valid::SECOND, valid::FIRST, valid::SECOND];

/// Measurements of all sensors at one step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measurement {
    /// Attitude and rates; every step has this message, because the others wait for it.
    pub imu: Imu,
    /// Position and velocity.
    pub odometry: Odometry,
    /// Outputs without a named field.
    pub outputs: Outputs,
}

impl Measurement {
    /// An empty measurement.
    pub fn zeroed() -> Self {
        Self { imu: Imu::zeroed(), odometry: Odometry::zeroed(), outputs: Outputs::zeroed() }
    }

    /// Sets the heads of all three messages.
    pub fn set_head(&mut self, head: Head) {
        (self.imu.head, self.odometry.head, self.outputs.head) = (head, head, head);
    }

    /// The named fields in the order of [`FIELDS`].
    fn fields(&self) -> [f64; FIELDS.len()] {
        let (imu, o) = (&self.imu, &self.odometry);
        [
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
        ]
    }
}

/// Message location of an output.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    /// The field of `Imu` or `Odometry` with its name, as an index into [`FIELDS`].
    Field(usize),
    /// `Outputs`, at its index in the vehicle file.
    Numbered,
}

/// The message field of each output of a vehicle.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OutputMap {
    /// Location of output i.
    places: Vec<Place>,
}

impl OutputMap {
    /// The map for a vehicle.
    ///
    /// # Errors
    /// [`NodeError::NotOnBus`] for more outputs than [`MAX_OUTPUTS`], or when outputs that share a validity bit have
    /// sensors of different rates.
    pub fn new(vehicle: &Vehicle) -> Result<Self, NodeError> {
        let refuse = |reason| NodeError::NotOnBus { vehicle: vehicle.name.clone(), reason };
        let outputs = &vehicle.outputs;
        if outputs.len() > MAX_OUTPUTS {
            let reason = format!("it has {} outputs, the messages hold at most {MAX_OUTPUTS}", outputs.len());
            return Err(refuse(reason));
        }
        let field = |name: &str| FIELDS.iter().position(|f| *f == name);
        let places: Vec<_> =
            outputs.iter().map(|o| field(&o.name).map_or(Place::Numbered, Place::Field)).collect();
        for (i, a) in outputs.iter().enumerate() {
            for (j, b) in outputs.iter().enumerate().skip(i + 1) {
                let (Place::Field(p), Place::Field(q)) = (places[i], places[j]) else { continue };
                if p / GROUP == q / GROUP && a.every != b.every {
                    return Err(refuse(format!(
                        "outputs \"{}\" (every = {}) and \"{}\" (every = {}) come from one sensor on the bus and \
                         need the same rate divider",
                        a.name, a.every, b.name, b.every
                    )));
                }
            }
        }
        Ok(Self { places })
    }

    /// True when an output is in `Odometry`.
    pub fn has_odometry(&self) -> bool {
        self.places.iter().any(|p| matches!(p, Place::Field(f) if *f >= IMU_FIELDS))
    }

    /// True when an output is in `Outputs`.
    pub fn has_outputs(&self) -> bool {
        self.places.contains(&Place::Numbered)
    }

    /// Writes measured outputs, SI, to messages. The caller fills in the heads.
    pub fn fill(&self, y: &[f64], fresh: &[bool]) -> Measurement {
        let mut values = [0.0; FIELDS.len()];
        let mut bits = [0; GROUP_BITS.len()];
        let mut measurement = Measurement::zeroed();
        let (imu, o, outputs) = (&mut measurement.imu, &mut measurement.odometry, &mut measurement.outputs);
        for (i, ((&place, &value), &fresh)) in self.places.iter().zip(y).zip(fresh).enumerate() {
            match place {
                Place::Field(field) => {
                    values[field] = value;
                    bits[field / GROUP] = if fresh { GROUP_BITS[field / GROUP] } else { 0 };
                }
                Place::Numbered => {
                    outputs.y[i] = value;
                    outputs.valid |= u64::from(fresh) << i;
                }
            }
        }
        [imu.roll, imu.pitch, imu.yaw, imu.roll_rate, imu.pitch_rate, imu.yaw_rate] =
            [values[0], values[1], values[2], values[3], values[4], values[5]];
        imu.valid = bits[0] | bits[1];
        [o.longitudinal_position, o.lateral_position, o.height] = [values[6], values[7], values[8]];
        [o.longitudinal_speed, o.lateral_speed, o.vertical_speed] = [values[9], values[10], values[11]];
        o.valid = bits[2] | bits[3];
        measurement
    }

    /// Reads outputs from messages. An output is fresh when its validity bit is set and its value is finite;
    /// returns false when a value marked as fresh is not finite.
    pub fn read(&self, measurement: &Measurement, y: &mut [f64], fresh: &mut [bool]) -> bool {
        let values = measurement.fields();
        let (imu, odometry) = (measurement.imu.valid, measurement.odometry.valid);
        let bits = [imu, imu, odometry, odometry];
        let mut clean = true;
        for (i, ((&place, value), fresh)) in self.places.iter().zip(y).zip(fresh).enumerate() {
            let (read, claimed) = match place {
                Place::Field(f) => (values[f], bits[f / GROUP] & GROUP_BITS[f / GROUP] != 0),
                Place::Numbered => (measurement.outputs.y[i], measurement.outputs.valid >> i & 1 == 1),
            };
            clean &= read.is_finite() || !claimed;
            *fresh = claimed && read.is_finite();
            *value = if read.is_finite() { read } else { 0.0 };
        }
        clean
    }
}

/// Checks that a vehicle's signals fit into the messages.
///
/// # Errors
/// [`NodeError::NotOnBus`].
pub fn check_room(vehicle: &Vehicle) -> Result<(), NodeError> {
    OutputMap::new(vehicle)?;
    input_limits(vehicle).map(drop)
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

    fn travels(vehicle: &Vehicle) -> Measurement {
        let map = OutputMap::new(vehicle).unwrap();
        let n = vehicle.outputs.len();
        let y = (0..n).map(|i| 0.5 + i as f64).collect::<Vec<_>>();
        let measurement = map.fill(&y, &vec![true; n]);
        let (mut back, mut fresh) = (vec![0.0; n], vec![false; n]);
        assert!(map.read(&measurement, &mut back, &mut fresh));
        assert_eq!(back, y, "{}", vehicle.name);
        assert!(fresh.iter().all(|f| *f), "{}", vehicle.name);
        assert_eq!(map.has_odometry(), measurement.odometry.valid != 0, "{}", vehicle.name);
        assert_eq!(map.has_outputs(), measurement.outputs.valid != 0, "{}", vehicle.name);
        measurement
    }

    #[test]
    fn every_built_in_vehicle_travels_and_reads_back() {
        for name in whirlstand_vehicle::builtin_names() {
            let vehicle = Vehicle::builtin(name).unwrap();
            let mut measurement = travels(&vehicle);
            measurement.imu.roll = f64::NAN;
            let n = vehicle.outputs.len();
            let (mut back, mut fresh) = (vec![0.0; n], vec![false; n]);
            assert!(!OutputMap::new(&vehicle).unwrap().read(&measurement, &mut back, &mut fresh));
            let roll = vehicle.output_index("roll").unwrap();
            assert!(!fresh[roll] && back[roll] == 0.0);
        }
    }

    #[test]
    fn an_output_of_any_name_travels_under_its_number() {
        let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
        vehicle.outputs[1].name = "rotor_speed".into();
        let measurement = travels(&vehicle);
        assert_eq!((measurement.outputs.valid, measurement.outputs.y[1]), (2, 1.5));
        vehicle.outputs.iter_mut().enumerate().for_each(|(i, o)| o.name = format!("y{i}"));
        assert_eq!(travels(&vehicle).imu.valid, 0);
    }

    #[test]
    fn what_has_no_room_is_refused_by_name() {
        let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
        let roll = vehicle.output_index("roll").unwrap();
        vehicle.outputs[roll].every = 3;
        let error = OutputMap::new(&vehicle).unwrap_err().to_string();
        assert!(error.contains("rate divider"), "{error}");
        let output = vehicle.outputs[0].clone();
        vehicle.outputs = vec![output; 33];
        assert!(OutputMap::new(&vehicle).unwrap_err().to_string().contains("33 outputs"));
        let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
        let input = vehicle.inputs[0].clone();
        vehicle.inputs = vec![input; 9];
        assert!(input_limits(&vehicle).unwrap_err().to_string().contains("9 inputs"));
    }
}
