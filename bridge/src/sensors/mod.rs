//! The full sensor set that an autopilot needs, from the states of a linear model.
//!
//! A linear model of attitude and, for some vehicles, horizontal speed and position contains no specific
//! force, magnetic field or pressure. These follow from its motion under the following assumptions:
//!
//! - Attitude is roll, pitch and yaw of the model, as Euler angles in the order yaw, pitch, roll. A model without a
//!   yaw axis keeps the heading that it was given.
//! - `longitudinal` and `lateral` are axes of the heading frame: level, forward and to the right. Where the model has
//!   positions, the motion is that of the positions; where it has speeds alone, positions are their integral; where it
//!   has neither, the vehicle turns about a fixed point, as on a stand.
//! - Height is constant, unless the model has a vertical axis (`height`, `vertical_speed`, upwards).
//! - The ground is flat within the few hundred metres of a bench, the air is the standard atmosphere and does not
//!   move, and the magnetic field is the same everywhere.
//!
//! Everything is derived from the sequence of poses, not from the model's equations, so that the sensors cannot
//! contradict each other whatever acts on the model: the gyroscope is the mean turn over the last period, so that
//! integrating it gives the attitude; the accelerometer is the mean change of velocity over the last period, less
//! gravity, seen from the body; velocity is the mean change of position. Sensor errors of the bus (noise, bias, drift,
//! vibration, ...) are carried over to the sensor that has the same cause: those of the rates to the gyroscope, those
//! of the angles to the direction in which the accelerometer feels gravity, those of positions and speeds to the
//! satellite receiver.
//!
//! Frames: body is forward, right, down (FRD); earth is north, east, down (NED).

mod air;
mod earth;
mod motion;

use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use whirlstand_vehicle::Stream;

use crate::quantity;

pub use air::{STANDARD_GRAVITY, density, pressure, temperature};
pub use earth::{Field, Origin};
pub use motion::{Axis, MissingState, Motion, StateMap};

/// Options of the simulated sensors. Noise is white and given by its standard deviation; zero is a perfect sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SensorOptions {
    /// Start of the vehicle.
    pub origin: Origin,
    /// The earth's magnetic field.
    pub field: Field,
    /// Heading of a model without a yaw axis, or at zero yaw of a model with one, rad from north over east.
    #[serde(deserialize_with = "quantity::angle")]
    pub heading: f64,
    /// Noise of the gyroscope in addition to that of the vehicle's rate outputs, rad/s.
    #[serde(deserialize_with = "quantity::rate")]
    pub gyro_noise: f64,
    /// Noise of the accelerometer in addition to that of the vehicle's angle outputs, m/s^2.
    pub accel_noise: f64,
    /// Noise of the magnetometer, T.
    pub mag_noise: f64,
    /// Noise of the barometer, Pa.
    pub baro_noise: f64,
    /// Rate of position fixes, Hz.
    pub gps_hz: f64,
}

impl Default for SensorOptions {
    fn default() -> Self {
        Self {
            origin: Origin::default(),
            field: Field::default(),
            heading: 0.0,
            // Autopilots treat a constant value as a failed sensor.
            gyro_noise: 5e-4,
            accel_noise: 0.02,
            mag_noise: 0.1e-6,
            baro_noise: 2.0,
            gps_hz: 10.0,
        }
    }
}

/// Readings of all sensors at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensors {
    /// Time since the first step, ns; increases by one period per step.
    pub time_ns: u64,
    /// Attitude: rotates body vectors to earth vectors.
    pub attitude: UnitQuaternion<f64>,
    /// Roll, pitch, yaw of `attitude`, rad; yaw within plus or minus pi.
    pub angles: [f64; 3],
    /// Turn rate of the body with sensor errors, rad/s, FRD.
    pub gyro: Vector3<f64>,
    /// True turn rate of the body, rad/s, FRD.
    pub turn: Vector3<f64>,
    /// Specific force, m/s^2, FRD: at rest and level (0, 0, -g).
    pub accel: Vector3<f64>,
    /// Magnetic field, T, FRD.
    pub mag: Vector3<f64>,
    /// Static pressure, Pa.
    pub pressure: f64,
    /// Differential pressure of the pitot tube, Pa.
    pub differential_pressure: f64,
    /// Air temperature, K.
    pub temperature: f64,
    /// Pressure altitude above the sea, m.
    pub pressure_altitude: f64,
    /// Position relative to the origin, m, NED.
    pub position: Vector3<f64>,
    /// Latitude, degrees.
    pub latitude: f64,
    /// Longitude, degrees.
    pub longitude: f64,
    /// Height above the sea, m.
    pub altitude: f64,
    /// Velocity over ground, m/s, NED.
    pub velocity: Vector3<f64>,
    /// Acceleration over ground, m/s^2, NED.
    pub acceleration: Vector3<f64>,
    /// Position fix of the satellite receiver.
    pub gps: Fix,
    /// True when `gps` is new at this step.
    pub gps_fresh: bool,
}

/// A position fix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fix {
    /// Latitude, degrees.
    pub latitude: f64,
    /// Longitude, degrees.
    pub longitude: f64,
    /// Height above the sea, m.
    pub altitude: f64,
    /// Velocity over ground, m/s, NED.
    pub velocity: Vector3<f64>,
}

/// Errors (measured minus true) of the bus's sensors, by the names of the bus.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Errors {
    /// Errors of roll, pitch, yaw, rad.
    pub angles: [f64; 3],
    /// Errors of the rates of roll, pitch, yaw, rad/s.
    pub rates: [f64; 3],
    /// Errors of longitudinal position, lateral position, height, m.
    pub position: [f64; 3],
    /// Errors of longitudinal, lateral, vertical speed, m/s.
    pub speed: [f64; 3],
}

/// Computes the sensors step by step.
#[derive(Debug, Clone)]
pub struct SensorModel {
    options: SensorOptions,
    period: f64,
    period_ns: u64,
    steps: u64,
    begun: bool,
    last: Option<Last>,
    gyro: Stream,
    accel: Stream,
    mag: Stream,
    baro: Stream,
    fix: Option<Fix>,
    fixes: u64,
}

#[derive(Debug, Clone, Copy)]
struct Last {
    motion: Motion,
    attitude: UnitQuaternion<f64>,
    position: Vector3<f64>,
    /// Velocity over ground; unknown at the first step of a model with positions only.
    velocity: Option<Vector3<f64>>,
}

impl SensorModel {
    /// Sensors that are read once per period; `seed` is that of the run.
    pub fn new(options: SensorOptions, period_ns: u64, seed: u64) -> Self {
        let stream = |name: &str| Stream::new(seed, &format!("autopilot sensor {name}"));
        Self {
            options,
            period: period_ns as f64 * 1e-9,
            period_ns,
            steps: 0,
            begun: false,
            last: None,
            gyro: stream("gyro"),
            accel: stream("accel"),
            mag: stream("mag"),
            baro: stream("baro"),
            fix: None,
            fixes: 0,
        }
    }

    /// Resets the motion of the vehicle: the next step is the first of a new run, while time continues.
    pub fn rewind(&mut self) {
        self.last = None;
    }

    /// The sensors one period after the last call. A call with the same motion reads the sensors of a vehicle
    /// at rest.
    pub fn step(&mut self, motion: &Motion, errors: &Errors) -> Sensors {
        self.step_after(1, motion, errors)
    }

    /// The sensors `periods` periods after the last call, when the motion in between is unknown.
    pub fn step_after(&mut self, periods: u64, motion: &Motion, errors: &Errors) -> Sensors {
        let period = self.period * periods.max(1) as f64;
        // The first step is at time zero; after a rewind time continues.
        self.steps += if self.begun { periods.max(1) } else { 0 };
        self.begun = true;
        let heading = self.options.heading;
        let [roll, pitch, yaw] = motion.angles;
        let attitude = UnitQuaternion::from_euler_angles(roll, pitch, yaw + heading);
        let now = self.follow(motion, attitude, period);
        let last = self.last.unwrap_or(now);
        let turn = (last.attitude.inverse() * attitude).scaled_axis() / period;
        let velocity = now.velocity.unwrap_or_default();
        let acceleration = last.velocity.map_or_else(Vector3::zeros, |v| (velocity - v) / period);
        let middle = last.attitude * UnitQuaternion::from_scaled_axis(turn * (period / 2.0));
        let [roll, pitch, _] = errors.angles;
        // An angle error of an instrument rotates the measured direction of gravity by that angle.
        let felt = middle * UnitQuaternion::from_euler_angles(roll, pitch, 0.0);
        let down = Vector3::new(0.0, 0.0, STANDARD_GRAVITY);
        let altitude = self.options.origin.altitude_m - now.position.z;
        let (latitude, longitude) = self.options.origin.degrees(now.position.x, now.position.y);
        let clean = pressure(altitude);
        let forward = attitude.inverse_transform_vector(&velocity).x.max(0.0);
        let pressure = clean + self.options.baro_noise * self.baro.normal();
        let (roll, pitch, yaw) = attitude.euler_angles();
        let (fix, gps_fresh) = self.satellites(&now, errors, motion.angles[2] + heading);
        let sensors = Sensors {
            time_ns: self.steps * self.period_ns,
            attitude,
            angles: [roll, pitch, yaw],
            gyro: turn
                + body_rates(motion.angles, errors.rates)
                + noise(&mut self.gyro, self.options.gyro_noise),
            turn,
            accel: felt.inverse_transform_vector(&(acceleration - down))
                + noise(&mut self.accel, self.options.accel_noise),
            mag: attitude.inverse_transform_vector(&self.options.field.ned())
                + noise(&mut self.mag, self.options.mag_noise),
            pressure,
            differential_pressure: 0.5 * density(altitude) * forward * forward,
            temperature: temperature(altitude),
            pressure_altitude: air::altitude(pressure),
            position: now.position,
            latitude,
            longitude,
            altitude,
            velocity,
            acceleration,
            gps: fix,
            gps_fresh,
        };
        self.last = Some(now);
        sensors
    }

    /// Position and velocity over ground, from the last step to this one.
    fn follow(&self, motion: &Motion, attitude: UnitQuaternion<f64>, period: f64) -> Last {
        let yaw = motion.angles[2] + self.options.heading;
        let Some(last) = self.last else {
            let position = to_ground(motion.axes.map(|a| a.position.unwrap_or(0.0)), yaw);
            let known = motion.axes.iter().all(|a| a.position.is_none());
            let velocity = known.then(|| to_ground(motion.axes.map(|a| a.speed.unwrap_or(0.0)), yaw));
            return Last { motion: *motion, attitude, position, velocity };
        };
        let before = last.motion.angles[2] + self.options.heading;
        let mut travelled = [0.0; 3];
        let mut speeds = [0.0; 3];
        for (i, (now, then)) in motion.axes.iter().zip(&last.motion.axes).enumerate() {
            (travelled[i], speeds[i]) = match (now.position, then.position, now.speed, then.speed) {
                (Some(now), Some(then), ..) => (now - then, (now - then) / period),
                (_, _, Some(now), Some(then)) => (0.5 * (now + then) * period, now),
                _ => (0.0, 0.0),
            };
        }
        let middle = before + 0.5 * wrapped(yaw - before);
        Last {
            motion: *motion,
            attitude,
            position: last.position + to_ground(travelled, middle),
            velocity: Some(to_ground(speeds, middle)),
        }
    }

    fn satellites(&mut self, now: &Last, errors: &Errors, yaw: f64) -> (Fix, bool) {
        let due = (self.fixes as f64) / self.options.gps_hz.max(f64::MIN_POSITIVE);
        let time = self.steps as f64 * self.period;
        if let Some(fix) = self.fix
            && time + 0.5 * self.period < due
        {
            return (fix, false);
        }
        let position = now.position + to_ground(errors.position, yaw);
        let (latitude, longitude) = self.options.origin.degrees(position.x, position.y);
        let fix = Fix {
            latitude,
            longitude,
            altitude: self.options.origin.altitude_m - position.z,
            velocity: now.velocity.unwrap_or_default() + to_ground(errors.speed, yaw),
        };
        self.fix = Some(fix);
        self.fixes = (time * self.options.gps_hz + 0.5).floor() as u64 + 1;
        (fix, true)
    }
}

/// Transforms forward, right, up in the heading frame to north, east, down.
fn to_ground([forward, right, up]: [f64; 3], yaw: f64) -> Vector3<f64> {
    let (sin, cos) = yaw.sin_cos();
    Vector3::new(cos * forward - sin * right, sin * forward + cos * right, -up)
}

/// Turn rate of the body from Euler angle rates (Diebel, "Representing Attitude", 2006, equation 78).
pub fn body_rates([roll, pitch, _]: [f64; 3], [roll_rate, pitch_rate, yaw_rate]: [f64; 3]) -> Vector3<f64> {
    let ((sr, cr), (sp, cp)) = (roll.sin_cos(), pitch.sin_cos());
    Vector3::new(
        roll_rate - sp * yaw_rate,
        cr * pitch_rate + sr * cp * yaw_rate,
        -sr * pitch_rate + cr * cp * yaw_rate,
    )
}

fn noise(stream: &mut Stream, deviation: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| deviation * stream.normal())
}

/// The angle within plus or minus pi, for any number of turns: a remainder has no rounding error that grows
/// with them.
pub fn wrapped(angle: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    let rest = angle % TAU;
    if rest.abs() <= PI { rest } else { rest - TAU.copysign(rest) }
}

#[cfg(test)]
mod tests;
