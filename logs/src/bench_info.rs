//! The description in a log of the bench on which it was recorded.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use whirlstand_msgs::units::{ShownUnit, Unit};

/// Name of the MCAP metadata record that holds a [`BenchInfo`].
pub const METADATA_NAME: &str = "whirlstand";
/// Name of the attachment with the launch file's text.
pub const LAUNCH_ATTACHMENT: &str = "launch.toml";
/// Name of the attachment with the vehicle file's text.
pub const VEHICLE_ATTACHMENT: &str = "vehicle.toml";

/// A named state, input or output.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SignalInfo {
    /// Name as in the vehicle file.
    pub name: String,
    /// SI unit, as [`whirlstand_msgs::units::Unit`] writes it; empty for a pure number.
    pub unit: String,
    /// Unit in which values are shown, as the vehicle file declares it; empty where that is unknown.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub shown: String,
}

impl SignalInfo {
    /// A signal called `name` in the SI unit `unit`.
    pub fn new(name: impl Into<String>, unit: impl Into<String>) -> Self {
        Self { name: name.into(), unit: unit.into(), shown: String::new() }
    }

    /// A signal with the unit in which it is shown.
    pub fn of(name: impl Into<String>, unit: &ShownUnit) -> Self {
        Self { shown: unit.symbol().into(), ..Self::new(name, unit.si_symbol()) }
    }

    /// The unit in which values are shown.
    pub fn shown_unit(&self) -> ShownUnit {
        let declared = self.shown.parse::<Unit>().ok().filter(|unit| unit.si_symbol() == self.unit);
        match declared {
            Some(unit) if !self.shown.is_empty() => ShownUnit::declared(&unit, &self.shown),
            _ => ShownUnit::of(&self.unit),
        }
    }
}

/// Description of the bench that recorded a log, and the names of the signals in its messages.
///
/// It is written as one MCAP metadata record called [`METADATA_NAME`]. Every field is a text under its own key,
/// with lists as JSON, so that any MCAP tool shows it.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct BenchInfo {
    /// Version of the program that recorded the log.
    pub version: String,
    /// Name of the launch file.
    pub launch: String,
    /// Name of the vehicle.
    pub vehicle: String,
    /// `realtime` or `lockstep`.
    pub mode: String,
    /// `iceoryx2`, `zenoh` or `inproc`.
    pub transport: String,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Period of the loop, ns.
    pub period_ns: u64,
    /// Wall-clock time at which the recorder started, ns since the Unix epoch.
    pub started_unix_ns: u64,
    /// States in the order of `Truth::x` and `Estimate::x`.
    pub states: Vec<SignalInfo>,
    /// Inputs in the order of `Truth::u` and `Command::u`.
    pub inputs: Vec<SignalInfo>,
    /// Outputs that the vehicle's sensors measure.
    pub outputs: Vec<SignalInfo>,
    /// Further entries that the recorder was told to keep.
    pub extra: BTreeMap<String, String>,
}

impl BenchInfo {
    /// The fields as texts of the metadata record.
    pub(crate) fn to_map(&self) -> BTreeMap<String, String> {
        let list = |signals: &[SignalInfo]| {
            // A signal is two strings, which JSON always accepts.
            serde_json::to_string(signals).unwrap_or_else(|e| unreachable!("names as JSON: {e}"))
        };
        let mut map = self.extra.clone();
        for (key, text) in [
            ("version", self.version.clone()),
            ("launch", self.launch.clone()),
            ("vehicle", self.vehicle.clone()),
            ("mode", self.mode.clone()),
            ("transport", self.transport.clone()),
            ("seed", self.seed.to_string()),
            ("period_ns", self.period_ns.to_string()),
            ("started_unix_ns", self.started_unix_ns.to_string()),
            ("states", list(&self.states)),
            ("inputs", list(&self.inputs)),
            ("outputs", list(&self.outputs)),
        ] {
            map.insert(key.into(), text);
        }
        map
    }

    /// Reads the texts that [`Self::to_map`] wrote. The error names the key whose text is invalid.
    pub(crate) fn from_map(map: &BTreeMap<String, String>) -> Result<Self, String> {
        let mut rest = map.clone();
        let mut take = |key: &str| rest.remove(key).unwrap_or_default();
        let number = |key: &str, text: String| {
            if text.is_empty() {
                Ok(0)
            } else {
                text.parse().map_err(|_| format!("{key} is '{text}', not a number"))
            }
        };
        let list = |key: &str, text: String| -> Result<Vec<SignalInfo>, String> {
            if text.is_empty() {
                return Ok(Vec::new());
            }
            serde_json::from_str(&text).map_err(|e| format!("{key} is not a list of signals: {e}"))
        };
        Ok(Self {
            version: take("version"),
            launch: take("launch"),
            vehicle: take("vehicle"),
            mode: take("mode"),
            transport: take("transport"),
            seed: number("seed", take("seed"))?,
            period_ns: number("period_ns", take("period_ns"))?,
            started_unix_ns: number("started_unix_ns", take("started_unix_ns"))?,
            states: list("states", take("states"))?,
            inputs: list("inputs", take("inputs"))?,
            outputs: list("outputs", take("outputs"))?,
            extra: rest,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_texts_read_back() {
        let info = BenchInfo {
            version: "0.1.0".into(),
            vehicle: "quadrotor".into(),
            seed: u64::MAX,
            period_ns: 5_000_000,
            states: vec![SignalInfo::new("roll", "rad"), SignalInfo::new("roll_rate", "rad/s")],
            inputs: vec![SignalInfo::new("u_roll", "")],
            extra: BTreeMap::from([("pilot".into(), "none".into())]),
            ..BenchInfo::default()
        };
        assert_eq!(BenchInfo::from_map(&info.to_map()).unwrap(), info);
        assert_eq!(BenchInfo::from_map(&BTreeMap::new()).unwrap(), BenchInfo::default());
    }

    #[test]
    fn a_damaged_text_is_named() {
        let map = BTreeMap::from([("seed".to_string(), "seven".to_string())]);
        assert_eq!(BenchInfo::from_map(&map).unwrap_err(), "seed is 'seven', not a number");
        let map = BTreeMap::from([("states".to_string(), "[1]".to_string())]);
        assert!(BenchInfo::from_map(&map).unwrap_err().starts_with("states is not a list of signals"));
    }
}
