//! `[expect]`: what must hold at the end of a run.

use std::collections::BTreeMap;

use serde::Serialize;
use whirlstand_ident::summary::{INPUT_KEYS, OUTPUT_KEYS};
use whirlstand_ident::units::shown;
use whirlstand_msgs::units::Unit;
use whirlstand_vehicle::Vehicle;

use super::amount::Amount;
use super::document::{Document, LaunchError, at};
use super::wording::unknown;

/// Counts and times of the whole bench that can be limited, with their unit.
const OF_THE_BENCH: [(&str, &str); 6] = [
    ("max_deadline_misses", ""),
    ("max_latency_p99_s", "s"),
    ("max_latency_s", "s"),
    ("max_lost", ""),
    ("max_rejected", ""),
    ("max_restarts", ""),
];

/// SI unit of a figure of a signal in `unit`; see the keys in `whirlstand_ident::summary`.
fn unit_of_figure(figure: &str, unit: &str) -> String {
    let times_s = |power: &str| match unit {
        "" => "s".to_string(),
        unit => format!("{unit}{power}*s"),
    };
    match figure {
        "recovery_s" | "rise_s" | "settling_s" => "s".into(),
        "overshoot_percent" | "saturated" => String::new(),
        "iae" => times_s(""),
        "ise" => times_s("^2"),
        "travel_per_s" if unit.is_empty() => "1/s".into(),
        "travel_per_s" => format!("{unit}/s"),
        _ => unit.into(),
    }
}

/// One figure that must not be greater than its limit.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Expectation {
    /// Key as in the launch file, for example `roll.peak`.
    pub key: String,
    /// Upper limit, SI.
    pub limit: f64,
    /// SI unit of the limit.
    pub unit: String,
}

/// A figure of a finished run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Figure {
    /// In SI.
    Value(f64),
    /// It never came to that: the output did not recover or settle.
    Never,
}

/// How an expectation turned out.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Verdict {
    /// Key as in the launch file.
    pub key: String,
    /// The limit, SI.
    pub limit: f64,
    /// What was found, SI; null when it never came to that or was not measured.
    pub found: Option<f64>,
    /// SI unit of both.
    pub unit: String,
    /// Whether it holds.
    pub holds: bool,
    /// In words, when it does not hold.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
}

/// Reads and checks the section against the vehicle.
pub(super) fn read(
    document: &Document,
    vehicle: &Vehicle,
    keys: &[&String],
) -> Result<Vec<Expectation>, LaunchError> {
    let mut all = Vec::new();
    for &key in keys {
        if let Some((_, unit)) = OF_THE_BENCH.iter().find(|(known, _)| known == key) {
            let limit = limit(document, at!["expect", key], unit)?;
            all.push(Expectation { key: key.clone(), limit, unit: (*unit).into() });
        } else if let Some((unit, known)) = signal(vehicle, key) {
            let figures: BTreeMap<String, Amount> = document.read_at(at!["expect", key])?.unwrap_or_default();
            for figure in figures.keys() {
                let here: &[_] = at!["expect", key, figure];
                if !known.contains(&figure.as_str()) {
                    return Err(document.error_at(here, unknown("figure", figure, known.iter().copied())));
                }
                let unit = unit_of_figure(figure, &unit);
                let limit = limit(document, here, &unit)?;
                all.push(Expectation { key: format!("{key}.{figure}"), limit, unit });
            }
        } else {
            let signals = vehicle.outputs.iter().map(|o| o.name.as_str());
            let signals = signals.chain(vehicle.inputs.iter().map(|u| u.name.as_str()));
            let known = OF_THE_BENCH.iter().map(|(k, _)| *k).chain(signals);
            return Err(document.error_at(at!["expect", key], unknown("key", key, known)));
        }
    }
    Ok(all)
}

/// SI unit of an output or input, and the figures that it has.
fn signal(vehicle: &Vehicle, name: &str) -> Option<(String, &'static [&'static str])> {
    let output = vehicle.output_index(name).map(|i| (vehicle.outputs[i].unit.si_symbol(), &OUTPUT_KEYS[..]));
    output
        .or_else(|| vehicle.input_index(name).map(|i| (vehicle.inputs[i].unit.si_symbol(), &INPUT_KEYS[..])))
}

fn limit(document: &Document, here: &[super::document::Step<'_>], unit: &str) -> Result<f64, LaunchError> {
    let unit: Unit = unit.parse().unwrap_or(Unit::ONE);
    let amount: Option<Amount> = document.read_at(here)?;
    let limit = amount.map_or(Ok(f64::NAN), |a| a.si(&unit));
    let limit = limit.map_err(|e| document.error_at(here, e.to_string()))?;
    if limit >= 0.0 {
        Ok(limit)
    } else {
        Err(document.error_at(here, format!("an upper limit of at least 0 is expected, not {limit}")))
    }
}

/// Holds the figures of a run against the expectations. What was not measured does not hold.
pub(crate) fn judge(expectations: &[Expectation], figures: &BTreeMap<String, Figure>) -> Vec<Verdict> {
    let judge = |e: &Expectation| {
        let figure = figures.get(&e.key).copied();
        let (found, why) = match figure {
            Some(Figure::Value(value)) if value <= e.limit => (Some(value), None),
            Some(Figure::Value(value)) => (
                Some(value),
                Some(format!(
                    "{} is {}, above the limit {}",
                    e.key,
                    shown(value, &e.unit),
                    shown(e.limit, &e.unit)
                )),
            ),
            Some(Figure::Never) => (
                None,
                Some(format!("{}: it never came to that, the limit is {}", e.key, shown(e.limit, &e.unit))),
            ),
            None => (None, Some(format!("{} was not measured in this run", e.key))),
        };
        Verdict { key: e.key.clone(), limit: e.limit, found, unit: e.unit.clone(), holds: why.is_none(), why }
    };
    expectations.iter().map(judge).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn expectations(text: &str) -> Result<Vec<Expectation>, LaunchError> {
        let document = Document::parse("a.toml", text).unwrap();
        let whole: BTreeMap<String, BTreeMap<String, serde::de::IgnoredAny>> = document.read().unwrap();
        let keys: Vec<&String> = whole["expect"].keys().collect();
        read(&document, &Vehicle::builtin("quadrotor").unwrap(), &keys)
    }

    #[test]
    fn limits_carry_units_and_are_in_si() {
        let all =
            expectations("[expect]\nmax_lost = 0\nroll.peak = '10 deg'\nroll.recovery_s = 2\n").unwrap();
        let found: Vec<_> = all.iter().map(|e| (e.key.as_str(), e.unit.as_str())).collect();
        assert_eq!(found, [("max_lost", ""), ("roll.peak", "rad"), ("roll.recovery_s", "s")]);
        assert!((all[1].limit - 10f64.to_radians()).abs() < 1e-15);
    }

    #[test]
    fn mistakes_are_told_with_line_and_nearest_name() {
        for (text, line, word) in [
            ("[expect]\nmax_misses = 0\n", "line 2", "max_deadline_misses"),
            ("[expect]\n\nrol.peak = 1\n", "line 3", "'roll'"),
            ("[expect]\nroll.peek = 1\n", "line 2", "'peak'"),
            ("[expect]\nroll.peak = '1 m'\n", "line 2", "rad"),
            ("[expect]\nmax_lost = -1\n", "line 2", "at least 0"),
        ] {
            let error = expectations(text).unwrap_err();
            assert!(error.place.ends_with(line) && error.message.contains(word), "{text}: {error}");
        }
    }

    #[test]
    fn what_was_not_measured_or_never_came_does_not_hold() {
        let all =
            expectations("[expect]\nmax_lost = 0\nroll.peak = 1\nroll.recovery_s = 2\nmax_restarts = 0\n")
                .unwrap();
        let figures = BTreeMap::from([
            ("max_lost".to_string(), Figure::Value(0.0)),
            ("roll.peak".to_string(), Figure::Value(1.5)),
            ("roll.recovery_s".to_string(), Figure::Never),
        ]);
        let verdicts = judge(&all, &figures);
        let holding: Vec<_> = verdicts.iter().filter(|v| v.holds).map(|v| v.key.as_str()).collect();
        assert_eq!(holding, ["max_lost"]);
        assert!(
            verdicts
                .iter()
                .any(|v| v.key == "max_restarts" && v.why.as_ref().unwrap().contains("not measured"))
        );
    }
}
