//! The campaign file: a TOML beside a launch file. `docs/campaign.md` is its manual.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use toml::Spanned;

use crate::draw::{Draw, DrawError, Method};
use crate::importance::{Failures, Importance, WrittenImportance};
use crate::quantity::{Quantity, Value};
use crate::source::Answer;
use crate::table::Table;
use crate::variation::{WrittenVariation, found, quantity};

/// An error in a campaign file, with its place.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {message}")]
pub struct CampaignError {
    /// File and line.
    pub place: String,
    /// The error, the expectation, and the remedy.
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
    importance: Option<WrittenImportance>,
    /// Contents of the files that `found` names, which [`Campaign::open`] inserted.
    #[serde(default)]
    sources: BTreeMap<String, String>,
}

/// The file names in a campaign file; all other keys are ignored.
#[derive(Debug, Default, Deserialize)]
struct Named {
    #[serde(default)]
    vary: Vec<NamedVariation>,
    #[serde(default)]
    importance: WrittenImportance,
}

#[derive(Debug, Deserialize)]
struct NamedVariation {
    found: Option<String>,
}

fn random() -> Method {
    Method::Random
}

fn one() -> u64 {
    1
}

/// A campaign: a launch file, the quantities that vary, and the number of flights.
#[derive(Debug, Clone)]
pub struct Campaign {
    /// Text of the file, with the data that were read from other files.
    pub text: String,
    /// Launch file: a built-in name, or a path relative to the campaign file.
    pub launch: String,
    /// Settings of every flight, in the form of `--set`.
    pub set: Vec<String>,
    /// Effects that are added after those of the launch file, as `[[effects]]` in TOML; may be empty.
    pub effects: String,
    /// Sampling method.
    pub method: Method,
    /// Seed of the draws.
    pub seed: u64,
    quantities: Vec<Quantity>,
    /// Keys of values found by other commands, and their location: `added.0.value` and the like.
    names: BTreeMap<String, String>,
    draw: Draw,
}

/// Prefix of the number of an effect of the campaign's own, for example `added.0.factor`.
const ADDED: &str = "added.";

impl Campaign {
    /// Reads a campaign file, and the answers of identify and diagnose that it names, relative to its folder. The
    /// data used from them are appended to the text, so that the text alone is the campaign from then on.
    ///
    /// # Errors
    /// As [`Campaign::parse`], and for files that cannot be read, by name.
    pub fn open(path: &Path) -> Result<Self, CampaignError> {
        let origin = path.display().to_string();
        let fail = |message: String| CampaignError { place: origin.clone(), message };
        let mut text = std::fs::read_to_string(path)
            .map_err(|e| fail(format!("the campaign file cannot be read: {e}")))?;
        // Invalid TOML is reported by `parse`, with its line.
        let named: Named = toml::from_str(&text).unwrap_or_default();
        let mut sources = toml::Table::new();
        for file in named.vary.into_iter().filter_map(|variation| variation.found) {
            let told = |e: String| fail(format!("found = \"{file}\": {e}"));
            let json = std::fs::read_to_string(beside(path, &file));
            let json = json.map_err(|e| told(format!("it cannot be read: {e}")))?;
            sources.insert(file.clone(), Answer::parse(&json).map_err(told)?.to_json().into());
        }
        if let Some(file) = named.importance.after {
            let failures =
                failures(&beside(path, &file)).map_err(|e| fail(format!("after = \"{file}\": {e}")))?;
            sources.insert(file, serde_json::to_string(&failures).unwrap_or_default().into());
        }
        if !sources.is_empty() {
            text.push_str(&format!("\n[sources]\n{sources}"));
        }
        Self::parse(&origin, &text)
    }

    /// Reads the text of a campaign file; `origin` is its name in messages.
    ///
    /// # Errors
    /// For invalid TOML, unknown keys, and numbers that give no distribution, with the line.
    pub fn parse(origin: &str, text: &str) -> Result<Self, CampaignError> {
        let line = |at: usize| 1 + text.bytes().take(at).filter(|&b| b == b'\n').count();
        let fail = |at: usize, message: String| CampaignError {
            place: format!("{origin}, line {}", line(at)),
            message,
        };
        let written: WrittenCampaign =
            toml::from_str(text).map_err(|e| fail(e.span().map_or(0, |s| s.start), e.message().into()))?;
        let mut quantities: Vec<Quantity> = Vec::new();
        let (mut effects, mut names) = (written.effects, BTreeMap::new());
        for variation in written.vary {
            let at = variation.span().start;
            let variation = variation.into_inner();
            let new = match variation.found.is_some() {
                true => {
                    let added = found(&variation, &written.sources).map_err(|message| fail(at, message))?;
                    names.extend(added.names.into_iter().map(|(name, effect, parameter)| {
                        (name, format!("{ADDED}{}.{parameter}", effects.len() + effect))
                    }));
                    effects.extend(added.effects);
                    added.quantities
                }
                false => vec![quantity(variation).map_err(|message| fail(at, message))?],
            };
            for quantity in new {
                let varies = |key: &&String| quantities.iter().any(|q| q.keys.contains(key));
                if let Some(key) = quantity.keys.iter().find(varies) {
                    return Err(fail(at, format!("{key} is already varied above")));
                }
                quantities.push(quantity);
            }
        }
        let whole = |message: String| CampaignError { place: origin.into(), message };
        match (written.method, written.flights) {
            (Method::Grid, Some(_)) => {
                return Err(whole("omit `flights` for a grid: it runs every combination once".into()));
            }
            (Method::Grid, None) if quantities.is_empty() => {
                return Err(whole("a grid needs a [[vary]]".into()));
            }
            (Method::Grid, None) => {}
            (_, None | Some(0)) => {
                return Err(whole("`flights`, the number of flights, must be at least 1".into()));
            }
            _ => {}
        }
        let importance = match (written.method, written.importance) {
            (Method::Importance, importance) => {
                Some(tilted(&importance.unwrap_or_default(), &written.sources, &quantities).map_err(whole)?)
            }
            (_, Some(_)) => return Err(whole("[importance] belongs to method = \"importance\"".into())),
            (_, None) => None,
        };
        let draw = Draw::new(written.method, written.seed, written.flights, &quantities, importance)
            .map_err(|e: DrawError| whole(e.to_string()))?;
        let effects: String = effects.iter().map(|effect| format!("\n[[effects]]\n{effect}")).collect();
        Ok(Self {
            text: text.into(),
            launch: written.launch,
            set: written.set,
            effects,
            method: written.method,
            seed: written.seed,
            quantities,
            names,
            draw,
        })
    }

    /// Number of flights; they are numbered from 0.
    pub fn flights(&self) -> u64 {
        self.draw.flights()
    }

    /// The keys that vary, as written in the file, and their units.
    pub fn keys(&self) -> Vec<(String, String)> {
        self.quantities.iter().flat_map(|q| q.keys.iter().cloned().zip(q.units())).collect()
    }

    /// Weight of flight `number`; `None` where all flights have the same weight.
    pub fn weight(&self, number: u64) -> Option<f64> {
        self.draw.weight(number)
    }

    /// The values drawn for flight `number`, in the order of [`Campaign::keys`].
    pub fn values(&self, number: u64) -> Vec<Value> {
        self.draw.values(number, &self.quantities)
    }

    /// The values drawn for flight `number`, each with its key in a launch file that has `own_effects` effects of
    /// its own.
    pub fn drawn(&self, number: u64, own_effects: usize) -> Vec<(String, Value)> {
        let keys = self.quantities.iter().flat_map(|q| &q.keys);
        let place = |key: &String| placed(self.names.get(key).unwrap_or(key), own_effects);
        keys.map(place).zip(self.values(number)).collect()
    }

    /// All settings of flight `number` in the form of `--set`, for a launch file that has `own_effects` effects of
    /// its own.
    pub fn assignments(&self, number: u64, own_effects: usize) -> Vec<String> {
        let drawn = self.drawn(number, own_effects).into_iter().map(|(key, value)| format!("{key}={value}"));
        self.set.iter().cloned().chain(drawn).collect()
    }
}

fn beside(path: &Path, file: &str) -> PathBuf {
    path.parent().unwrap_or(Path::new("")).join(file)
}

/// Points at which the flights of an earlier campaign violated a limit.
fn failures(path: &Path) -> Result<Failures, String> {
    let table = Table::read(path).map_err(|e| e.to_string())?;
    let campaign = Campaign::parse("its campaign file", &table.info.text).map_err(|e| e.to_string())?;
    if campaign.method == Method::Grid {
        return Err("it is a grid, not a random sample".into());
    }
    let keys = campaign.keys();
    let broken = table.flights.iter().filter(|flight| !flight.is_good());
    let points: Vec<(Vec<f64>, f64)> = broken
        .map(|f| (campaign.draw.point(f.number, keys.len()), campaign.weight(f.number).unwrap_or(1.0)))
        .collect();
    Failures::of(keys, &points).ok_or_else(|| {
        format!(
            "it has {} flights that exceeded a limit, but at least 10 are needed: fly more, with method \
             \"importance\" and a larger `spread`",
            points.len()
        )
    })
}

/// The draws of these quantities under method "importance".
fn tilted(
    written: &WrittenImportance,
    sources: &BTreeMap<String, String>,
    quantities: &[Quantity],
) -> Result<Importance, String> {
    let keys: Vec<(String, String)> =
        quantities.iter().flat_map(|q| q.keys.iter().cloned().zip(q.units())).collect();
    let failures = match &written.after {
        None => None,
        Some(file) => {
            let told = |e: String| format!("after = \"{file}\": {e}");
            let text = sources.get(file).ok_or_else(|| told("it was not read".into()))?;
            let failures: Failures = serde_json::from_str(text).map_err(|e| told(e.to_string()))?;
            if failures.keys != keys {
                return Err(told(
                    "its keys or their units differ from those varied here, or are in another order".into(),
                ));
            }
            Some(failures)
        }
    };
    let continuous: Vec<bool> =
        quantities.iter().flat_map(|q| std::iter::repeat_n(q.is_continuous(), q.coordinates())).collect();
    Importance::new(written, failures.as_ref(), &continuous)
}

/// The key with the number of an added effect after those of the launch file.
fn placed(key: &str, own_effects: usize) -> String {
    let Some((number, rest)) = key.strip_prefix(ADDED).and_then(|rest| rest.split_once('.')) else {
        return key.into();
    };
    number
        .parse::<usize>()
        .map_or_else(|_| key.into(), |number| format!("effects.{}.{rest}", own_effects + number))
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
            (
                "\"10 deg\"",
                "\"10 rad\"",
                "c.toml, line 12: both ends need the same unit, not 'deg' and 'rad'",
            ),
            ("flights = 200", "", "c.toml: `flights`, the number of flights, must be"),
            ("[0.5, 100.0]", "[0.5, 1.0]", "line 20: `covariance` is not positive definite"),
            ("controller.law", "plant.initial.roll", "line 16: plant.initial.roll is already varied"),
            ("method = \"sobol\"", "method = \"sobel\"", "line 4: unknown variant `sobel`"),
            ("\"lqr\", \"smc\"", "", "line 16: `among` is empty"),
            ("set =", "sets =", "line 5: unknown field `sets`"),
        ] {
            assert!(error(from, to).contains(words), "{}", error(from, to));
        }
    }
}
