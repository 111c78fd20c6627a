//! Control signals of tables whose columns no program has named, told by their names.

use super::names::words;

/// Number of groups of control signals.
pub const GROUPS: usize = CONTROLS.len() + 1;

/// The group of a control signal of this name and unit, those of the usual names first, references of loops last; none for
/// another signal.
pub fn group(name: &str, unit: Option<&str>) -> Option<usize> {
    if unit.is_some_and(|unit| MEASURED_UNITS.contains(&unit)) {
        return None;
    }
    let words = words(name);
    let group = CONTROLS.iter().position(|names| names.fit(name, &words))?;
    Some(if is_reference(&words) { CONTROLS.len() } else { group })
}

/// Names of control signals in tables whose columns no program has named.
struct Controls {
    /// What a name begins with.
    begins: &'static [&'static str],
    /// Words that may be anywhere in a name.
    anywhere: &'static [&'static str],
    /// Words that only a number follows, as in `u1`.
    numbered: &'static [&'static str],
    /// Whole names: deflections of elevator, aileron and rudder (Klein and Morelli, Aircraft System Identification).
    whole: &'static [&'static str],
}

impl Controls {
    /// True where a name, of these words, is that of a control signal.
    fn fit(&self, name: &str, words: &[String]) -> bool {
        let name = name.to_lowercase();
        let numbered = matches!(words, [word, number] if self.numbered.contains(&word.as_str())
            && number.bytes().all(|b| b.is_ascii_digit()));
        self.begins.iter().any(|begin| name.starts_with(begin))
            || self.whole.contains(&name.as_str())
            || numbered
            || words.iter().any(|word| self.anywhere.contains(&word.as_str()))
    }
}

/// Names of control signals, in groups, the usual names of a table of inputs first, those of single actuators last.
const CONTROLS: [Controls; 3] = [
    Controls {
        begins: &["u_", "in_", "cmd", "command", "setpoint", "control_"],
        anywhere: &[],
        numbered: &["u", "input", "control"],
        whole: &[],
    },
    Controls {
        begins: &["delta_"],
        anywhere: &[
            "cmd",
            "command",
            "commanded",
            "control",
            "ctrl",
            "setpoint",
            "sp",
            "aileron",
            "elevator",
            "rudder",
            "throttle",
            "collective",
            "cyclic",
            "torque",
            "moment",
        ],
        numbered: &[],
        whole: &["de", "da", "dr"],
    },
    Controls {
        begins: &[],
        anywhere: &[
            "motor",
            "motors",
            "rotor",
            "rotors",
            "pwm",
            "esc",
            "servo",
            "actuator",
            "actuators",
            "dshot",
            "rpm",
        ],
        numbered: &["m", "w", "omega"],
        whole: &[],
    },
];

/// Words of what something is told to be.
const TOLD: [&str; 10] =
    ["sp", "setpoint", "ref", "reference", "desired", "des", "target", "cmd", "command", "commanded"];
/// Words of motions that a loop holds where it is told.
const MOTIONS: [&str; 15] = [
    "rate",
    "rates",
    "att",
    "attitude",
    "angle",
    "vel",
    "velocity",
    "speed",
    "pos",
    "position",
    "acc",
    "accel",
    "acceleration",
    "altitude",
    "heading",
];
/// Words of what acts on a vehicle.
const ACTING: [&str; 18] = [
    "thrust",
    "torque",
    "moment",
    "aileron",
    "elevator",
    "rudder",
    "flap",
    "throttle",
    "collective",
    "cyclic",
    "motor",
    "motors",
    "rotor",
    "rotors",
    "esc",
    "servo",
    "actuator",
    "actuators",
];

/// True for the reference of a loop, such as `rate_sp_roll`: it explains the output that the loop makes follow it, but does
/// not act on the vehicle. What does, such as `torque_sp_roll`, is the input of its model (Ljung, System Identification,
/// section 13.5: the direct approach).
fn is_reference(words: &[String]) -> bool {
    let any = |of: &[&str]| words.iter().any(|word| of.contains(&word.as_str()));
    any(&TOLD) && any(&MOTIONS) && !any(&ACTING)
}

/// Units of what is measured at a motor, not of what it is told.
const MEASURED_UNITS: [&str; 4] = ["A", "W", "degC", "C"];

#[cfg(test)]
mod tests {
    use super::*;

    /// Columns of a record of PX4 in the simulator Gazebo: a loop makes the rate follow its set-point, which explained it best.
    #[test]
    fn what_acts_on_the_vehicle_goes_before_what_a_loop_is_told() {
        for reference in ["rate_sp_roll", "att_sp_q0", "cmd_pitch_rate", "desired_yaw_rate_cmd"] {
            assert_eq!(group(reference, None), Some(CONTROLS.len()), "{reference}");
        }
        for acting in ["torque_sp_roll", "att_sp_thrust_z", "elevator_angle_cmd", "motor_speed_sp", "de"] {
            assert_eq!(group(acting, None), Some(1), "{acting}");
        }
        assert_eq!(
            [
                group("motor_0", None),
                group("motor_0", Some("A")),
                group("roll_rate", None),
                group("angle_de", None)
            ],
            [Some(2), None, None, None]
        );
    }
}
