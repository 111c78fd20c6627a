//! `[expect]`: what must hold at the end of a run, read and checked against the vehicle.

use std::collections::BTreeMap;
use whirlstand_msgs::units::ShownUnit;

use whirlstand_evaluate::Expectation;
use whirlstand_evaluate::expectation::{BENCH_LIMITS, signal_figures, strict_bridge_limits, strict_limits};
use whirlstand_msgs::units::Unit;
use whirlstand_nodes::config::Mode;
use whirlstand_vehicle::Vehicle;

use super::amount::Amount;
use super::document::{Document, LaunchError, at};
use super::wording::unknown;

/// Reads the limits of the section, in SI, and checks their keys and units against the vehicle. The limits of
/// [`strict_limits`], and with a bridge those of [`strict_bridge_limits`], come first with their strict values
/// where the section does not state them.
pub(super) fn read(
    document: &Document,
    vehicle: &Vehicle,
    mode: Mode,
    is_bridged: bool,
    keys: &[&String],
) -> Result<Vec<Expectation>, LaunchError> {
    let mut all: Vec<Expectation> = strict_limits(mode == Mode::Realtime).into();
    if is_bridged {
        all.extend(strict_bridge_limits());
    }
    all.retain(|strict| !keys.contains(&&strict.key));
    for &key in keys {
        if let Some((_, unit)) = BENCH_LIMITS.iter().find(|(known, _)| known == key) {
            let unit_of_limit = unit.parse().unwrap_or(Unit::ONE);
            let limit = limit(document, at!["expect", key], &unit_of_limit, key, |_| None)?;
            all.push(Expectation { key: key.clone(), limit, unit: ShownUnit::si(unit) });
        } else if let Some(known) = signal_figures(vehicle, key) {
            let figures: BTreeMap<String, Amount> = document.read_at(at!["expect", key])?.unwrap_or_default();
            for figure in figures.keys() {
                let here: &[_] = at!["expect", key, figure];
                let Some((_, unit)) = known.iter().find(|(name, _)| name == figure) else {
                    let names = known.iter().map(|(name, _)| *name);
                    return Err(document.error_at(here, unknown("figure", figure, names)));
                };
                let name = format!("{key}.{figure}");
                let limit = limit(document, here, &unit.unit, &name, |value| unit.two_readings(value))?;
                all.push(Expectation { key: name, limit, unit: unit.shown() });
            }
        } else {
            let signals = vehicle.outputs.iter().map(|o| o.name.as_str());
            let signals = signals.chain(vehicle.inputs.iter().map(|u| u.name.as_str()));
            let known = BENCH_LIMITS.iter().map(|(k, _)| *k).chain(signals);
            return Err(document.error_at(at!["expect", key], unknown("key", key, known)));
        }
    }
    Ok(all)
}

/// A limit in SI; `readings` explains why a number without a unit is ambiguous here.
fn limit(
    document: &Document,
    here: &[super::document::Step<'_>],
    unit: &Unit,
    name: &str,
    readings: impl Fn(f64) -> Option<String>,
) -> Result<f64, LaunchError> {
    let amount: Option<Amount> = document.read_at(here)?;
    if let Some(Amount::Si(value)) = amount
        && let Some(why) = readings(value)
    {
        return Err(document.error_at(here, format!("{name} {why}")));
    }
    let limit = amount.map_or(Ok(f64::NAN), |a| a.si(unit));
    let limit = limit.map_err(|e| document.error_at(here, e.to_string()))?;
    if limit >= 0.0 {
        Ok(limit)
    } else {
        Err(document.error_at(here, format!("an upper limit of at least 0 is expected, not {limit}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn expectations(text: &str) -> Result<Vec<Expectation>, LaunchError> {
        expectations_of(text, false)
    }

    fn expectations_of(text: &str, is_bridged: bool) -> Result<Vec<Expectation>, LaunchError> {
        let document = Document::parse("a.toml", text).unwrap();
        let whole: BTreeMap<String, BTreeMap<String, serde::de::IgnoredAny>> = document.read().unwrap();
        let keys: Vec<&String> = whole["expect"].keys().collect();
        read(&document, &Vehicle::builtin("quadrotor").unwrap(), Mode::Lockstep, is_bridged, &keys)
    }

    #[test]
    fn limits_carry_units_and_are_in_si() {
        let all =
            expectations("[expect]\nmax_lost = 0\nroll.peak = '10 deg'\nroll.recovery_s = 2\n").unwrap();
        let all = &all[strict_limits(false).len()..];
        let found: Vec<_> = all.iter().map(|e| (e.key.as_str(), e.unit.si_symbol())).collect();
        assert_eq!(found, [("max_lost", ""), ("roll.peak", "rad"), ("roll.recovery_s", "s")]);
        assert!((all[1].limit - 10f64.to_radians()).abs() < 1e-15);
    }

    #[test]
    fn what_tells_control_from_its_absence_is_limited_unless_the_file_says_otherwise() {
        let limits = |text| {
            let mut all = expectations(text).unwrap();
            all.sort_by(|a, b| a.key.cmp(&b.key));
            all.into_iter().map(|e| (e.key, e.limit)).collect::<Vec<_>>()
        };
        let strict = |restarts| {
            [
                "max_failsafe_at_end",
                "max_failsafe_share",
                "max_refused_commands",
                "max_rejected",
                "max_restarts",
            ]
            .map(|key| (key.to_string(), if key == "max_restarts" { restarts } else { 0.0 }))
        };
        assert_eq!(limits("[expect]\n"), strict(0.0));
        assert_eq!(limits("[expect]\nmax_restarts = 3\n"), strict(3.0));
    }

    #[test]
    fn behind_a_bridge_nobody_but_the_controller_may_be_in_charge_unless_the_file_says_otherwise() {
        let shares = |text, is_bridged| {
            let all = expectations_of(text, is_bridged).unwrap();
            let limit = |key: &str| all.iter().find(|e| e.key == key).map(|e| e.limit);
            assert_eq!(all.iter().filter(|e| e.key == "max_pilot_share").count(), usize::from(is_bridged));
            (limit("max_disarmed_share"), limit("max_pilot_share"))
        };
        assert_eq!(shares("[expect]\n", false), (None, None));
        assert_eq!(shares("[expect]\n", true), (Some(0.0), Some(0.0)));
        assert_eq!(shares("[expect]\nmax_pilot_share = 0.5\n", true), (Some(0.0), Some(0.5)));
    }

    #[test]
    fn mistakes_are_told_with_line_and_nearest_name() {
        for (text, line, word) in [
            ("[expect]\nmax_misses = 0\n", "line 2", "max_deadline_misses"),
            ("[expect]\n\nrol.peak = 1\n", "line 3", "'roll'"),
            ("[expect]\nroll.peek = 1\n", "line 2", "'peak'"),
            ("[expect]\nroll.peak = '1 m'\n", "line 2", "rad"),
            (
                "[expect]\nroll.peak = 10\n",
                "line 2",
                "roll.peak is 10 without a unit: 10 rad = 573 deg, or 10 deg",
            ),
            (
                "[expect]\nroll.iae = 1\n",
                "line 2",
                "1 rad*s, or 0.0175 rad*s by the units that the file declares",
            ),
            ("[expect]\nmax_lost = -1\n", "line 2", "at least 0"),
        ] {
            let error = expectations(text).unwrap_err();
            assert!(error.place.ends_with(line) && error.message.contains(word), "{text}: {error}");
        }
    }
}
