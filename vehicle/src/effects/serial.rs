//! Serialisation of effects: any serde format, values as numbers in SI or as text with a unit.

use std::fmt;

use serde::de::{Deserialize, Deserializer, Error as _, MapAccess, Visitor};
use serde::ser::{Serialize, SerializeMap, Serializer};
use whirlstand_msgs::units::{Quantity, Unit, UnitError};

use super::Effect;
use super::field::FieldValue;
use super::kind::Kind;
use super::table::Requirement;
use super::window::{KEYS, Window};
use crate::error::EffectError;

impl Effect {
    /// An effect from the keys of a table, without `effect` and `where`.
    ///
    /// # Errors
    /// When a key is unknown or missing, a value is not finite, out of range, or in a unit that cannot fit.
    pub fn from_fields<N: AsRef<str>>(
        kind: Kind,
        place: &str,
        fields: impl IntoIterator<Item = (N, FieldValue)>,
    ) -> Result<Self, EffectError> {
        let spec = kind.spec();
        let mut effect = Self {
            kind,
            place: place.into(),
            values: vec![None; spec.parameters.len()],
            text: None,
            written: Vec::new(),
            window: Window::default(),
        };
        for (name, value) in fields {
            effect.take_field(name.as_ref(), value)?;
        }
        let one_of: Vec<_> = spec.parameters.iter().filter(|p| p.requirement == Requirement::OneOf).collect();
        for (p, value) in spec.parameters.iter().zip(&mut effect.values) {
            if let (Requirement::Default(default), None) = (p.requirement, &value) {
                *value = Some(default);
            }
        }
        let missing = spec
            .parameters
            .iter()
            .zip(&effect.values)
            .find(|(p, v)| p.requirement == Requirement::Required && v.is_none());
        if let Some((p, _)) = missing {
            return Err(effect.error(Some(p.name), "is missing".into()));
        }
        let given = one_of.iter().filter(|p| effect.parameter(p.name).is_some()).count();
        if !one_of.is_empty() && given != 1 {
            let names = crate::error::list(one_of.iter().map(|p| p.name));
            return Err(effect.error(None, format!("exactly one of {names} must be given")));
        }
        if let (Some((name, true)), None) = (spec.text, &effect.text) {
            return Err(effect.error(Some(name), "is missing".into()));
        }
        effect.check_ranges()?;
        Ok(effect)
    }

    fn take_field(&mut self, name: &str, value: FieldValue) -> Result<(), EffectError> {
        let spec = self.kind.spec();
        if spec.text.is_some_and(|(text, _)| text == name) {
            let FieldValue::Text(text) = value else {
                return Err(self.error(Some(name), "must be a string in quotes".into()));
            };
            self.text = Some(text);
            return Ok(());
        }
        if let Some(key) = KEYS.iter().position(|key| *key == name) {
            let end = match value {
                FieldValue::Number(number) => number,
                FieldValue::Text(text) => {
                    seconds(&text).map_err(|e| self.error(Some(name), format!("is wrong: {e}")))?
                }
            };
            *[&mut self.window.from_s, &mut self.window.until_s][key] = Some(end);
            return Ok(());
        }
        let Some(index) = spec.parameters.iter().position(|p| p.name == name) else {
            return Err(self.error(Some(name), self.unknown_field(name)));
        };
        let si = match value {
            FieldValue::Number(number) => number,
            FieldValue::Text(text) => {
                let quantity: Quantity =
                    text.parse().map_err(|e: UnitError| self.error(Some(name), format!("is wrong: {e}")))?;
                match spec.parameters[index].own_unit().map(str::parse::<Unit>) {
                    Some(unit) => unit
                        .and_then(|unit| quantity.in_unit(&unit))
                        .map_err(|e| self.error(Some(name), format!("is wrong: {e}")))?,
                    None => {
                        self.written.push((index, quantity.unit.dimension()));
                        quantity.si
                    }
                }
            }
        };
        self.values[index] = Some(si);
        Ok(())
    }
}

fn seconds(text: &str) -> Result<f64, UnitError> {
    let quantity: Quantity = text.parse()?;
    quantity.in_unit(&"s".parse()?)
}

impl Serialize for Effect {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("effect", self.kind.name())?;
        map.serialize_entry("where", &self.place)?;
        for (name, value) in self.parameters() {
            map.serialize_entry(name, &value)?;
        }
        for (key, end) in self.window.ends() {
            map.serialize_entry(key, &end)?;
        }
        if let (Some((name, _)), Some(text)) = (self.kind.spec().text, &self.text) {
            map.serialize_entry(name, text)?;
        }
        map.end()
    }
}

impl<'de> Deserialize<'de> for Effect {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Fields;
        impl<'de> Visitor<'de> for Fields {
            type Value = Effect;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("a table with the keys effect, where and the effect's parameters")
            }

            fn visit_map<M: MapAccess<'de>>(self, mut map: M) -> Result<Effect, M::Error> {
                let (mut kind, mut place, mut fields) = (None, None, Vec::new());
                while let Some(key) = map.next_key::<String>()? {
                    match key.as_str() {
                        "effect" => kind = Some(map.next_value::<String>()?),
                        "where" => place = Some(map.next_value::<String>()?),
                        _ => fields.push((key, map.next_value::<FieldValue>()?)),
                    }
                }
                let kind = kind.ok_or_else(|| M::Error::missing_field("effect"))?;
                let kind = Kind::from_name(&kind).map_err(M::Error::custom)?;
                let place = place.ok_or_else(|| M::Error::missing_field("where"))?;
                Effect::from_fields(kind, &place, fields).map_err(M::Error::custom)
            }
        }
        deserializer.deserialize_map(Fields)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_effect_reads_from_toml_with_units_and_writes_back_in_si() {
        let text = "effect = \"pulse_disturbance\"\nwhere = \"roll_rate\"\nat_s = 6\nduration_s = \"200 ms\"\nmagnitude = 2.0\n";
        let effect: Effect = toml::from_str(text).unwrap();
        assert_eq!(effect.parameter("duration_s"), Some(0.2));
        let written = toml::to_string(&effect).unwrap();
        assert_eq!(toml::from_str::<Effect>(&written).unwrap(), effect);
        let json = serde_json::to_string(&effect).unwrap();
        assert_eq!(serde_json::from_str::<Effect>(&json).unwrap(), effect);
    }

    #[test]
    fn an_effect_that_acts_for_a_time_says_when() {
        let text = "effect = \"input_gain\"\nwhere = \"u\"\nfactor = 0.5\nfrom_s = \"500 ms\"\nuntil_s = 2\n";
        let effect: Effect = toml::from_str(text).unwrap();
        assert_eq!((effect.window().from_s, effect.window().until_s), (Some(0.5), Some(2.0)));
        assert_eq!(toml::from_str::<Effect>(&toml::to_string(&effect).unwrap()).unwrap(), effect);
        let text = "effect = \"input_delay\"\nwhere = \"u\"\ndelay_s = 0.1\nfrom_s = 2\nuntil_s = 1";
        let error = toml::from_str::<Effect>(text).unwrap_err().to_string();
        assert!(error.contains("until_s is 1 s, but must be after from_s = 2 s"), "{error}");
    }

    #[test]
    fn errors_name_the_key() {
        let error =
            toml::from_str::<Effect>("effect = \"input_dely\"\nwhere = \"u\"").unwrap_err().to_string();
        assert!(error.contains("did you mean 'input_delay'?"), "{error}");
        let text = "effect = \"input_delay\"\nwhere = \"u\"\ndelay_s = \"3 m\"";
        let error = toml::from_str::<Effect>(text).unwrap_err().to_string();
        assert!(error.contains("delay_s") && error.contains("quantity in s"), "{error}");
    }
}
