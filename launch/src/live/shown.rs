//! A message as a line of text, with the names and units of the vehicle, or as JSON.

use serde_json::{Value, json};
use whirlstand_msgs::units::ShownUnit;
use whirlstand_msgs::{Field, Message};
use whirlstand_vehicle::{SignalUnit, Vehicle};

/// A message of any type.
pub(crate) struct Shown<'m> {
    topic: &'m str,
    fields: &'static [Field],
    bytes: &'m [u8],
    /// The node that sent the message, for `Health`.
    speaker: Option<&'m str>,
    json: Value,
}

impl<'m> Shown<'m> {
    /// A message received on a topic.
    pub fn new<M: Message>(topic: &'m str, message: &'m M) -> Self {
        Self {
            topic,
            fields: M::FIELDS,
            bytes: bytemuck::bytes_of(message),
            speaker: message.speaker(),
            // Messages are fixed-size plain data that JSON always accepts; a value that is no number becomes
            // null.
            json: serde_json::to_value(message).unwrap_or_default(),
        }
    }

    /// The message with all its fields, SI.
    pub fn json(&self) -> Value {
        json!({ "schema": "whirlstand.message.v1", "topic": self.topic, "message": self.json })
    }

    /// The message as a line: step, time, and values with the vehicle's names and units.
    pub fn line(&self, vehicle: &Vehicle) -> String {
        let (step, stamp_ns) = (self.u64_at(8), self.u64_at(16));
        let mut line = match self.speaker {
            // `Health` carries wall-clock time, which is the present.
            Some(node) => format!("{node}  step {step}"),
            None => format!("t {:8.3} s  step {step}", stamp_ns as f64 * 1e-9),
        };
        for field in &self.fields[1..] {
            self.add(field, vehicle, &mut line);
        }
        line
    }

    fn add(&self, field: &Field, vehicle: &Vehicle, line: &mut String) {
        let mut say = |name: &str, text: String| line.push_str(&format!("  {name} {text}"));
        let at = |i: usize| field.offset + i * if field.kind == "u32" { 4 } else { 8 };
        match (field.name, field.kind, field.count) {
            ("reserved" | "count" | "states" | "inputs" | "id", _, _) | (_, "u8", _) => {}
            (name, "f64", 1) => say(name, unit_of(name, vehicle).text(self.f64_at(at(0)))),
            (name, "u64", 1) => say(name, self.u64_at(at(0)).to_string()),
            (name, "u32", 1) => say(name, self.u32_at(at(0)).to_string()),
            (name, "f64", count) => {
                for (i, (signal, unit)) in signals_of(name, vehicle).into_iter().enumerate().take(count) {
                    let name = match name {
                        "x" | "u" | "y" => signal,
                        prefix => format!("{prefix}.{signal}"),
                    };
                    say(&name, unit.text(self.f64_at(at(i))));
                }
            }
            // Histograms are left out, because they are for programs.
            _ => {}
        }
    }

    fn u64_at(&self, offset: usize) -> u64 {
        bytemuck::pod_read_unaligned(&self.bytes[offset..offset + 8])
    }

    fn f64_at(&self, offset: usize) -> f64 {
        bytemuck::pod_read_unaligned(&self.bytes[offset..offset + 8])
    }

    fn u32_at(&self, offset: usize) -> u32 {
        bytemuck::pod_read_unaligned(&self.bytes[offset..offset + 4])
    }
}

/// The unit of a scalar field that has the name of an output; otherwise none.
fn unit_of(name: &str, vehicle: &Vehicle) -> ShownUnit {
    let output = vehicle.outputs.iter().find(|o| o.name == name);
    output.map_or_else(ShownUnit::default, |o| o.unit.shown())
}

/// Names and units of the elements of an array.
fn signals_of(name: &str, vehicle: &Vehicle) -> Vec<(String, ShownUnit)> {
    let states = |unit: fn(&SignalUnit) -> ShownUnit| {
        vehicle.states.iter().map(|s| (s.name.clone(), unit(&s.unit))).collect()
    };
    match name {
        "x" | "std" => states(SignalUnit::shown),
        "dx" => states(|unit| unit.shown().per_second()),
        "u" | "stick" => vehicle.inputs.iter().map(|i| (i.name.clone(), i.unit.shown())).collect(),
        "y" => vehicle.outputs.iter().map(|o| (o.name.clone(), o.unit.shown())).collect(),
        "bias" => ["roll", "pitch", "roll_rate", "pitch_rate"]
            .map(|name| (name.to_string(), unit_of(name, vehicle)))
            .into(),
        _ => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_msgs::{Command, Imu};

    #[test]
    fn a_line_has_the_vehicles_names_and_units() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let mut imu = Imu { roll: 0.1, valid: 3, ..Imu::zeroed() };
        (imu.head.step, imu.head.stamp_ns) = (300, 1_500_000_000);
        let line = Shown::new("imu", &imu).line(&vehicle);
        assert!(line.starts_with("t    1.500 s  step 300  roll 5.73 deg  pitch 0 deg"), "{line}");
        let mut command = Command { count: 2, ..Command::zeroed() };
        command.u[1] = -0.25;
        let line = Shown::new("command", &command).line(&vehicle);
        assert!(line.contains("  u_roll 0  u_pitch -0.250  flags 0"), "{line}");
        let json = Shown::new("command", &command).json();
        assert_eq!((&json["topic"], &json["message"]["u"][1]), (&"command".into(), &(-0.25).into()));
    }
}
