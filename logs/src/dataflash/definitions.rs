//! Units and scales of the fields, from the FMTU, UNIT and MULT messages of a log.

use std::collections::HashMap;

use whirlstand_msgs::units::Unit;

use super::format::Format;
use super::framing::Message;

/// Names of the messages that describe others or hold settings; none of their fields is a signal.
const NOT_SIGNALS: [&str; 5] = ["FMT", "FMTU", "UNIT", "MULT", "PARM"];

/// Unit id that marks the field with the sensor number.
const INSTANCE: u8 = b'#';

/// Multiplier ids that mean no multiplier, or an unstated one.
const NO_MULTIPLIER: [u8; 2] = [b'-', b'?'];

/// Definitions of units and scales in a log.
#[derive(Debug, Default)]
pub(super) struct Definitions {
    /// Unit ids and multiplier ids of the fields, by type of message.
    fields: HashMap<u8, (String, String)>,
    units: HashMap<u8, String>,
    multipliers: HashMap<u8, f64>,
}

impl Definitions {
    /// Takes in the definitions in a message.
    pub fn take(&mut self, message: &Message<'_>) {
        let number = |field: usize| message.format.fields.get(field)?.number(message.content, 0);
        let text = |field: usize| message.format.fields.get(field)?.text(message.content);
        match message.format.name.as_str() {
            "FMTU" => {
                if let (Some(kind), Some(units), Some(multipliers)) = (number(1), text(2), text(3)) {
                    self.fields.insert(kind as u8, (units, multipliers));
                }
            }
            "UNIT" => {
                if let (Some(id), Some(label)) = (number(1), text(2)) {
                    self.units.insert(id as u8, label);
                }
            }
            "MULT" => {
                if let (Some(id), Some(factor)) = (number(1), number(2)) {
                    self.multipliers.insert(id as u8, factor);
                }
            }
            _ => {}
        }
    }

    /// Index of the field that holds the sensor number of a message type.
    pub fn instance(&self, format: &Format) -> Option<usize> {
        let (units, _) = self.fields.get(&format.kind)?;
        let field = units.bytes().position(|id| id == INSTANCE)?;
        matches!(format.fields.get(field)?.kind, b'b' | b'B').then_some(field)
    }

    /// Unit of a field, in the syntax of [`Unit`], if the log states one that is known.
    pub fn unit(&self, format: &Format, field: usize) -> Option<String> {
        let (units, _) = self.fields.get(&format.kind)?;
        let label = self.units.get(units.as_bytes().get(field)?)?;
        let unit = match label.as_str() {
            "deglatitude" | "deglongitude" | "degheading" => "deg",
            "Ah" => "A*h",
            "Watt" => "W",
            other => other,
        };
        unit.parse::<Unit>().is_ok_and(|unit| unit != Unit::ONE).then(|| unit.into())
    }

    /// Factor from the stored number of a field to its unit.
    pub fn scale(&self, format: &Format, field: usize) -> f64 {
        let stated = || {
            let (_, multipliers) = self.fields.get(&format.kind)?;
            let id = multipliers.as_bytes().get(field).filter(|id| !NO_MULTIPLIER.contains(id))?;
            self.multipliers.get(id).copied().filter(|factor| factor.is_finite() && *factor != 0.0)
        };
        stated().unwrap_or_else(|| format.fields[field].scale())
    }

    /// Whether the messages of a type are samples.
    pub fn is_topic(format: &Format) -> bool {
        !NOT_SIGNALS.contains(&format.name.as_str())
    }
}
