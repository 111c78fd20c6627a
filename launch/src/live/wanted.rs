//! A change in flight, as the user writes it and as a request to the bench.

use std::hash::{BuildHasher, RandomState};

use whirlstand_logs::shown::shown;
use whirlstand_msgs::names::did_you_mean;
use whirlstand_msgs::units::{Quantity, Unit};
use whirlstand_msgs::{Adjustment, AdjustmentKind, Message};
use whirlstand_nodes::config::Engine;
use whirlstand_vehicle::{State, Vehicle};

use crate::error::Failure;
use crate::file::unknown;

/// Prefix of a state's name in the key of its setpoint.
const SETPOINT: &str = "setpoint.";

/// The engine's states by name, in the order of their numbers in the message.
const ENGINES: [(&str, Engine); 3] = [("off", Engine::Off), ("on", Engine::On), ("flying", Engine::Flying)];

/// A change in flight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Wanted {
    /// A disturbance that acts on a state.
    Gust {
        /// Index of the state.
        state: usize,
        /// Term added to the state's derivative, SI.
        size: f64,
        /// Duration in bench time, s.
        length_s: f64,
    },
    /// State of the engine.
    Engine(Engine),
    /// Setpoint of a state.
    Setpoint {
        /// Index of the state.
        state: usize,
        /// Value of the setpoint, SI.
        value: f64,
    },
    /// A factor on the law's feedback.
    Gain(f64),
    /// Ordered end of the run.
    Stop,
    /// Takes the stick over under this number, or gives it back (`None`).
    Stick(Option<u64>),
    /// Switches an effect that has a window on or off from now on.
    Effect {
        /// Index of the effect among those of the vehicle and the launch file.
        effect: usize,
        /// Whether the effect acts.
        on: bool,
    },
}

/// Prefix of the number of an effect in its key.
const EFFECT: &str = "effect.";

impl Wanted {
    /// Reads `STATE=SIZE`, such as `roll_rate=150deg/s^2`.
    ///
    /// # Errors
    /// For a state that the vehicle does not have, and a size that is not in its unit per second.
    pub fn gust(text: &str, length_s: f64, vehicle: &Vehicle) -> Result<Self, Failure> {
        let (name, value) = assignment(text, "roll_rate=\"150 deg/s^2\"")?;
        let (state, described) = state_of(name, vehicle)?;
        let unit = per_second(described.unit.unit());
        Ok(Self::Gust { state, size: amount(text, value, &unit)?, length_s })
    }

    /// Reads `setpoint.STATE=VALUE`, `gain=FACTOR`, `engine=off|on|flying`, `effect.N=off|on` or `run=stop`.
    ///
    /// # Errors
    /// For another key, a state that the vehicle does not have, and a value that does not fit.
    pub fn setting(text: &str, vehicle: &Vehicle) -> Result<Self, Failure> {
        let (key, value) = assignment(text, "setpoint.roll=\"5 deg\"")?;
        if let Some(name) = key.strip_prefix(SETPOINT) {
            let (state, described) = state_of(name, vehicle)?;
            return Ok(Self::Setpoint { state, value: amount(text, value, described.unit.unit())? });
        }
        if let Some(number) = key.strip_prefix(EFFECT) {
            return switch(text, number, value);
        }
        match key {
            "gain" => Ok(Self::Gain(amount(text, value, &Unit::ONE)?)),
            "run" if value == "stop" => Ok(Self::Stop),
            "run" => Err(Failure::Mend(format!("{text}: {}", unknown("run", value, ["stop"])))),
            "engine" => {
                let found = ENGINES.iter().find(|(name, _)| *name == value);
                let names = ENGINES.map(|(name, _)| name);
                let wrong = || Failure::Mend(format!("{text}: {}", unknown("engine", value, names)));
                found.map(|(_, engine)| Self::Engine(*engine)).ok_or_else(wrong)
            }
            _ => {
                let setpoints: Vec<_> =
                    vehicle.states.iter().map(|s| format!("{SETPOINT}{}", s.name)).collect();
                let keys = ["engine", "gain", "run"].into_iter().chain(setpoints.iter().map(String::as_str));
                let hint = did_you_mean(key, keys);
                Err(Failure::Mend(format!(
                    "'{key}' cannot be set in flight{hint}: effect.N, engine, gain, run and setpoint.STATE can"
                )))
            }
        }
    }

    /// The request message, with a unique number.
    pub fn request(&self) -> Adjustment {
        let mut request = Adjustment { id: RandomState::new().hash_one(0), ..Adjustment::zeroed() };
        let kind = match *self {
            Self::Gust { state, size, length_s } => {
                (request.index, request.value) = (state as u32, size);
                request.length_ns = (1e9 * length_s).round() as u64;
                AdjustmentKind::Gust
            }
            Self::Engine(engine) => {
                request.value = ENGINES.iter().position(|(_, e)| *e == engine).unwrap_or_default() as f64;
                AdjustmentKind::Engine
            }
            Self::Setpoint { state, value } => {
                (request.index, request.value) = (state as u32, value);
                AdjustmentKind::Setpoint
            }
            Self::Gain(factor) => {
                request.value = factor;
                AdjustmentKind::Gain
            }
            Self::Stop => AdjustmentKind::Stop,
            Self::Stick(hand) => {
                request.value = f64::from(u8::from(hand.is_some()));
                request.id = hand.unwrap_or(request.id);
                AdjustmentKind::Stick
            }
            Self::Effect { effect, on } => {
                (request.index, request.value) = (effect as u32, f64::from(u8::from(on)));
                AdjustmentKind::Effect
            }
        };
        request.what = kind as u32;
        request
    }

    /// Whether the plant carries out the change; the controller carries out all others.
    pub fn is_for_the_plant(&self) -> bool {
        !matches!(self, Self::Setpoint { .. } | Self::Gain(_) | Self::Stick(_))
    }

    /// Key of the launch file that permits the change.
    pub fn key(&self) -> &'static str {
        if self.is_for_the_plant() { "plant.inject" } else { "controller.pilot" }
    }

    /// The change as text, in the units of the vehicle file.
    pub fn text(&self, vehicle: &Vehicle) -> String {
        match *self {
            Self::Gust { state, size, length_s } => {
                let described = &vehicle.states[state];
                let unit = described.unit.shown().per_second();
                format!("gust on {}: {} for {}", described.name, unit.text(size), shown(length_s, "s"))
            }
            Self::Engine(engine) => {
                let name = ENGINES.iter().find(|(_, e)| *e == engine).map_or("", |(name, _)| name);
                format!("engine {name}")
            }
            Self::Setpoint { state, value } => {
                let described = &vehicle.states[state];
                format!("setpoint of {}: {}", described.name, described.unit.shown().text(value))
            }
            Self::Gain(factor) => format!("gain {factor}"),
            Self::Stop => "end of the run".into(),
            Self::Stick(Some(_)) => "you have the stick".into(),
            Self::Stick(None) => "the law flies".into(),
            Self::Effect { effect, on } => {
                format!("effect {} {}", effect + 1, if on { "on" } else { "off" })
            }
        }
    }
}

fn assignment<'t>(text: &'t str, example: &str) -> Result<(&'t str, &'t str), Failure> {
    let parts = text.split_once('=').map(|(name, value)| (name.trim(), value.trim()));
    parts.filter(|(name, value)| !name.is_empty() && !value.is_empty()).ok_or_else(|| {
        Failure::Mend(format!("'{text}' is not an assignment: write NAME=VALUE, as in {example}"))
    })
}

/// Reads the switching of an effect. Effects are numbered from 1, those of the vehicle file first.
fn switch(text: &str, number: &str, value: &str) -> Result<Wanted, Failure> {
    let effect = number.parse::<u32>().ok().and_then(|n| n.checked_sub(1));
    let effect = effect
        .ok_or_else(|| Failure::Mend(format!("{text}: the number of an effect, from 1, is expected")))?;
    let on = match value {
        "on" => true,
        "off" => false,
        _ => return Err(Failure::Mend(format!("{text}: {}", unknown("state", value, ["on", "off"])))),
    };
    Ok(Wanted::Effect { effect: effect as usize, on })
}

fn state_of<'v>(name: &str, vehicle: &'v Vehicle) -> Result<(usize, &'v State), Failure> {
    let index = vehicle.state_index(name).ok_or_else(|| {
        let known = vehicle.states.iter().map(|s| s.name.as_str());
        Failure::Mend(format!("{} of the vehicle {}", unknown("state", name, known), vehicle.name))
    })?;
    Ok((index, &vehicle.states[index]))
}

/// The unit of a state's derivative.
fn per_second(unit: &Unit) -> Unit {
    let symbol = unit.si_symbol();
    let text = if symbol.is_empty() { "1/s".into() } else { format!("{symbol}/s") };
    // A valid unit divided by s is a valid unit.
    text.parse().unwrap_or(Unit::ONE)
}

fn amount(text: &str, value: &str, unit: &Unit) -> Result<f64, Failure> {
    let wrong = |e: &dyn std::fmt::Display| Failure::Mend(format!("{text}: {e}"));
    let quantity: Quantity = value.trim_matches('"').parse().map_err(|e| wrong(&e))?;
    quantity.in_unit(unit).map_err(|e| wrong(&e))?;
    Ok(quantity.si)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_are_read_with_their_units_and_mistakes_are_told() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let rate = vehicle.state_index("roll_rate").unwrap();
        assert_eq!(
            Wanted::gust("roll_rate=180deg/s^2", 0.2, &vehicle).unwrap(),
            Wanted::Gust { state: rate, size: std::f64::consts::PI, length_s: 0.2 }
        );
        let set = |text: &str| Wanted::setting(text, &vehicle);
        assert_eq!(set("setpoint.roll=\"5 deg\"").unwrap().text(&vehicle), "setpoint of roll: 5.00 deg");
        assert_eq!(set("engine=on").unwrap(), Wanted::Engine(Engine::On));
        assert_eq!(set("gain=1.2").unwrap(), Wanted::Gain(1.2));
        for (text, said) in [
            ("setpoint.roll=5", "a quantity in rad is expected"),
            ("setpoint.rol=5deg", "did you mean 'roll'?"),
            ("roll=5deg", "did you mean 'setpoint.roll'?"),
            ("engine=of", "did you mean 'off'?"),
            ("run=stpo", "did you mean 'stop'?"),
            ("effect.0=on", "from 1"),
            ("effect.1=onn", "did you mean 'on'?"),
            ("gain", "NAME=VALUE"),
            ("gain=2 s", "no unit is expected"),
        ] {
            let error = set(text).unwrap_err().to_string();
            assert!(error.contains(said), "{text}: {error}");
        }
        let error = Wanted::gust("roll_rate=150deg/s", 0.2, &vehicle).unwrap_err().to_string();
        assert!(error.contains("a quantity in rad/s^2 is expected"), "{error}");
    }

    #[test]
    fn every_request_has_a_number_of_its_own() {
        let (a, b) = (Wanted::Gain(2.0).request(), Wanted::Gain(2.0).request());
        assert_ne!(a.id, b.id);
        assert_eq!((a.what, a.value, a.verdict), (AdjustmentKind::Gain as u32, 2.0, 0));
        let engine = Wanted::Engine(Engine::Flying).request();
        assert_eq!((engine.what, engine.value), (AdjustmentKind::Engine as u32, 2.0));
    }
}
