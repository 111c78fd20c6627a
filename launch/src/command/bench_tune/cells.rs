//! The cells: every vehicle of the paper with every law and every effect that applies to a vehicle, and
//! Figure 12.

use crate::error::Failure;

const VEHICLES: [&str; 4] =
    ["quadrotor", "helicopter-hover", "helicopter-longitudinal", "helicopter-lateral"];
const LAWS: [&str; 3] = ["lqr", "ppc", "smc"];

/// The quadrotor of Figure 12 in the paper: held level by hand and by sliding mode, with a misaligned IMU.
const FIGURE_12: &str = "figure-12";

/// Effects of the table with sizes that affect the flight: name, location, parameters.
const EFFECTS: [(&str, &str, &str); 25] = [
    ("input_delay", "u_roll", "delay_s = 0.3"),
    ("actuator_lag", "u_roll", "time_constant_s = 0.3"),
    ("sensor_delay", "roll", "delay_s = 0.2"),
    ("input_gain", "u_roll", "factor = 0.5"),
    ("sensor_lag", "roll", "time_constant_s = 0.2"),
    ("unmodelled_mode", "u_roll", "frequency_hz = 1.5\ndamping_ratio = 0.2"),
    ("input_bias", "u_roll", "offset = 2.0"),
    ("sensor_bias", "roll", "offset = '3 deg'"),
    ("sensor_scale", "roll", "factor = 1.5"),
    ("input_coupling", "u_roll->u_pitch", "coefficient = 0.5"),
    ("parameter_change", "A[2,2]", "factor = 0.3"),
    ("misalignment", "roll,pitch", "angle_rad = 0.3"),
    ("dead_zone", "u_roll", "width = 0.5"),
    ("backlash", "u_roll", "width = 1.0"),
    ("gain_drift", "u_roll", "rate_per_s = -0.015"),
    ("input_saturation", "u_roll", "lower = -2.0\nupper = 2.0"),
    ("rate_limit", "u_roll", "limit_per_s = 5.0"),
    ("quadratic_drag", "roll_rate", "coefficient = 3.0"),
    ("coulomb_friction", "roll_rate", "level = '10 deg/s^2'"),
    ("cubic_stiffness", "roll->roll_rate", "coefficient = 20.0"),
    ("vibration", "roll", "frequency_hz = 7.0\namplitude = '1 deg'"),
    ("noise", "roll", "std = '0.5 deg'"),
    ("sensor_drift", "roll", "rate_per_s = '0.1 deg/s'"),
    ("quantization", "roll", "step = '0.5 deg'"),
    ("dropouts", "roll", "fraction = 0.5"),
];

/// Setpoint steps that excite both inputs: time, s, and values.
const ANGLES: [(f64, &str); 6] = [
    (1.0, "roll = '8 deg'"),
    (5.0, "roll = '-8 deg'\npitch = '5 deg'"),
    (9.0, "roll = 0.0\npitch = 0.0"),
    (13.0, "roll = '8 deg'"),
    (16.0, "roll = 0.0\npitch = '-5 deg'"),
    (20.0, "pitch = 0.0"),
];
const POSITIONS: [(f64, &str); 4] = [
    (1.0, "lateral_position = '2 m'"),
    (8.0, "lateral_position = 0.0\nlongitudinal_position = '2 m'"),
    (15.0, "lateral_position = '-2 m'\nlongitudinal_position = 0.0"),
    (22.0, "lateral_position = 0.0"),
];

/// Lines of a launch file for a flight in lockstep in this thread.
pub(super) const IN_THIS_THREAD: &str = "mode = 'lockstep'\ntransport = 'inproc'";

/// Stick steps of a flight by hand, which excite both axes.
const STICK: [(f64, &str); 9] = [
    (2.0, "u_roll = 2.0"),
    (2.5, "u_roll = -2.0"),
    (3.0, "u_roll = 0.0"),
    (10.0, "u_pitch = 2.0"),
    (10.5, "u_pitch = -2.0"),
    (11.0, "u_pitch = 0.0"),
    (18.0, "u_roll = -2.0"),
    (18.5, "u_roll = 2.0"),
    (19.0, "u_roll = 0.0"),
];

const GUST: (&str, &str, &str) =
    ("pulse_disturbance", "roll_rate", "at_s = 26.0\nduration_s = 0.2\nmagnitude = '60 deg/s^2'");

/// Measurement offsets of both angles of the IMU.
const OFFSETS: [(&str, &str, &str); 2] =
    [("sensor_bias", "roll", "offset = '3 deg'"), ("sensor_bias", "pitch", "offset = '-2 deg'")];

/// A vehicle with hidden effects under a control law.
#[derive(Debug, Clone)]
pub(super) struct Scene {
    /// Name of the built-in vehicle, or Figure 12.
    pub vehicle: &'static str,
    /// Law that flies the record.
    pub law: &'static str,
    /// Name of the hidden effect.
    pub effect: &'static str,
    hidden: Vec<(&'static str, &'static str, &'static str)>,
}

/// All scenes, in the order of the table.
pub(super) fn scenes() -> Vec<Scene> {
    let table = EFFECTS.into_iter().flat_map(|effect| {
        LAWS.into_iter().flat_map(move |law| {
            VEHICLES.into_iter().map(move |vehicle| Scene {
                vehicle,
                law,
                effect: effect.0,
                hidden: vec![effect],
            })
        })
    });
    let figure = ["manual", "smc"].into_iter().map(|law| Scene {
        vehicle: FIGURE_12,
        law,
        effect: "sensor_bias",
        hidden: OFFSETS.to_vec(),
    });
    table.chain(figure).collect()
}

/// The scenes that the user selected: those that match all words of an entry of `only`; all scenes if it is
/// empty.
///
/// # Errors
/// Fails for an entry whose words no scene has.
pub(super) fn wanted(only: &[String]) -> Result<Vec<Scene>, Failure> {
    let has = |scene: &Scene, words: &str| {
        words.split('/').all(|word| [scene.vehicle, scene.law, scene.effect].contains(&word))
    };
    let all = scenes();
    if let Some(words) = only.iter().find(|words| !all.iter().any(|scene| has(scene, words))) {
        let effects = EFFECTS.map(|e| e.0).join(", ");
        return Err(Failure::Mend(format!(
            "--only {words}: no cell has all of these words; vehicles are {}, {FIGURE_12}, laws {}, manual, effects {effects}",
            VEHICLES.join(", "),
            LAWS.join(", ")
        )));
    }
    Ok(all.into_iter().filter(|s| only.is_empty() || only.iter().any(|words| has(s, words))).collect())
}

impl Scene {
    /// Vehicle, law and effect, joined by slashes.
    pub fn name(&self) -> String {
        format!("{}/{}/{}", self.vehicle, self.law, self.effect)
    }

    /// Name of the built-in vehicle file.
    pub fn vehicle_file(&self) -> &'static str {
        if self.vehicle == FIGURE_12 { "quadrotor" } else { self.vehicle }
    }

    /// Law of the later flights. A record flown by hand is flown by sliding mode afterwards, as in the paper.
    pub fn law_afterwards(&self) -> &'static str {
        if self.law == "manual" { "smc" } else { self.law }
    }

    /// The launch file of this scene with the law `law`; `how` holds the lines on mode and transport.
    pub fn launch(&self, law: &str, how: &str) -> String {
        let (kind, steps): (_, &[(f64, &str)]) = match (self.vehicle, self.law) {
            (FIGURE_12, "manual") => ("stick", &STICK),
            (FIGURE_12, _) => ("setpoint", &[]),
            ("quadrotor", _) => ("setpoint", &ANGLES),
            _ => ("setpoint", &POSITIONS),
        };
        let steps: String =
            steps.iter().map(|(at, what)| format!("\n[[{kind}]]\nat_s = {at:?}\n{what}\n")).collect();
        format!(
            "vehicle = '{}'\n{how}\nrate_hz = 100.0\nduration_s = 32.0\n\
             controller.law = '{law}'\n{steps}{}{}",
            self.vehicle_file(),
            table_of(GUST),
            self.hidden_tables()
        )
    }

    /// TOML tables of the hidden effects, which the vehicle file does not contain.
    pub fn hidden_tables(&self) -> String {
        self.hidden.iter().map(|effect| table_of(*effect)).collect()
    }
}

fn table_of((effect, place, parameters): (&str, &str, &str)) -> String {
    format!("\n[[effects]]\neffect = '{effect}'\nwhere = '{place}'\n{parameters}\n")
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::file::{Document, plan};

    #[test]
    fn every_scene_is_a_launch_file_and_an_extended_vehicle() {
        let all = wanted(&[]).unwrap();
        assert_eq!(all.len(), 302);
        for scene in all {
            let document = Document::parse(&scene.name(), &scene.launch(scene.law, IN_THIS_THREAD)).unwrap();
            let plan = plan(&document, "cell", Path::new(".")).unwrap();
            let plain = whirlstand_vehicle::Vehicle::builtin(scene.vehicle_file()).unwrap();
            let text = plain.source_text + &scene.hidden_tables();
            let truth = whirlstand_vehicle::Vehicle::parse(&text, "truth.toml").unwrap();
            assert!(truth.effects.iter().all(|e| plan.config.effects.contains(e)), "{}", scene.name());
        }
    }

    #[test]
    fn cells_are_chosen_by_words() {
        let count = |only: &[&str]| wanted(&only.iter().map(ToString::to_string).collect::<Vec<_>>());
        assert_eq!(count(&["lqr/input_delay"]).unwrap().len(), 4);
        assert_eq!(count(&["figure-12", "quadrotor/ppc"]).unwrap().len(), 27);
        let refused = count(&["lqr/flutter"]).unwrap_err().to_string();
        assert!(refused.contains("lqr/flutter") && refused.contains("input_delay"), "{refused}");
    }
}
