//! The campaign file: a TOML beside a launch file. `docs/campaign.md` is its manual.

use nalgebra::DMatrix;
use serde::Deserialize;
use toml::Spanned;

use crate::draw::{Draw, DrawError, Method};
use crate::quantity::{Number, Quantity, Value, Variation};

/// What is wrong in a campaign file, and where.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {message}")]
pub struct CampaignError {
    /// File and line.
    pub place: String,
    /// What is wrong, what was expected, what to do.
    pub message: String,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct WrittenCampaign {
    launch: String,
    flights: Option<u64>,
    #[serde(default = "random")]
    method: Method,
    #[serde(default = "one")]
    seed: u64,
    #[serde(default)]
    set: Vec<String>,
    #[serde(default)]
    effects: Vec<toml::Table>,
    #[serde(default)]
    vary: Vec<Spanned<WrittenVariation>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct WrittenVariation {
    key: Option<String>,
    #[serde(default)]
    keys: Vec<String>,
    uniform: Option<[Number; 2]>,
    normal: Option<WrittenNormal>,
    integers: Option<[i64; 2]>,
    among: Option<Vec<toml::Value>>,
    levels: Option<usize>,
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

fn random() -> Method {
    Method::Random
}

fn one() -> u64 {
    1
}

/// A campaign: a launch file, what varies in it, and how many times it is flown.
#[derive(Debug, Clone)]
pub struct Campaign {
    /// The file as text.
    pub text: String,
    /// Launch file: a built-in name, or a path relative to the campaign file.
    pub launch: String,
    /// What every flight sets, as `--set` takes it.
    pub set: Vec<String>,
    /// Effects that follow those of the launch file, as `[[effects]]` in TOML; empty without any.
    pub effects: String,
    /// How the points are laid.
    pub method: Method,
    /// Seed of the draws.
    pub seed: u64,
    quantities: Vec<Quantity>,
    draw: Draw,
}

/// What stands before the number of an effect of the campaign's own, for example `added.0.factor`.
const ADDED: &str = "added.";

impl Campaign {
    /// Reads the text of a campaign file; `origin` is what messages call it.
    ///
    /// # Errors
    /// For what is no TOML, unknown keys, and numbers that make no distribution, with the line.
    pub fn parse(origin: &str, text: &str) -> Result<Self, CampaignError> {
        let line = |at: usize| 1 + text.bytes().take(at).filter(|&b| b == b'\n').count();
        let fail = |at: usize, message: String| CampaignError {
            place: format!("{origin}, line {}", line(at)),
            message,
        };
        let written: WrittenCampaign =
            toml::from_str(text).map_err(|e| fail(e.span().map_or(0, |s| s.start), e.message().into()))?;
        let mut quantities: Vec<Quantity> = Vec::new();
        for variation in written.vary {
            let at = variation.span().start;
            let quantity = quantity(variation.into_inner()).map_err(|message| fail(at, message))?;
            if let Some(key) =
                quantity.keys.iter().find(|key| quantities.iter().any(|q| q.keys.contains(key)))
            {
                return Err(fail(at, format!("{key} varies already above")));
            }
            quantities.push(quantity);
        }
        let whole = |message: String| CampaignError { place: origin.into(), message };
        match (written.method, written.flights) {
            (Method::Grid, Some(_)) => {
                return Err(whole("`flights` is left out on a grid: it has every combination once".into()));
            }
            (Method::Grid, None) if quantities.is_empty() => {
                return Err(whole("a grid needs a [[vary]]".into()));
            }
            (Method::Grid, None) => {}
            (_, None | Some(0)) => return Err(whole("`flights` says how often to fly: at least 1".into())),
            _ => {}
        }
        let draw = Draw::new(written.method, written.seed, written.flights, &quantities)
            .map_err(|e: DrawError| whole(e.to_string()))?;
        let effects: String =
            written.effects.iter().map(|effect| format!("\n[[effects]]\n{effect}")).collect();
        Ok(Self {
            text: text.into(),
            launch: written.launch,
            set: written.set,
            effects,
            method: written.method,
            seed: written.seed,
            quantities,
            draw,
        })
    }

    /// How many flights it has; they are numbered from 0.
    pub fn flights(&self) -> u64 {
        self.draw.flights()
    }

    /// The keys that vary, as they are written, and their units.
    pub fn keys(&self) -> Vec<(String, String)> {
        self.quantities.iter().flat_map(|q| q.keys.iter().cloned().zip(q.units())).collect()
    }

    /// What flight `number` draws, in the order of [`Campaign::keys`].
    pub fn values(&self, number: u64) -> Vec<Value> {
        self.draw.values(number, &self.quantities)
    }

    /// All that flight `number` sets, each as `--set` takes it, where the launch file has `own_effects` effects of its own.
    pub fn assignments(&self, number: u64, own_effects: usize) -> Vec<String> {
        let drawn = self.keys().into_iter().zip(self.values(number));
        let drawn = drawn.map(|((key, _), value)| format!("{}={value}", placed(&key, own_effects)));
        self.set.iter().cloned().chain(drawn).collect()
    }
}

/// The key with the number that an added effect has behind those of the launch file.
fn placed(key: &str, own_effects: usize) -> String {
    let Some((number, rest)) = key.strip_prefix(ADDED).and_then(|rest| rest.split_once('.')) else {
        return key.into();
    };
    number
        .parse::<usize>()
        .map_or_else(|_| key.into(), |number| format!("effects.{}.{rest}", own_effects + number))
}

fn quantity(written: WrittenVariation) -> Result<Quantity, String> {
    let WrittenVariation { key, keys, uniform, normal, integers, among, levels } = written;
    let keys = match (key, keys.is_empty()) {
        (Some(key), true) => vec![key],
        (None, false) => keys,
        _ => return Err("`key` names what varies, or `keys` what varies together".into()),
    };
    let variation = match (uniform, normal, integers, among) {
        (Some([low, high]), None, None, None) => even(low, high)?,
        (None, Some(normal), None, None) => gaussian(normal, keys.len())?,
        (None, None, Some(ends), None) if ends[0] <= ends[1] => Variation::Integers { ends },
        (None, None, Some(_), None) => {
            return Err("`integers` names the first and the last, in this order".into());
        }
        (None, None, None, Some(values)) if !values.is_empty() => {
            let values: Vec<Value> = values.into_iter().map(value).collect::<Result<_, _>>()?;
            let words = values.iter().filter(|v| v.number().is_none()).count();
            if words != 0 && words != values.len() {
                return Err("`among` holds numbers or words, not both".into());
            }
            if !values.iter().all(|v| unit(v) == unit(&values[0])) {
                return Err("`among` needs one unit".into());
            }
            Variation::Among { values }
        }
        (None, None, None, Some(_)) => return Err("`among` is empty".into()),
        _ => {
            return Err(
                "exactly one of `uniform`, `normal`, `integers` and `among` says how it varies".into()
            );
        }
    };
    if keys.len() > 1 && !matches!(variation, Variation::Joint { .. }) {
        return Err("several keys vary together by a `normal` with `covariance` only".into());
    }
    if levels.is_some_and(|n| n < 2) || levels.is_some() && !matches!(variation, Variation::Uniform { .. }) {
        return Err("`levels`, at least 2, belongs to `uniform`".into());
    }
    Ok(Quantity { keys, variation, levels })
}

fn even(low: Number, high: Number) -> Result<Variation, String> {
    if low.unit != high.unit {
        return Err(format!("both ends need one unit, not '{}' and '{}'", low.unit, high.unit));
    }
    if low.value > high.value {
        return Err("`uniform` names the lower end first".into());
    }
    Ok(Variation::Uniform { ends: [low.value, high.value], unit: low.unit })
}

fn gaussian(normal: WrittenNormal, keys: usize) -> Result<Variation, String> {
    match (normal.mean, normal.std, normal.covariance) {
        (Means::One(mean), Some(std), None) if keys == 1 => {
            if mean.unit != std.unit {
                return Err(format!("mean and std need one unit, not '{}' and '{}'", mean.unit, std.unit));
            }
            if std.value <= 0.0 {
                return Err("`std` must be above 0".into());
            }
            Ok(Variation::Normal { mean: mean.value, std: std.value, unit: mean.unit })
        }
        (Means::Many(means), None, Some(rows)) if means.len() == keys => {
            if rows.len() != keys || rows.iter().any(|row| row.len() != keys) {
                return Err(format!("`covariance` has {keys} rows of {keys} numbers, as there are keys"));
            }
            let covariance = DMatrix::from_fn(keys, keys, |i, j| rows[i][j]);
            let scale = covariance.amax();
            if (&covariance - covariance.transpose()).amax() > 1e-9 * scale {
                return Err("`covariance` is not symmetric".into());
            }
            let factor = covariance.cholesky().ok_or("`covariance` is not positive definite")?.l();
            let (mean, units) = means.into_iter().map(|m| (m.value, m.unit)).unzip();
            Ok(Variation::Joint { mean, units, factor })
        }
        _ => Err("`normal` has `mean` and `std`, or for several `keys` a list `mean` and `covariance`, in the units of \
                  the means"
            .into()),
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
        other => Err(format!("`among` holds numbers and words, not a {}", other.type_str())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r#"
launch = "quadrotor"
flights = 200
method = "sobol"
set = ["duration_s=5"]

[[effects]]
effect = "input_gain"
where = "u_roll"
factor = 1.0

[[vary]]
key = "plant.initial.roll"
uniform = ["-10 deg", "10 deg"]

[[vary]]
key = "controller.law"
among = ["lqr", "smc"]

[[vary]]
keys = ["added.0.factor", "effects.0.magnitude"]
normal = { mean = [0.9, "150 deg/s^2"], covariance = [[0.01, 0.5], [0.5, 100.0]] }
"#;

    #[test]
    fn a_flight_sets_what_was_drawn_in_the_units_of_the_file() {
        let campaign = Campaign::parse("c.toml", TEXT).unwrap();
        assert_eq!(campaign.flights(), 200);
        let set = campaign.assignments(7, 2);
        assert_eq!(set[0], "duration_s=5");
        assert!(set[1].starts_with("plant.initial.roll=\"") && set[1].ends_with(" deg\""), "{set:?}");
        assert!(set[2] == "controller.law=lqr" || set[2] == "controller.law=smc", "{set:?}");
        assert!(set[3].starts_with("effects.2.factor="), "{set:?}");
        assert!(campaign.effects.contains("[[effects]]") && campaign.effects.contains("u_roll"));
    }

    #[test]
    fn joint_draws_have_their_covariance() {
        let campaign = Campaign::parse("c.toml", &TEXT.replace("200", "4096")).unwrap();
        let rows: Vec<[f64; 2]> = (0..4096)
            .map(|n| campaign.values(n))
            .map(|v| [v[2].number().unwrap() - 0.9, v[3].number().unwrap() - 150.0])
            .collect();
        let mean = |f: &dyn Fn(&[f64; 2]) -> f64| rows.iter().map(f).sum::<f64>() / rows.len() as f64;
        assert!((mean(&|r| r[0] * r[0]) - 0.01).abs() < 3e-4);
        assert!((mean(&|r| r[1] * r[1]) - 100.0).abs() < 3.0);
        assert!((mean(&|r| r[0] * r[1]) - 0.5).abs() < 0.03);
    }

    #[test]
    fn mistakes_are_told_with_their_line() {
        let error = |from: &str, to: &str| {
            Campaign::parse("c.toml", &TEXT.replace(from, to)).unwrap_err().to_string()
        };
        for (from, to, words) in [
            ("\"10 deg\"", "\"10 rad\"", "c.toml, line 12: both ends need one unit, not 'deg' and 'rad'"),
            ("flights = 200", "", "c.toml: `flights` says how often"),
            ("[0.5, 100.0]", "[0.5, 1.0]", "line 20: `covariance` is not positive definite"),
            ("controller.law", "plant.initial.roll", "line 16: plant.initial.roll varies already"),
            ("method = \"sobol\"", "method = \"sobel\"", "line 4: unknown variant `sobel`"),
            ("\"lqr\", \"smc\"", "", "line 16: `among` is empty"),
            ("set =", "sets =", "line 5: unknown field `sets`"),
        ] {
            assert!(error(from, to).contains(words), "{}", error(from, to));
        }
    }
}
