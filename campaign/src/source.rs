//! Results of other commands as varying quantities: parameters with their covariance from `identify`, effects with
//! their intervals from `diagnose`.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::quantity::{Quantity, Spread, Variation};
use crate::together::{Correlations, key, together};

/// Schemas of the answers that are read.
const IDENTIFICATION: &str = "whirlstand.identification.v1";
const DIAGNOSIS: &str = "whirlstand.diagnosis.v1";

/// Standard deviations from the centre to either end of an interval that holds 95 %.
const NINETY_FIVE: f64 = 1.96;

/// Number of standard deviations within which a parameter whose interval has one sign must keep that sign;
/// otherwise it is drawn uniformly.
const WITHIN: f64 = 5.0;

/// The data that are kept of an answer: enough to draw from it, and small enough to be stored with every part
/// of a campaign.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Answer {
    schema: String,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    parameters: Vec<Parameter>,
    #[serde(default, skip_serializing_if = "Correlations::is_empty")]
    correlations: Correlations,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    standard_errors_hold: Option<bool>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    causes: Vec<Cause>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Parameter {
    name: String,
    value: f64,
    standard_error: Option<f64>,
    #[serde(default)]
    unit: String,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Cause {
    effect: String,
    #[serde(rename = "where")]
    place: String,
    parameters: BTreeMap<String, Estimate>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    text: Option<String>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Estimate {
    value: f64,
    low: f64,
    high: f64,
    #[serde(default)]
    unit: String,
}

/// Additions of a source to a campaign.
#[derive(Debug, Default)]
pub(crate) struct Added {
    /// Effects, as tables of `[[effects]]`.
    pub effects: Vec<toml::Table>,
    /// Names of the parameters of these effects, with the effect's index in `effects` and the parameter.
    pub names: Vec<(String, usize, String)>,
    /// Variation of these parameters.
    pub quantities: Vec<Quantity>,
}

impl Answer {
    /// Reads the answer of `identify --json` or `diagnose --json`.
    ///
    /// # Errors
    /// A sentence on what it is instead.
    pub fn parse(json: &str) -> Result<Self, String> {
        let answer: Self = serde_json::from_str(json)
            .map_err(|e| format!("it is not a result of identify or diagnose as written by --json: {e}"))?;
        match answer.schema.as_str() {
            IDENTIFICATION | DIAGNOSIS => Ok(answer),
            other => Err(format!("{IDENTIFICATION} or {DIAGNOSIS} is expected, not {other}")),
        }
    }

    /// The answer as JSON in one line.
    pub fn to_json(&self) -> String {
        // Strings and finite numbers: nothing that JSON cannot hold.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// The additions to a campaign: all parameters, or those that `only` names. `widen` multiplies standard
    /// deviations.
    ///
    /// # Errors
    /// A sentence on a parameter that cannot be drawn.
    pub fn added(&self, only: &[String], widen: Option<f64>) -> Result<Added, String> {
        if widen.is_some_and(|factor| !(factor > 0.0 && factor.is_finite())) {
            return Err("`widen` must be above 0".into());
        }
        let added = match self.schema.as_str() {
            IDENTIFICATION => self.identified(only, widen)?,
            _ => self.diagnosed(only, widen.unwrap_or(1.0))?,
        };
        if let Some(absent) = only.iter().find(|name| !added.names.iter().any(|(known, ..)| known == *name)) {
            return Err(format!("it has no parameter {absent}"));
        }
        if added.names.is_empty() {
            return Err("it contains nothing to vary".into());
        }
        Ok(added)
    }

    fn identified(&self, only: &[String], widen: Option<f64>) -> Result<Added, String> {
        if self.standard_errors_hold == Some(false) && widen.is_none() {
            return Err(
                "its standard errors are marked as unreliable: the record has an effect that the model does not \
                 include, or the search ended early; set `widen` to multiply them by a factor"
                    .into(),
            );
        }
        let wanted = |p: &Parameter| only.is_empty() || only.contains(&p.name);
        let chosen: Vec<usize> =
            (0..self.parameters.len()).filter(|i| wanted(&self.parameters[*i])).collect();
        let mut added = Added::default();
        let mut each = Vec::new();
        for parameter in chosen.iter().map(|i| &self.parameters[*i]) {
            let Parameter { name, value, standard_error, unit } = parameter;
            if name.contains('(') {
                return Err(format!(
                    "{name} belongs to an effect of the vehicle file, which a launch file cannot change: use `only` \
                     to name what varies, such as only = [\"A[2,1]\"]"
                ));
            }
            let error = standard_error.filter(|e| *e > 0.0 && e.is_finite()).ok_or_else(|| {
                format!("{name} has no standard error: method ga does not provide any, and a parameter at its bound has none")
            })?;
            let mut effect = toml::Table::new();
            effect.insert("effect".into(), "parameter_change".into());
            effect.insert("where".into(), name.clone().into());
            effect.insert("value".into(), amount(*value, unit));
            added.names.push((name.clone(), added.effects.len(), "value".into()));
            added.effects.push(effect);
            let std = error * widen.unwrap_or(1.0);
            each.push(Spread::Normal { mean: *value, std, unit: unit.clone() });
        }
        let keys = added.names.iter().map(|(name, ..)| name.clone()).collect();
        let correlation = |i: usize, j: usize| self.correlations.at(chosen[i], chosen[j]);
        added.quantities = vec![together(keys, each, correlation)?];
        Ok(added)
    }

    fn diagnosed(&self, only: &[String], widen: f64) -> Result<Added, String> {
        let (mut added, mut each) = (Added::default(), Vec::new());
        for Cause { effect: kind, place, parameters, text } in &self.causes {
            let key = |parameter: &str| key(kind, place, parameter);
            if !only.is_empty() && !parameters.keys().any(|parameter| only.contains(&key(parameter))) {
                continue;
            }
            if text.is_some() && kind == "mode_transition" {
                return Err(format!(
                    "{}: a transition to another vehicle cannot be added: use `only` to name other effects",
                    key("to")
                ));
            }
            let mut effect = toml::Table::new();
            effect.insert("effect".into(), kind.clone().into());
            effect.insert("where".into(), place.clone().into());
            for (parameter, estimate) in parameters {
                effect.insert(parameter.clone(), amount(estimate.value, &estimate.unit));
                let wanted = only.is_empty() || only.contains(&key(parameter));
                if let Some(spread) = estimate.spread(widen).filter(|_| wanted) {
                    added.names.push((key(parameter), added.effects.len(), parameter.clone()));
                    each.push(spread);
                }
            }
            added.effects.push(effect);
        }
        let keys: Vec<String> = added.names.iter().map(|(name, ..)| name.clone()).collect();
        let correlation = |i: usize, j: usize| self.correlations.between(&keys[i], &keys[j]);
        let apart = (0..keys.len()).all(|i| (0..i).all(|j| correlation(i, j) == 0.0));
        added.quantities = match apart {
            true => {
                let one = |(key, spread)| Quantity {
                    keys: vec![key],
                    variation: Variation::One(spread),
                    levels: None,
                };
                keys.into_iter().zip(each).map(one).collect()
            }
            false => vec![together(keys.clone(), each, correlation)?],
        };
        Ok(added)
    }
}

impl Estimate {
    /// A normal distribution from the interval, or a uniform one where a normal one could lose the sign of the
    /// interval, such as that of a delay. `None` without an interval.
    fn spread(&self, widen: f64) -> Option<Spread> {
        let std = widen * (self.high - self.low) / (2.0 * NINETY_FIVE);
        if !(std > 0.0 && std.is_finite()) {
            return None;
        }
        let (value, unit) = (self.value, self.unit.clone());
        let keeps_sign =
            self.low >= 0.0 && value - WITHIN * std < 0.0 || self.high <= 0.0 && value + WITHIN * std > 0.0;
        Some(match keeps_sign {
            true => Spread::Uniform { ends: [self.low, self.high], unit },
            false => Spread::Normal { mean: value, std, unit },
        })
    }
}

fn amount(value: f64, unit: &str) -> toml::Value {
    if unit.is_empty() { toml::Value::Float(value) } else { format!("{value:?} {unit}").into() }
}

#[cfg(test)]
mod tests {
    use nalgebra::DMatrix;

    use super::*;
    use crate::quantity::Value;

    const IDENTIFIED: &str = r#"{"schema": "whirlstand.identification.v1", "standard_errors_hold": true, "verdict": "fits",
        "parameters": [
            {"name": "A[2,1]", "value": -1.1, "standard_error": 0.1, "unit": "1/s^2", "lower": -30.0},
            {"name": "B[2,1]", "value": 4.0, "standard_error": 0.5, "unit": "deg/s^2"}],
        "correlations": [[1.0, 0.8], [0.8, 1.0]]}"#;

    const DIAGNOSED: &str = r#"{"schema": "whirlstand.diagnosis.v1", "causes": [
        {"effect": "input_delay", "where": "u_roll",
         "parameters": {"delay_s": {"value": 0.02, "low": 0.0, "high": 0.04, "unit": "s"}}},
        {"effect": "sensor_bias", "where": "roll",
         "parameters": {"offset": {"value": 0.1, "low": 0.08, "high": 0.12, "unit": "rad"}}}]}"#;

    fn matrix(correlation: f64) -> DMatrix<f64> {
        DMatrix::from_row_slice(2, 2, &[1.0, correlation, correlation, 1.0])
    }

    fn added(json: &str, only: &[&str], widen: Option<f64>) -> Result<Added, String> {
        let only: Vec<String> = only.iter().map(|name| (*name).to_string()).collect();
        let kept = Answer::parse(json)?.to_json();
        Answer::parse(&kept)?.added(&only, widen)
    }

    #[test]
    fn identified_parameters_are_drawn_with_their_covariance() {
        let all = added(IDENTIFIED, &[], None).unwrap();
        assert_eq!(all.effects[1]["value"].as_str(), Some("4.0 deg/s^2"));
        let normal = |mean, std, unit: &str| Spread::Normal { mean, std, unit: unit.into() };
        let Variation::Joint { each, root } = &all.quantities[0].variation else { panic!("{all:?}") };
        assert_eq!(each, &[normal(-1.1, 0.1, "1/s^2"), normal(4.0, 0.5, "deg/s^2")]);
        assert!((root * root.transpose() - matrix(0.8)).amax() < 1e-12, "{root}");
        let wide = added(IDENTIFIED, &["B[2,1]"], Some(2.0)).unwrap();
        assert_eq!(wide.names, [("B[2,1]".to_string(), 0, "value".to_string())]);
        let Variation::Joint { each, .. } = &wide.quantities[0].variation else { panic!("{wide:?}") };
        assert_eq!(each, &[normal(4.0, 1.0, "deg/s^2")]);
    }

    #[test]
    fn causes_are_drawn_within_their_intervals_and_keep_their_sign() {
        let all = added(DIAGNOSED, &[], None).unwrap();
        assert_eq!(all.quantities.len(), 2);
        assert_eq!(all.names[0], ("input_delay(u_roll).delay_s".to_string(), 0, "delay_s".to_string()));
        assert!((0..100).all(|i| {
            let drawn = all.quantities[0].at(&[(f64::from(i) + 0.5) / 100.0]);
            drawn[0].number().is_some_and(|delay| (0.0..=0.04).contains(&delay))
        }));
        let one = all.quantities[1].at(&[0.5]);
        assert!(matches!(&one[0], Value::Number(n) if (n.value - 0.1).abs() < 1e-9 && n.unit == "rad"));
        assert_eq!(added(DIAGNOSED, &["sensor_bias(roll).offset"], None).unwrap().effects.len(), 1);
    }

    /// The pairs are in no order, and the delay is drawn evenly because a normal one could be negative.
    #[test]
    fn causes_hang_together_as_the_diagnosis_says() {
        let text = DIAGNOSED.replace(
            "\n        {\"effect\": \"sensor_bias\"",
            "{\"effect\": \"actuator_lag\", \"where\": \"u_roll\", \"parameters\": {\"time_constant_s\": {\"value\": 0.1, \
             \"low\": 0.08, \"high\": 0.12, \"unit\": \"s\"}}},\n{\"effect\": \"sensor_bias\"",
        );
        let place = |effect: &str, at: &str, parameter: &str| {
            format!("{{\"effect\": \"{effect}\", \"where\": \"{at}\", \"parameter\": \"{parameter}\"}}")
        };
        let (delay, lag) =
            (place("input_delay", "u_roll", "delay_s"), place("actuator_lag", "u_roll", "time_constant_s"));
        let pairs = format!(
            "\"correlations\": [{{\"between\": [{lag}, {delay}], \"coefficient\": -0.9}}], \"causes\""
        );
        let text = text.replace("\"causes\"", &pairs);
        let all = added(&text, &[], None).unwrap();
        assert_eq!((all.quantities.len(), all.names.len()), (1, 3));
        // A net of points of the unit cube.
        let drawn: Vec<Vec<f64>> = (0..4096)
            .map(|i| {
                let point = [0, 1, 2].map(|d| f64::from(sobol_burley::sample(i, d, 1)) + f64::EPSILON);
                all.quantities[0].at(&point).iter().filter_map(Value::number).collect()
            })
            .collect();
        let column = |i: usize| drawn.iter().map(|row| row[i]).collect::<Vec<f64>>();
        assert!(column(0).iter().all(|delay| (0.0..=0.04).contains(delay)));
        let rank = |i: usize, j: usize| crate::rank_correlation(&column(i), &column(j)).unwrap();
        // Of a normal distribution behind both: 6 / pi asin(r / 2).
        let expected = 6.0 / std::f64::consts::PI * (-0.45f64).asin();
        assert!((rank(0, 1) - expected).abs() < 0.01, "{} {expected}", rank(0, 1));
        assert!(rank(0, 2).abs() < 0.02 && rank(1, 2).abs() < 0.02);
        let spread = |values: &[f64], mean: f64| {
            (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
        };
        assert!((spread(&column(1), 0.1) - 0.02 / 1.96).abs() < 2e-4, "{}", spread(&column(1), 0.1));
        // One alone hangs together with nothing.
        let one = added(&text, &["actuator_lag(u_roll).time_constant_s"], None).unwrap();
        assert!(matches!(one.quantities[0].variation, Variation::One(Spread::Normal { .. })));
    }

    #[test]
    fn what_cannot_be_drawn_is_told() {
        let told = |json: &str, only: &[&str], words: &str| {
            let error = added(json, only, None).unwrap_err();
            assert!(error.contains(words), "{error}");
        };
        told("{}", &[], "not a result of identify or diagnose");
        told(
            &IDENTIFIED.replace("identification.v1", "compare.v1"),
            &[],
            "is expected, not whirlstand.compare.v1",
        );
        told(&IDENTIFIED.replace("true", "false"), &[], "`widen`");
        told(&IDENTIFIED.replace("0.5,", "null,"), &[], "B[2,1] has no standard error");
        told(&IDENTIFIED.replace("A[2,1]", "input_delay(u).delay_s"), &[], "an effect of the vehicle file");
        told(IDENTIFIED, &["A[9,9]"], "no parameter A[9,9]");
        told(
            &IDENTIFIED.replace("[0.8, 1.0]", "[1.8, 1.0]").replace("1.0, 0.8", "1.0, 1.8"),
            &[],
            "positive definite",
        );
    }
}
