//! The messages of the control loop.

use crate::define::message;
use crate::{MAX_INPUTS, MAX_OUTPUTS, MAX_STATES};

/// Bits of `valid` in [`Imu`], [`Odometry`] and [`Estimate`]: which values are fresh at this step.
pub mod valid {
    /// Attitude angles of an [`crate::Imu`], position of an [`crate::Odometry`].
    pub const FIRST: u32 = 1;
    /// Angular rates of an [`crate::Imu`], velocity of an [`crate::Odometry`].
    pub const SECOND: u32 = 2;
}

/// Bits of `flags` in [`Imu`], [`Estimate`], [`Command`] and [`Truth`].
pub mod flags {
    /// The estimator has converged from its start.
    pub const CONVERGED: u32 = 1;
    /// At least one input is at its limit.
    pub const SATURATED: u32 = 2;
    /// The plant applies its failsafe instead of commands.
    pub const FAILSAFE: u32 = 4;
    /// The command of the previous step did not arrive in time, or was not usable; the last one is held.
    pub const HELD: u32 = 8;
    /// Open loop: the stick passes through, without a law.
    pub const MANUAL: u32 = 16;
    /// The controller is alive but has no usable command for this step; `count` is zero. A plant in lockstep,
    /// which would wait for a command, counts a miss.
    pub const WITHHELD: u32 = 32;
    /// The command is from a law that replaced the first one in flight.
    pub const SUCCEEDED: u32 = 64;
}

/// Values of `in_charge` in [`Sent`]: the source that controls the outputs of a bridge to a vehicle.
pub mod charge {
    /// No source: outputs are neutral.
    pub const NOBODY: u32 = 0;
    /// The pilot.
    pub const PILOT: u32 = 1;
    /// The controller.
    pub const CONTROLLER: u32 = 2;
    /// No source after a failure in flight.
    pub const FAILSAFE: u32 = 3;
}

/// Values of `armed` in [`Sent`] and [`Autopilot`].
pub mod armed {
    /// The vehicle reports that it is not armed.
    pub const NO: u32 = 0;
    /// The vehicle reports that it is armed.
    pub const YES: u32 = 1;
    /// The vehicle does not report it.
    pub const UNKNOWN: u32 = 2;
}

message! {
    /// Inertial measurement: attitude and angular rates, as the sensor reports them.
    Imu on "imu" {
        /// Roll angle, rad.
        roll: f64 => "float64",
        /// Pitch angle, rad.
        pitch: f64 => "float64",
        /// Yaw angle, rad.
        yaw: f64 => "float64",
        /// Roll rate, rad/s.
        roll_rate: f64 => "float64",
        /// Pitch rate, rad/s.
        pitch_rate: f64 => "float64",
        /// Yaw rate, rad/s.
        yaw_rate: f64 => "float64",
        /// Fresh groups: [`valid::FIRST`] angles, [`valid::SECOND`] rates. A stale group repeats its last value.
        valid: u32 => "uint32",
        /// [`flags`] of what the plant applies from this step on: [`flags::HELD`], [`flags::FAILSAFE`],
        /// [`flags::SATURATED`]. Zero from a vehicle that does not tell.
        flags: u32 => "uint32",
    }
}

message! {
    /// Position and velocity in the horizontal plane and height, as the sensor reports them.
    Odometry on "odometry" {
        /// Longitudinal position, m.
        longitudinal_position: f64 => "float64",
        /// Lateral position, m.
        lateral_position: f64 => "float64",
        /// Height, m.
        height: f64 => "float64",
        /// Longitudinal speed, m/s.
        longitudinal_speed: f64 => "float64",
        /// Lateral speed, m/s.
        lateral_speed: f64 => "float64",
        /// Vertical speed, upwards, m/s.
        vertical_speed: f64 => "float64",
        /// Fresh groups: [`valid::FIRST`] positions, [`valid::SECOND`] speeds. A stale group repeats its last value.
        valid: u32 => "uint32",
        /// Always zero.
        reserved: u32 => "uint32",
    }
}

message! {
    /// Outputs of the vehicle without a field in [`Imu`] or [`Odometry`], as the sensors report them.
    Outputs on "outputs" {
        /// Measured outputs, SI units: output i of the vehicle file is `y[i]`. Those that another message carries are
        /// zero. A stale one repeats its last value.
        y: f64[MAX_OUTPUTS] => "float64[32]",
        /// Validity: bit i means that `y[i]` is fresh.
        valid: u64 => "uint64",
    }
}

message! {
    /// Estimate of the estimator at step k, after the measurements of step k.
    Estimate on "estimate" {
        /// Estimated states in the vehicle's order, SI units; unused ones are zero.
        x: f64[MAX_STATES] => "float64[16]",
        /// Standard deviation of the states, SI units.
        std: f64[MAX_STATES] => "float64[16]",
        /// Estimated bias of roll, pitch, roll rate and pitch rate, rad and rad/s.
        bias: f64[4] => "float64[4]",
        /// Normalised innovation squared of this step's measurements; chi-square with `dof` degrees of freedom.
        nis: f64 => "float64",
        /// Degrees of freedom of `nis`: the number of fresh measurements.
        dof: u32 => "uint32",
        /// Number of states in use.
        count: u32 => "uint32",
        /// State of the estimator, [`flags`].
        flags: u32 => "uint32",
        /// Always zero.
        reserved: u32 => "uint32",
    }
}

message! {
    /// Inputs commanded by the controller; the plant applies them over `[t_k+1, t_k+2)`.
    Command on "command" {
        /// Inputs in the vehicle's order, dimensionless; unused ones are zero.
        u: f64[MAX_INPUTS] => "float64[8]",
        /// Number of inputs in use.
        count: u32 => "uint32",
        /// State of the controller, [`flags`].
        flags: u32 => "uint32",
    }
}

message! {
    /// Reference of the controller at this step, or a reference from a pilot or planner.
    Setpoint on "setpoint" {
        /// Reference of the states in the vehicle's order, SI units.
        x: f64[MAX_STATES] => "float64[16]",
        /// Stick deflection in the order of the inputs, for open-loop flight.
        stick: f64[MAX_INPUTS] => "float64[8]",
        /// Tracked states: bit i means that state i is tracked.
        tracked: u64 => "uint64",
    }
}

message! {
    /// True states and inputs of the simulated vehicle at step k; a real vehicle does not publish this.
    Truth on "truth" {
        /// States in the vehicle's order, SI units.
        x: f64[MAX_STATES] => "float64[16]",
        /// Inputs applied over `[t_k, t_k+1)`, after the plant's limits.
        u: f64[MAX_INPUTS] => "float64[8]",
        /// Number of states in use.
        states: u32 => "uint32",
        /// Number of inputs in use.
        inputs: u32 => "uint32",
        /// State of the plant, [`flags`].
        flags: u32 => "uint32",
        /// Always zero.
        reserved: u32 => "uint32",
    }
}

message! {
    /// Disturbance of the derivative of each state from this step on.
    Disturbance on "disturbance" {
        /// Added to the derivative of each state, SI units per second.
        dx: f64[MAX_STATES] => "float64[16]",
        /// Number of states in use.
        count: u32 => "uint32",
        /// Always zero.
        reserved: u32 => "uint32",
    }
}

message! {
    /// Last output of a bridge to a real vehicle before step k, after limits and rates, with its source; it
    /// acts over `[t_k, t_k+1)`.
    Sent on "sent" {
        /// Channels, us; NaN for those that are unused or handed over.
        channels: f64[16] => "float64[16]",
        /// The inputs that the channels stand for, in the vehicle's order; unused ones are zero.
        u: f64[MAX_INPUTS] => "float64[8]",
        /// The pilot's channels, us; NaN while the pilot's receiver is silent.
        stick: f64[16] => "float64[16]",
        /// Share of packets that reach the vehicle, as it reports, 0 to 1; NaN where the link does not report
        /// it.
        link_quality: f64 => "float64",
        /// Messages sent since the bridge started.
        messages: u64 => "uint64",
        /// Number of inputs in use.
        count: u32 => "uint32",
        /// Source of the outputs, [`charge`].
        in_charge: u32 => "uint32",
        /// Whether the vehicle is armed, [`armed`].
        armed: u32 => "uint32",
        /// Reason why no source is in charge, as numbered in `docs/bridges.md`; 0 for none.
        reason: u32 => "uint32",
    }
}

message! {
    /// State that a real vehicle behind a MAVLink bridge has reported last before step k. Signal strengths are
    /// shares of the largest value of the protocol; NaN while unknown.
    Reported on "reported" {
        /// Signal with which this end of the radio link hears the vehicle, 0 to 1.
        rssi: f64 => "float64",
        /// Signal with which the vehicle's end of the radio link hears this one, 0 to 1.
        remote_rssi: f64 => "float64",
        /// Signal of the pilot's radio at the vehicle, 0 to 1.
        pilot_rssi: f64 => "float64",
        /// Flight mode, numbered by the autopilot (`custom_mode` of its heartbeat).
        custom_mode: u32 => "uint32",
        /// Flags of the mode (`base_mode`, MAV_MODE_FLAG).
        base_mode: u32 => "uint32",
        /// State of the vehicle (`system_status`, MAV_STATE).
        system_status: u32 => "uint32",
        /// 1 when a heartbeat was received, and the mode and the state are known; else 0.
        known: u32 => "uint32",
    }
}

message! {
    /// Exchange with an autopilot that flies the bench's vehicle: the sensors of step k, and the outputs in
    /// response.
    Autopilot on "autopilot" {
        /// Outputs of the autopilot: 0 to 1 for a motor, -1 to 1 for a servo; NaN for all before the first
        /// and when they are too old.
        outputs: f64[32] => "float64[32]",
        /// The pilot's channels sent to the autopilot, us.
        rc: f64[16] => "float64[16]",
        /// Turn rate sent to the autopilot, rad/s, FRD.
        gyro: f64[3] => "float64[3]",
        /// Specific force sent to the autopilot, m/s^2, FRD.
        accel: f64[3] => "float64[3]",
        /// Magnetic field sent to the autopilot, T, FRD.
        mag: f64[3] => "float64[3]",
        /// Static pressure sent to the autopilot, Pa.
        pressure: f64 => "float64",
        /// Last position fix sent to the autopilot: latitude and longitude, degrees, and height above the
        /// sea, m.
        fix: f64[3] => "float64[3]",
        /// Velocity over ground of the last fix sent to the autopilot, m/s, NED.
        velocity: f64[3] => "float64[3]",
        /// Whether the autopilot is armed, [`armed`].
        armed: u32 => "uint32",
        /// Reason for a missing command: 0 none is missing, 1 no outputs or too old ones, 2 outputs that are
        /// not finite, 3 not armed.
        fault: u32 => "uint32",
    }
}

message! {
    /// Progress of the recorder; a lockstep plant waits for it so that no message is lost.
    Progress on "progress" {
        /// Messages written since the recorder started.
        written: u64 => "uint64",
        /// Messages lost since the recorder started.
        lost: u64 => "uint64",
    }
}
