//! Signal names in the logs of known autopilots.
//!
//! Names are those of the projects' own documentation: PX4's uORB topics, ArduPilot's log messages, the
//! fields of Betaflight's blackbox, the variables of the Crazyflie's log groups, and messages of ROS. A name
//! that begins with `*` matches every signal with this ending, since ROS topics have namespaces.

/// Name of a signal in a log, with its unit where the log states none; empty for SI.
pub type Known = (&'static str, &'static str);

/// Signal names in the logs of one program.
pub struct Family {
    /// Name of the program.
    pub name: &'static str,
    /// Groups of inputs, those closest to the actuators first: the vehicle's name for each, and the log's.
    pub inputs: &'static [&'static [(&'static str, Known)]],
    /// Outputs: the vehicle's name for each, and the log's, best first.
    pub outputs: &'static [(&'static str, &'static [Known])],
    /// Motor commands, which show whether the motors ran.
    pub motors: &'static [&'static str],
}

/// Inputs whose path to the vehicle is not linear, by the beginning of their names in a log, and why.
pub const NONLINEAR_INPUTS: [(&str, &str); 1] =
    [("main.rcCommand", "the pilot's stick before its curve of rates and expo, which no linear model has")];

/// All programs, in the order in which they are tried.
pub const FAMILIES: [Family; 7] = [PX4, ARDUPILOT, BETAFLIGHT, BETAFLIGHT_TABLE, CRAZYFLIE, ROS, COLUMNS];

const PX4: Family = Family {
    name: "PX4",
    inputs: &[
        &[
            ("u_roll", ("vehicle_torque_setpoint.xyz[0]", "")),
            ("u_pitch", ("vehicle_torque_setpoint.xyz[1]", "")),
            ("u_yaw", ("vehicle_torque_setpoint.xyz[2]", "")),
            ("u_thrust", ("vehicle_thrust_setpoint.xyz[2]", "")),
        ],
        &[
            ("u_roll", ("actuator_controls_0.control[0]", "")),
            ("u_pitch", ("actuator_controls_0.control[1]", "")),
            ("u_yaw", ("actuator_controls_0.control[2]", "")),
            ("u_thrust", ("actuator_controls_0.control[3]", "")),
        ],
        &[
            ("u_roll", ("vehicle_rates_setpoint.roll", "rad/s")),
            ("u_pitch", ("vehicle_rates_setpoint.pitch", "rad/s")),
            ("u_yaw", ("vehicle_rates_setpoint.yaw", "rad/s")),
            ("u_thrust", ("vehicle_rates_setpoint.thrust", "")),
            ("u_thrust", ("vehicle_rates_setpoint.thrust_body[2]", "")),
        ],
    ],
    outputs: &[
        (
            "roll_rate",
            &[
                ("vehicle_angular_velocity.xyz[0]", "rad/s"),
                ("sensor_combined.gyro_rad[0]", "rad/s"),
                ("sensor_gyro.x", "rad/s"),
                ("vehicle_attitude.rollspeed", "rad/s"),
            ],
        ),
        (
            "pitch_rate",
            &[
                ("vehicle_angular_velocity.xyz[1]", "rad/s"),
                ("sensor_combined.gyro_rad[1]", "rad/s"),
                ("sensor_gyro.y", "rad/s"),
                ("vehicle_attitude.pitchspeed", "rad/s"),
            ],
        ),
        (
            "yaw_rate",
            &[
                ("vehicle_angular_velocity.xyz[2]", "rad/s"),
                ("sensor_combined.gyro_rad[2]", "rad/s"),
                ("sensor_gyro.z", "rad/s"),
                ("vehicle_attitude.yawspeed", "rad/s"),
            ],
        ),
        ("roll", &[("vehicle_attitude.roll", "rad")]),
        ("pitch", &[("vehicle_attitude.pitch", "rad")]),
        ("yaw", &[("vehicle_attitude.yaw", "rad")]),
        (
            "vertical_acceleration",
            &[
                ("vehicle_acceleration.xyz[2]", "m/s^2"),
                ("sensor_combined.accelerometer_m_s2[2]", "m/s^2"),
                ("sensor_accel.z", "m/s^2"),
            ],
        ),
        ("vertical_speed", &[("vehicle_local_position.vz", "m/s")]),
    ],
    motors: &[
        "actuator_motors.control[0]",
        "actuator_motors.control[1]",
        "actuator_motors.control[2]",
        "actuator_motors.control[3]",
        "actuator_outputs.output[0]",
        "actuator_outputs.output[1]",
        "actuator_outputs.output[2]",
        "actuator_outputs.output[3]",
        "actuator_outputs.1.output[0]",
        "actuator_outputs.1.output[1]",
        "actuator_outputs.1.output[2]",
        "actuator_outputs.1.output[3]",
        "actuator_outputs.2.output[0]",
        "actuator_outputs.2.output[1]",
        "actuator_outputs.2.output[2]",
        "actuator_outputs.2.output[3]",
    ],
};

const ARDUPILOT: Family = Family {
    name: "ArduPilot",
    inputs: &[
        &[
            ("u_roll", ("RATE.ROut", "")),
            ("u_pitch", ("RATE.POut", "")),
            ("u_yaw", ("RATE.YOut", "")),
            ("u_thrust", ("RATE.AOut", "")),
        ],
        &[
            ("u_servo1", ("RCOU.C1", "us")),
            ("u_servo2", ("RCOU.C2", "us")),
            ("u_servo3", ("RCOU.C3", "us")),
            ("u_servo4", ("RCOU.C4", "us")),
        ],
    ],
    outputs: &[
        ("roll_rate", &[("IMU.GyrX", "rad/s"), ("RATE.R", "deg/s")]),
        ("pitch_rate", &[("IMU.GyrY", "rad/s"), ("RATE.P", "deg/s")]),
        ("yaw_rate", &[("IMU.GyrZ", "rad/s"), ("RATE.Y", "deg/s")]),
        ("roll", &[("ATT.Roll", "deg")]),
        ("pitch", &[("ATT.Pitch", "deg")]),
        ("yaw", &[("ATT.Yaw", "deg")]),
        ("vertical_acceleration", &[("IMU.AccZ", "m/s^2")]),
        ("vertical_speed", &[("CTUN.CRt", "cm/s")]),
    ],
    motors: &["RCOU.C1", "RCOU.C2", "RCOU.C3", "RCOU.C4"],
};

const BETAFLIGHT: Family = Family {
    name: "Betaflight",
    inputs: &[
        &[
            ("u_roll", ("main.setpoint[0]", "deg/s")),
            ("u_pitch", ("main.setpoint[1]", "deg/s")),
            ("u_yaw", ("main.setpoint[2]", "deg/s")),
            ("u_thrust", ("main.setpoint[3]", "")),
        ],
        // Before Betaflight 4.
        &[
            ("u_roll", ("main.rcCommand[0]", "")),
            ("u_pitch", ("main.rcCommand[1]", "")),
            ("u_yaw", ("main.rcCommand[2]", "")),
            ("u_thrust", ("main.rcCommand[3]", "")),
        ],
        &[
            ("u_motor1", ("main.motor[0]", "")),
            ("u_motor2", ("main.motor[1]", "")),
            ("u_motor3", ("main.motor[2]", "")),
            ("u_motor4", ("main.motor[3]", "")),
        ],
    ],
    outputs: &[
        ("roll_rate", &[("main.gyroADC[0]", "deg/s")]),
        ("pitch_rate", &[("main.gyroADC[1]", "deg/s")]),
        ("yaw_rate", &[("main.gyroADC[2]", "deg/s")]),
        ("vertical_acceleration", &[("main.accSmooth[2]", "g")]),
    ],
    motors: &["main.motor[0]", "main.motor[1]", "main.motor[2]", "main.motor[3]"],
};

/// Tables that `blackbox_decode` makes of a log of Betaflight. Its accelerations are counts of the sensor.
const BETAFLIGHT_TABLE: Family = Family {
    name: "Betaflight, decoded",
    inputs: &[
        &[
            ("u_roll", ("setpoint[0]", "deg/s")),
            ("u_pitch", ("setpoint[1]", "deg/s")),
            ("u_yaw", ("setpoint[2]", "deg/s")),
            ("u_thrust", ("setpoint[3]", "")),
        ],
        &[
            ("u_motor1", ("motor[0]", "")),
            ("u_motor2", ("motor[1]", "")),
            ("u_motor3", ("motor[2]", "")),
            ("u_motor4", ("motor[3]", "")),
        ],
    ],
    outputs: &[
        ("roll_rate", &[("gyroADC[0]", "deg/s")]),
        ("pitch_rate", &[("gyroADC[1]", "deg/s")]),
        ("yaw_rate", &[("gyroADC[2]", "deg/s")]),
    ],
    motors: &["motor[0]", "motor[1]", "motor[2]", "motor[3]"],
};

const CRAZYFLIE: Family = Family {
    name: "Crazyflie",
    inputs: &[
        &[
            ("u_roll", ("controller.cmd_roll", "")),
            ("u_pitch", ("controller.cmd_pitch", "")),
            ("u_yaw", ("controller.cmd_yaw", "")),
            ("u_thrust", ("controller.cmd_thrust", "")),
        ],
        &[
            ("u_roll", ("controller.rollRate", "")),
            ("u_pitch", ("controller.pitchRate", "")),
            ("u_yaw", ("controller.yawRate", "")),
            ("u_thrust", ("stabilizer.thrust", "")),
        ],
        &[
            ("u_motor1", ("motor.m1", "")),
            ("u_motor2", ("motor.m2", "")),
            ("u_motor3", ("motor.m3", "")),
            ("u_motor4", ("motor.m4", "")),
        ],
    ],
    outputs: &[
        (
            "roll_rate",
            &[("gyro.x", "deg/s"), ("stateEstimateZ.rateRoll", "mrad/s"), ("controller.r_roll", "rad/s")],
        ),
        (
            "pitch_rate",
            &[("gyro.y", "deg/s"), ("stateEstimateZ.ratePitch", "mrad/s"), ("controller.r_pitch", "rad/s")],
        ),
        (
            "yaw_rate",
            &[("gyro.z", "deg/s"), ("stateEstimateZ.rateYaw", "mrad/s"), ("controller.r_yaw", "rad/s")],
        ),
        ("roll", &[("stateEstimate.roll", "deg"), ("stabilizer.roll", "deg")]),
        ("pitch", &[("stateEstimate.pitch", "deg"), ("stabilizer.pitch", "deg")]),
        ("yaw", &[("stateEstimate.yaw", "deg"), ("stabilizer.yaw", "deg")]),
        ("vertical_acceleration", &[("acc.z", "g")]),
        ("vertical_speed", &[("stateEstimate.vz", "m/s")]),
    ],
    motors: &["motor.m1", "motor.m2", "motor.m3", "motor.m4"],
};

const ROS: Family = Family {
    name: "ROS",
    inputs: &[],
    outputs: &[
        ("roll_rate", &[("*.angular_velocity.x", "rad/s"), ("*.twist.angular.x", "rad/s")]),
        ("pitch_rate", &[("*.angular_velocity.y", "rad/s"), ("*.twist.angular.y", "rad/s")]),
        ("yaw_rate", &[("*.angular_velocity.z", "rad/s"), ("*.twist.angular.z", "rad/s")]),
        ("vertical_acceleration", &[("*.linear_acceleration.z", "m/s^2")]),
        ("vertical_speed", &[("*.twist.linear.z", "m/s")]),
    ],
    motors: &[],
};

/// Common column names of tables, this program's own names first.
const COLUMNS: Family = Family {
    name: "table",
    inputs: &[],
    outputs: &[
        (
            "roll_rate",
            &[
                ("roll_rate", "rad/s"),
                ("p", "rad/s"),
                ("gyro_x", "rad/s"),
                ("gx", "rad/s"),
                ("ang_vel_x", "rad/s"),
                ("angular_velocity_x", "rad/s"),
                ("omega_x", "rad/s"),
            ],
        ),
        (
            "pitch_rate",
            &[
                ("pitch_rate", "rad/s"),
                ("q", "rad/s"),
                ("gyro_y", "rad/s"),
                ("gy", "rad/s"),
                ("ang_vel_y", "rad/s"),
                ("angular_velocity_y", "rad/s"),
                ("omega_y", "rad/s"),
            ],
        ),
        (
            "yaw_rate",
            &[
                ("yaw_rate", "rad/s"),
                ("r", "rad/s"),
                ("gyro_z", "rad/s"),
                ("gz", "rad/s"),
                ("ang_vel_z", "rad/s"),
                ("angular_velocity_z", "rad/s"),
                ("omega_z", "rad/s"),
            ],
        ),
        ("roll", &[("roll", "rad"), ("phi", "rad")]),
        ("pitch", &[("pitch", "rad"), ("theta", "rad")]),
        ("yaw", &[("yaw", "rad"), ("psi", "rad")]),
        ("vertical_acceleration", &[("vertical_acceleration", "m/s^2"), ("az", "m/s^2"), ("acc_z", "m/s^2")]),
        (
            "vertical_speed",
            &[("vertical_speed", "m/s"), ("vertical_velocity", "m/s"), ("climb_rate", "m/s"), ("vz", "m/s")],
        ),
    ],
    motors: &["pwm1", "pwm2", "pwm3", "pwm4", "motor1", "motor2", "motor3", "motor4"],
};
