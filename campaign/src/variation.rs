//! The variation of a key, as written in a campaign file.

use std::collections::BTreeMap;

use nalgebra::DMatrix;
use serde::Deserialize;

use crate::correlation::correlation_root;
use crate::quantity::{Number, Quantity, Spread, Value, Variation};
use crate::source::{Added, Answer};

/// One `[[vary]]`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct WrittenVariation {
    key: Option<String>,
    #[serde(default)]
    keys: Vec<String>,
    uniform: Option<[Number; 2]>,
    normal: Option<WrittenNormal>,
    integers: Option<[i64; 2]>,
    among: Option<Vec<toml::Value>>,
    levels: Option<usize>,
    /// Answer of identify or diagnose.
    pub(crate) found: Option<String>,
    #[serde(default)]
    only: Vec<String>,
    widen: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct WrittenNormal {
    mean: Means,
    std: Option<Number>,
    covariance: Option<Vec<Vec<f64>>>,
}

#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum Means {
    One(Number),
    Many(Vec<Number>),
}

/// Quantities from the answer of another command.
pub(crate) fn found(written: &WrittenVariation, sources: &BTreeMap<String, String>) -> Result<Added, String> {
    let WrittenVariation { key, keys, uniform, normal, integers, among, levels, found, only, widen } =
        written;
    let alone = key.is_none() && keys.is_empty() && uniform.is_none() && normal.is_none();
    if !alone || integers.is_some() || among.is_some() || levels.is_some() {
        return Err(
            "with `found` only `only` and `widen` are allowed: the result defines what varies, and how"
                .into(),
        );
    }
    let file = found.as_deref().unwrap_or_default();
    let told = |e: String| format!("found = \"{file}\": {e}");
    let answer = sources.get(file).ok_or_else(|| told("it was not read".into()))?;
    Answer::parse(answer).and_then(|answer| answer.added(only, *widen)).map_err(told)
}

/// A quantity that the file itself describes.
pub(crate) fn quantity(written: WrittenVariation) -> Result<Quantity, String> {
    let WrittenVariation { key, keys, uniform, normal, integers, among, levels, found: _, only, widen } =
        written;
    if !only.is_empty() || widen.is_some() {
        return Err("`only` and `widen` belong to `found`".into());
    }
    let keys = match (key, keys.is_empty()) {
        (Some(key), true) => vec![key],
        (None, false) => keys,
        _ => {
            return Err("give `key` for one varied quantity, or `keys` for several that vary together".into());
        }
    };
    let variation = match (uniform, normal, integers, among) {
        (Some([low, high]), None, None, None) => even(low, high)?,
        (None, Some(normal), None, None) => gaussian(normal, keys.len())?,
        (None, None, Some(ends), None) if ends[0] <= ends[1] => Variation::Integers { ends },
        (None, None, Some(_), None) => {
            return Err("`integers` must give the first and the last value, in this order".into());
        }
        (None, None, None, Some(values)) if !values.is_empty() => {
            let values: Vec<Value> = values.into_iter().map(value).collect::<Result<_, _>>()?;
            let words = values.iter().filter(|v| v.number().is_none()).count();
            if words != 0 && words != values.len() {
                return Err("`among` must contain numbers or words, not both".into());
            }
            if !values.iter().all(|v| unit(v) == unit(&values[0])) {
                return Err("all values of `among` need the same unit".into());
            }
            Variation::Among { values }
        }
        (None, None, None, Some(_)) => return Err("`among` is empty".into()),
        _ => {
            return Err("exactly one of `uniform`, `normal`, `integers` and `among` must be given".into());
        }
    };
    if keys.len() > 1 && !matches!(variation, Variation::Joint { .. }) {
        return Err("several keys can only vary together by a `normal` with `covariance`".into());
    }
    if levels.is_some_and(|n| n < 2)
        || levels.is_some() && !matches!(variation, Variation::One(Spread::Uniform { .. }))
    {
        return Err("`levels`, at least 2, belongs to `uniform`".into());
    }
    Ok(Quantity { keys, variation, levels })
}

fn even(low: Number, high: Number) -> Result<Variation, String> {
    if low.unit != high.unit {
        return Err(format!("both ends need the same unit, not '{}' and '{}'", low.unit, high.unit));
    }
    if low.value > high.value {
        return Err("`uniform` must give the lower end first".into());
    }
    Ok(Variation::One(Spread::Uniform { ends: [low.value, high.value], unit: low.unit }))
}

fn gaussian(normal: WrittenNormal, keys: usize) -> Result<Variation, String> {
    match (normal.mean, normal.std, normal.covariance) {
        (Means::One(mean), Some(std), None) if keys == 1 => {
            if mean.unit != std.unit {
                return Err(format!(
                    "mean and std need the same unit, not '{}' and '{}'",
                    mean.unit, std.unit
                ));
            }
            if std.value <= 0.0 {
                return Err("`std` must be above 0".into());
            }
            Ok(Variation::One(Spread::Normal { mean: mean.value, std: std.value, unit: mean.unit }))
        }
        (Means::Many(means), None, Some(rows)) if means.len() == keys => {
            if rows.len() != keys || rows.iter().any(|row| row.len() != keys) {
                return Err(format!(
                    "`covariance` must have {keys} rows of {keys} numbers, one for each key"
                ));
            }
            let covariance = DMatrix::from_fn(keys, keys, |i, j| rows[i][j]);
            let scale = covariance.amax();
            if (&covariance - covariance.transpose()).amax() > 1e-9 * scale {
                return Err("`covariance` is not symmetric".into());
            }
            let std: Vec<f64> = covariance.diagonal().iter().map(|variance| variance.sqrt()).collect();
            let root = Some(&std)
                .filter(|std| std.iter().all(|std| *std > 0.0))
                .and_then(|std| {
                    correlation_root(&DMatrix::from_fn(keys, keys, |i, j| rows[i][j] / (std[i] * std[j])))
                })
                .ok_or("`covariance` is not positive definite")?;
            let each = means.into_iter().zip(std);
            let each = each.map(|(m, std)| Spread::Normal { mean: m.value, std, unit: m.unit }).collect();
            Ok(Variation::Joint { each, root })
        }
        _ => {
            Err("`normal` needs `mean` and `std`, or for several `keys` a list `mean` and `covariance`, in the units \
                 of the means"
                .into())
        }
    }
}

fn unit(value: &Value) -> &str {
    if let Value::Number(number) = value { &number.unit } else { "" }
}

fn value(value: toml::Value) -> Result<Value, String> {
    match value {
        toml::Value::Integer(whole) => Ok(Value::Whole(whole)),
        toml::Value::Float(value) => Ok(Value::Number(Number { value, unit: String::new() })),
        toml::Value::String(text) => Ok(text.parse().map_or(Value::Word(text), Value::Number)),
        other => Err(format!("`among` must contain numbers or words, not a {}", other.type_str())),
    }
}
