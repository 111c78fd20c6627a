//! Mixer of a quadrotor: four rotor inputs that act together, so that an axis depends on a sum or a
//! difference of them.
//!
//! A frame of four equal rotors has four decoupled motions, and each responds to one pattern of signs: all
//! together lift, and of the three ways to set two against two, two tilt and one turns (Mahony, Kumar and
//! Corke, Multirotor Aerial Vehicles, IEEE Robotics and Automation Magazine 19(3), 2012, equation 8). With
//! arms along the body's axes the tilts respond to one rotor against another. The position and spin direction
//! of each rotor need not be known: the record shows which pattern explains which output.

use nalgebra::{DMatrix, DVector};
use whirlstand_logs::Record;

use super::proposal::Chosen;
use crate::identify::normal::pseudo_inverse;

/// Number of rotors of a quadrotor.
const ROTORS: usize = 4;
/// Signs of the patterns: lift, two against two, and one against one.
const PATTERNS: [[f64; ROTORS]; 10] = [
    [1.0, 1.0, 1.0, 1.0],
    [1.0, 1.0, -1.0, -1.0],
    [1.0, -1.0, 1.0, -1.0],
    [1.0, -1.0, -1.0, 1.0],
    [1.0, -1.0, 0.0, 0.0],
    [1.0, 0.0, -1.0, 0.0],
    [1.0, 0.0, 0.0, -1.0],
    [0.0, 1.0, -1.0, 0.0],
    [0.0, 1.0, 0.0, -1.0],
    [0.0, 0.0, 1.0, -1.0],
];

/// Rotor inputs of a record with the patterns in which they act.
#[derive(Debug, Clone)]
pub struct Mixer {
    /// The rotors' commands.
    pub rotors: Vec<Chosen>,
    /// The patterns as virtual inputs, in the order of the table.
    pub patterns: Vec<Chosen>,
}

impl Mixer {
    /// The mixer of four inputs whose names differ only in a number; `None` for others. Four controls whose
    /// axes are known (PX4's `control[0]` is roll) are named after these, and are mixed already.
    pub fn of(inputs: &[Chosen]) -> Option<Self> {
        let stem = |c: &Chosen| [&c.source, &c.name].map(|s| s.replace(|c: char| c.is_ascii_digit(), "#"));
        let same = inputs.len() == ROTORS && inputs.iter().all(|c| stem(c) == stem(&inputs[0]));
        same.then(|| Self {
            rotors: inputs.to_vec(),
            patterns: PATTERNS.iter().map(|signs| pattern(inputs, signs)).collect(),
        })
    }

    /// The record with the patterns added as signals.
    pub fn mixed(&self, mut record: Record) -> Record {
        let command = |c: &Chosen| record.get(&c.name).map(|s| (s.values.clone(), s.unit.clone()));
        let Some(commands) = self.rotors.iter().map(command).collect::<Option<Vec<_>>>() else {
            return record;
        };
        for (chosen, signs) in self.patterns.iter().zip(PATTERNS) {
            let sum = |k: usize| {
                let used = signs.iter().zip(&commands).filter(|(sign, _)| **sign != 0.0);
                used.map(|(sign, (values, _))| sign * values[k]).sum::<f64>()
            };
            let values = (0..record.len()).map(sum).collect();
            // A name that the log already has keeps its own signal.
            let _ = record.push(&chosen.name, &commands[0].1, values);
        }
        record
    }

    /// Rotor signs of an input that is one of the patterns.
    pub fn signs(&self, input: &str) -> Option<&'static [f64; ROTORS]> {
        self.patterns.iter().zip(&PATTERNS).find(|(c, _)| c.name == input).map(|(_, signs)| signs)
    }

    /// Rotor constants that add up to those of the patterns, by the minimum norm.
    pub fn constants(&self, patterns: &[(&str, f64)]) -> Option<Vec<f64>> {
        let rows: Vec<_> = patterns.iter().map(|(name, _)| self.signs(name)).collect::<Option<_>>()?;
        let signs = DMatrix::from_fn(rows.len(), ROTORS, |i, j| rows[i][j]);
        let wanted = DVector::from_iterator(rows.len(), patterns.iter().map(|(_, value)| *value));
        let solved = pseudo_inverse(&(&signs * signs.transpose()))? * wanted;
        Some((signs.transpose() * solved).iter().copied().collect())
    }
}

/// A pattern as a virtual input.
fn pattern(rotors: &[Chosen], signs: &[f64; ROTORS]) -> Chosen {
    let used = rotors.iter().zip(signs).filter(|(_, sign)| **sign != 0.0);
    let name = used.enumerate().map(|(i, (rotor, sign))| match (i, *sign > 0.0) {
        (0, _) => rotor.name.clone(),
        (_, true) => format!(" + {}", rotor.name),
        (_, false) => format!(" - {}", rotor.name),
    });
    let slowest = rotors
        .iter()
        .filter_map(|r| r.interval_s)
        .fold(None, |m: Option<f64>, s| Some(m.map_or(s, |m| m.max(s))));
    let name: String = name.collect();
    Chosen { source: name.clone(), name, interval_s: slowest, why: "rotors that act together".into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rotor(source: &str) -> Chosen {
        let name = format!("u_{}", source.replace('.', "_"));
        Chosen { name, source: source.into(), interval_s: None, why: String::new() }
    }

    #[test]
    fn four_inputs_of_one_name_are_rotors_and_others_are_not() {
        let all = ["motor.m1", "motor.m2", "motor.m3", "motor.m4"].map(rotor);
        let mixer = Mixer::of(&all).unwrap();
        assert_eq!(mixer.patterns.len(), 10);
        assert_eq!(mixer.patterns[1].name, "u_motor_m1 + u_motor_m2 - u_motor_m3 - u_motor_m4");
        assert_eq!(mixer.patterns[9].name, "u_motor_m3 - u_motor_m4");
        assert!(Mixer::of(&all[..3]).is_none());
        assert!(Mixer::of(&["roll", "pitch", "yaw", "thrust"].map(rotor)).is_none());
        let mut controls = ["control[0]", "control[1]", "control[2]", "control[3]"].map(rotor);
        for (control, axis) in controls.iter_mut().zip(["roll", "pitch", "yaw", "thrust"]) {
            control.name = format!("u_{axis}");
        }
        assert!(Mixer::of(&controls).is_none());
    }

    #[test]
    fn a_record_has_the_patterns_and_constants_of_patterns_come_from_rotors() {
        let all = ["m1", "m2", "m3", "m4"].map(rotor);
        let mixer = Mixer::of(&all).unwrap();
        let mut record = Record::new("x", vec![0.0, 0.1]).unwrap();
        for (i, rotor) in all.iter().enumerate() {
            record.push(&rotor.name, "", vec![i as f64, f64::NAN]).unwrap();
        }
        let record = mixer.mixed(record);
        let values = &record.get("u_m1 - u_m2 + u_m3 - u_m4").unwrap().values;
        assert!(values[0] == -2.0 && values[1].is_nan());
        let wanted = [(mixer.patterns[1].name.as_str(), 2.0), (mixer.patterns[2].name.as_str(), -4.0)];
        let constants = mixer.constants(&wanted).unwrap();
        for (name, value) in wanted {
            let sum: f64 = mixer.signs(name).unwrap().iter().zip(&constants).map(|(s, c)| s * c).sum();
            assert!((sum - value).abs() < 1e-9, "{name}: {sum}");
        }
    }
}
