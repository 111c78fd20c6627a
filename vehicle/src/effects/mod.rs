//! Effects: extensions of a vehicle's model.
//!
//! An [`Effect`] is a part of the signal chain with a place (`where`) and named parameters in SI. The simulator
//! runs it, identification fits it, diagnosis names it, the vehicle file keeps it. [`SPECS`] is the whole
//! table; [`crate::Simulator`] says in which order effects act, whatever their order in the file.
//!
//! ```
//! use whirlstand_vehicle::{Effect, Kind, Vehicle};
//!
//! let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
//! let delay = Effect::new(Kind::InputDelay, "u_roll", &[("delay_s", 0.08)]).unwrap();
//! vehicle.add_effect(delay).unwrap();
//! assert!(vehicle.to_toml().contains("delay_s = 0.08"));
//! ```

mod field;
mod kind;
mod names;
mod place;
mod resolve;
mod serial;
mod table;
mod units;
mod window;

pub use field::FieldValue;
pub use kind::Kind;
pub use place::{Matrix, Place};
pub use table::{Parameter, PlaceKind, Requirement, SPECS, Scale, Spec};
pub use units::ParameterUnit;
pub use window::Window;

use whirlstand_msgs::names::did_you_mean;
use whirlstand_msgs::units::Dimension;

use crate::error::EffectError;

/// One effect at one place.
#[derive(Debug, Clone, PartialEq)]
pub struct Effect {
    kind: Kind,
    place: String,
    /// Parameter values in the order of the table; `None` for a parameter that is not given and has no
    /// default.
    values: Vec<Option<f64>>,
    text: Option<String>,
    /// Dimensions of values written with a unit, stored until they can be checked against the vehicle.
    written: Vec<(usize, Dimension)>,
    window: Window,
}

impl Effect {
    /// An effect from its parameters in SI.
    ///
    /// # Errors
    /// When a parameter is unknown, missing, not finite or out of its range.
    pub fn new(kind: Kind, place: &str, parameters: &[(&str, f64)]) -> Result<Self, EffectError> {
        let fields = parameters.iter().map(|(name, value)| (*name, FieldValue::Number(*value)));
        Self::from_fields(kind, place, fields)
    }

    /// The flight mode changes to the vehicle `to` (name or path) at `at_s`.
    ///
    /// # Errors
    /// When `at_s` is negative or not finite.
    pub fn mode_transition(at_s: f64, to: &str) -> Result<Self, EffectError> {
        let fields = [("at_s", FieldValue::Number(at_s)), ("to", FieldValue::Text(to.into()))];
        Self::from_fields(Kind::ModeTransition, "vehicle", fields)
    }

    /// Kind of the effect.
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// The place, as written in `where`.
    pub fn place(&self) -> &str {
        &self.place
    }

    /// The same effect at an entry of a matrix, row and column from 0.
    pub(crate) fn at_entry(&self, matrix: Matrix, row: usize, column: usize) -> Self {
        Self { place: format!("{matrix}[{},{}]", row + 1, column + 1), ..self.clone() }
    }

    /// The effect and its place, as text.
    pub fn told(&self) -> String {
        format!("{} at {}", self.kind, self.place)
    }

    /// Value of a parameter in SI, or its default if it has one.
    pub fn parameter(&self, name: &str) -> Option<f64> {
        let index = self.kind.spec().parameters.iter().position(|p| p.name == name)?;
        self.values[index]
    }

    /// All parameters that have a value, in SI, in the order of the table.
    pub fn parameters(&self) -> impl Iterator<Item = (&'static str, f64)> + '_ {
        let names = self.kind.spec().parameters.iter().map(|p| p.name);
        names.zip(&self.values).filter_map(|(name, value)| Some((name, (*value)?)))
    }

    /// Changes a parameter, in SI.
    ///
    /// # Errors
    /// When the effect has no such parameter, or the value is not finite or out of range.
    pub fn set_parameter(&mut self, name: &str, value: f64) -> Result<(), EffectError> {
        let spec = self.kind.spec();
        let index = spec.parameters.iter().position(|p| p.name == name);
        let Some(index) = index else {
            return Err(self.error(Some(name), self.unknown_field(name)));
        };
        let mut changed = self.clone();
        changed.values[index] = Some(value);
        changed.check_ranges()?;
        *self = changed;
        Ok(())
    }

    /// Time window in which the effect acts.
    pub fn window(&self) -> Window {
        self.window
    }

    /// The same effect, limited to a time window.
    ///
    /// # Errors
    /// When the window is invalid.
    pub fn during(mut self, window: Window) -> Result<Self, EffectError> {
        self.window = window;
        self.check_ranges()?;
        Ok(self)
    }

    /// The text parameter: `to` of a mode transition, `source` of a vibration.
    pub fn text(&self) -> Option<&str> {
        self.text.as_deref()
    }

    /// Value of a parameter that the table guarantees; 0 for any other name.
    pub(crate) fn get(&self, name: &str) -> f64 {
        debug_assert!(self.parameter(name).is_some(), "{} has no {name}", self.kind);
        self.parameter(name).unwrap_or(0.0)
    }

    fn unknown_field(&self, name: &str) -> String {
        let spec = self.kind.spec();
        let known = || {
            ["effect", "where"]
                .into_iter()
                .chain(spec.parameters.iter().map(|p| p.name))
                .chain(spec.text.map(|(name, _)| name))
                .chain(window::KEYS)
        };
        format!(
            "'{name}' is not a key of {}{}; keys are {}",
            self.kind,
            did_you_mean(name, known()),
            crate::error::list(known())
        )
    }

    fn error(&self, field: Option<&str>, reason: String) -> EffectError {
        EffectError {
            effect: self.kind.name().into(),
            place: self.place.clone(),
            field: field.map(Into::into),
            reason,
        }
    }

    fn check_ranges(&self) -> Result<(), EffectError> {
        if let Some((key, reason)) = self.window.fault() {
            return Err(self.error(Some(key), reason));
        }
        let spec = self.kind.spec();
        for (p, value) in spec.parameters.iter().zip(&self.values) {
            let Some(value) = *value else { continue };
            if !value.is_finite() {
                return Err(self.error(Some(p.name), format!("{value} is not a finite number")));
            }
            if value < p.lower || value > p.upper {
                let unit = match p.own_unit() {
                    None | Some("") => String::new(),
                    Some(symbol) => format!(" {symbol}"),
                };
                let range = match (p.lower.is_finite(), p.upper.is_finite()) {
                    (true, true) => format!("must be from {}{unit} to {}{unit}", p.lower, p.upper),
                    (true, false) => format!("must be at least {}{unit}", p.lower),
                    _ => format!("must be at most {}{unit}", p.upper),
                };
                return Err(self.error(Some(p.name), format!("{range}, but is {value}{unit}")));
            }
        }
        if let (Some(lower), Some(upper)) = (self.parameter("lower"), self.parameter("upper"))
            && lower > upper
        {
            return Err(self.error(Some("lower"), format!("is {lower}, above upper = {upper}")));
        }
        if let (Some(level), Some(asymmetry)) = (self.parameter("level"), self.parameter("asymmetry"))
            && asymmetry.abs() > level
        {
            let reason = format!("is {asymmetry}: beyond the level {level}, friction would drive the motion");
            return Err(self.error(Some("asymmetry"), reason));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_in_the_order_of_the_kinds() {
        for (index, spec) in SPECS.iter().enumerate() {
            assert_eq!(spec.kind as usize, index, "{}", spec.name);
            assert_eq!(Kind::from_name(spec.name).unwrap(), spec.kind);
        }
        assert_eq!(SPECS.len(), Kind::Outliers as usize + 1);
    }

    #[test]
    fn parameters_are_checked() {
        let message = |e: Result<Effect, EffectError>| e.unwrap_err().to_string();
        let negative = Effect::new(Kind::InputDelay, "u_roll", &[("delay_s", -0.1)]);
        assert!(message(negative).contains("delay_s must be from 0 s to 60 s, but is -0.1 s"));
        let missing = Effect::new(Kind::PulseDisturbance, "roll", &[("at_s", 1.0), ("duration_s", 1.0)]);
        assert!(message(missing).contains("magnitude is missing"));
        let typo = Effect::new(Kind::InputDelay, "u_roll", &[("delay", 0.1)]);
        assert!(message(typo).contains("did you mean 'delay_s'?"));
        let both = Effect::new(Kind::ParameterChange, "A[2,1]", &[("value", 1.0), ("factor", 2.0)]);
        assert!(message(both).contains("exactly one of value, factor"));
        let nan = Effect::new(Kind::Noise, "roll", &[("std", f64::NAN)]);
        assert!(message(nan).contains("not a finite number"));
        let crossed = Effect::new(Kind::InputSaturation, "u_roll", &[("lower", 1.0), ("upper", -1.0)]);
        assert!(message(crossed).contains("above upper"));
    }

    #[test]
    fn a_parameter_can_be_changed_within_its_range() {
        let mut lag = Effect::new(Kind::ActuatorLag, "u_roll", &[("time_constant_s", 0.1)]).unwrap();
        lag.set_parameter("time_constant_s", 0.2).unwrap();
        assert_eq!(lag.parameter("time_constant_s"), Some(0.2));
        assert!(lag.set_parameter("time_constant_s", -1.0).is_err());
        assert!(lag.set_parameter("tau", 1.0).is_err());
        assert_eq!(lag.parameter("time_constant_s"), Some(0.2));
    }
}
