//! Statistics over all trials of a run: rates with their intervals, goals, and confusions between effects.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};
use statrs::statistics::{Data, Median};

use super::noise::Colour;
use super::plan::Case;
use super::score::{Outcome, Scored};

/// Schema of [`Tally`].
pub const SCHEMA: &str = "whirlstand.blind.v1";

/// The result of many trials.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Tally {
    /// Schema name, [`SCHEMA`].
    pub schema: String,
    /// The command line of the run, for the reader.
    pub call: String,
    /// Goals, computed from the trials whose hidden effects all have a detectability above 30.
    pub goals: Vec<Goal>,
    /// Outcomes of single effects by range of detectability.
    pub classes: Vec<Class>,
    /// Confusion matrix of single effects with a detectability above 30.
    pub confusion: Vec<Row>,
    /// Number of plans that were skipped because vehicle and excitation have no place for their effect or
    /// cannot show it.
    pub skipped: usize,
    /// All trials.
    pub trials: Vec<Scored>,
}

/// A goal with its figure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Goal {
    /// Name of the figure.
    pub name: String,
    /// Value of the figure; `None` without any case.
    pub value: Option<f64>,
    /// Number of hits, where the figure is a rate.
    pub hits: Option<usize>,
    /// Number of cases.
    pub of: usize,
    /// 95 % interval of a rate (Wilson).
    pub interval: Option<(f64, f64)>,
    /// Least value that meets the goal.
    pub at_least: Option<f64>,
    /// Greatest value that meets the goal.
    pub at_most: Option<f64>,
    /// Number of cases that are needed for a decision: with fewer, a single case exceeds the allowed share of
    /// errors.
    #[serde(default)]
    pub least_cases: usize,
    /// Whether the goal is met; `None` when there are too few cases for a decision.
    pub met: Option<bool>,
}

/// Trials in a range of detectability.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Class {
    /// Least detectability, inclusive.
    pub from: f64,
    /// Greatest detectability, exclusive.
    pub to: f64,
    /// Number of trials by outcome.
    pub outcomes: BTreeMap<Outcome, usize>,
}

/// Row of the confusion matrix for an effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// The hidden effect.
    pub truth: String,
    /// Number of trials by outcome.
    pub outcomes: BTreeMap<Outcome, usize>,
    /// Number of trials by first named cause; `none` when nothing was named, `failed` without a diagnosis.
    pub named: BTreeMap<String, usize>,
}

/// Bounds of the classes of detectability.
const CLASSES: [f64; 6] = [0.0, 30.0, 100.0, 1e3, 1e4, f64::MAX];

impl Tally {
    /// Computes the statistics.
    pub fn new(call: String, mut trials: Vec<Scored>, skipped: usize) -> Self {
        trials.sort_by_key(|t| t.answer.number);
        let singles = || trials.iter().filter(|t| t.answer.case == Case::Single);
        let lambda = |t: &Scored| t.answer.effects.first().map_or(0.0, |e| e.lambda);
        let classes = CLASSES
            .windows(2)
            .map(|w| Class {
                from: w[0],
                to: w[1],
                outcomes: count(singles().filter(|t| (w[0]..w[1]).contains(&lambda(t)))),
            })
            .collect();
        let mut truths: BTreeMap<&str, Vec<&Scored>> = BTreeMap::new();
        for trial in singles().filter(|t| t.counts()) {
            let truth = trial.answer.effects.first().map_or("", |e| e.effect.as_str());
            truths.entry(truth).or_default().push(trial);
        }
        let confusion = truths
            .into_iter()
            .map(|(truth, trials)| {
                let mut named = BTreeMap::new();
                trials.iter().for_each(|t| *named.entry(first_name(t)).or_insert(0) += 1);
                Row { truth: truth.into(), outcomes: count(trials.into_iter()), named }
            })
            .collect();
        let goals = goals(&trials);
        Self { schema: SCHEMA.into(), call, goals, classes, confusion, skipped, trials }
    }

    /// Trials that count for the goals and have a bad outcome or a wrong name.
    pub fn failures(&self) -> impl Iterator<Item = &Scored> {
        self.trials.iter().filter(|t| t.counts() && (!t.is_good() || t.wrong_names > 0))
    }
}

fn first_name(trial: &Scored) -> String {
    match trial.named.first() {
        Some(name) => name.split('(').next().unwrap_or_default().to_string(),
        None if trial.outcome == Outcome::Failed => "failed".into(),
        None => "none".into(),
    }
}

fn count<'a>(trials: impl Iterator<Item = &'a Scored>) -> BTreeMap<Outcome, usize> {
    let mut outcomes = BTreeMap::new();
    trials.for_each(|t| *outcomes.entry(t.outcome).or_insert(0) += 1);
    outcomes
}

fn goals(trials: &[Scored]) -> Vec<Goal> {
    let of = |case: Case| trials.iter().filter(move |t| t.answer.case == case && t.counts());
    let is = |wanted: &'static [Outcome]| move |t: &&Scored| wanted.contains(&t.outcome);
    let singles = of(Case::Single).count();
    let right = of(Case::Single).filter(is(&[Outcome::Right, Outcome::Listed])).count();
    let wrong = of(Case::Single).filter(|t| t.wrong_names > 0).count();
    let mut goals = vec![
        rate("right name and place first", right, singles, Some(0.95), None),
        rate("wrong name", wrong, singles, None, Some(0.02)),
    ];
    let parameters = || of(Case::Single).filter(is(&[Outcome::Right])).flat_map(|t| t.parameters.iter());
    let inside: Vec<bool> = parameters().filter_map(|p| p.inside).collect();
    let hits = inside.iter().filter(|i| **i).count();
    goals.push(rate("parameter inside its interval", hits, inside.len(), Some(0.90), Some(0.98)));
    let errors: Vec<f64> = parameters().filter_map(|p| p.relative_error).collect();
    goals.push(middle("relative error of a parameter, median", &errors, 0.10));
    let false_causes = |colour: Option<&str>| -> (usize, usize) {
        let own = || of(Case::Clean).filter(|t| colour.is_none_or(|c| t.answer.noise.name() == c));
        (own().filter(|t| t.outcome == Outcome::Wrong).count(), own().count())
    };
    let (hits, all) = false_causes(None);
    goals.push(rate("false cause on a clean record", hits, all, None, Some(0.01)));
    for colour in colours(trials) {
        let (hits, all) = false_causes(Some(colour));
        goals.push(rate(&format!("  with {colour} noise"), hits, all, None, Some(0.01)));
    }
    let pairs = of(Case::Pair).filter(is(&[Outcome::Right])).count();
    goals.push(rate("two effects, both named", pairs, of(Case::Pair).count(), Some(0.85), None));
    let outside = || of(Case::Outside).filter(|t| t.outcome != Outcome::Alike);
    let unnamed = outside().filter(is(&[Outcome::Right])).count();
    goals.push(rate("outside the table, not named", unnamed, outside().count(), Some(0.90), None));
    let heldout: Vec<f64> =
        of(Case::Single).filter(is(&[Outcome::Right, Outcome::Listed])).filter_map(|t| t.heldout).collect();
    goals.push(middle("held-out error over the noise floor, median", &heldout, 1.1));
    goals
}

/// Noise colours with a separate rate for clean records: those of the reference generator, or all that occur
/// if there are others.
fn colours(trials: &[Scored]) -> Vec<&'static str> {
    let clean = trials.iter().filter(|t| t.answer.case == Case::Clean);
    let found: BTreeSet<&str> = clean.map(|t| t.answer.noise.name()).collect();
    if found.iter().all(|name| Colour::REFERENCE.contains(name)) {
        return Colour::REFERENCE.to_vec();
    }
    found.into_iter().collect()
}

fn rate(name: &str, hits: usize, of: usize, at_least: Option<f64>, at_most: Option<f64>) -> Goal {
    let value = (of > 0).then(|| hits as f64 / of as f64);
    let within = |v: f64| at_least.is_none_or(|l| v >= l) && at_most.is_none_or(|m| v <= m);
    let interval = (of > 0).then(|| wilson(hits, of));
    let least_cases = cases_to_decide(at_least, at_most);
    let is_out_of_reach = interval
        .is_some_and(|(low, high)| at_least.is_some_and(|l| high < l) || at_most.is_some_and(|m| low > m));
    let met = match value {
        _ if is_out_of_reach => Some(false),
        Some(value) if of >= least_cases => Some(within(value)),
        _ => None,
    };
    Goal { name: name.into(), value, hits: Some(hits), of, interval, at_least, at_most, least_cases, met }
}

fn middle(name: &str, values: &[f64], at_most: f64) -> Goal {
    let value = (!values.is_empty()).then(|| Data::new(values.to_vec()).median());
    Goal {
        name: name.into(),
        value,
        hits: None,
        of: values.len(),
        interval: None,
        at_least: None,
        at_most: Some(at_most),
        least_cases: MEDIAN_CASES,
        met: value.filter(|_| values.len() >= MEDIAN_CASES).map(|v| v <= at_most),
    }
}

/// Least number of cases for which the smallest and the largest value enclose the median with 95 % confidence
/// (1 - 2 / 2^6 = 97 %).
const MEDIAN_CASES: usize = 6;

/// Least number of cases for which a single case is no more than the allowed share of errors.
fn cases_to_decide(at_least: Option<f64>, at_most: Option<f64>) -> usize {
    let allowed = match (at_least, at_most) {
        (Some(least), None) => 1.0 - least,
        (None, Some(most)) => most,
        (Some(least), Some(most)) => (1.0 - most).min(1.0 - least),
        (None, None) => 1.0,
    };
    // The tolerance removes rounding errors: 1 / (1 - 0.95) is a little more than 20.
    (1.0 / allowed.max(1e-6) - 1e-6).ceil() as usize
}

/// 95 % confidence interval of a rate (Wilson, J. Am. Stat. Assoc. 22, 1927), valid for small counts too.
fn wilson(hits: usize, of: usize) -> (f64, f64) {
    const Z: f64 = 1.959_963_984_540_054;
    let (n, p) = (of as f64, hits as f64 / of as f64);
    let centre = (p + Z * Z / (2.0 * n)) / (1.0 + Z * Z / n);
    let half = Z / (1.0 + Z * Z / n) * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt();
    ((centre - half).max(0.0), (centre + half).min(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn too_few_trials_decide_nothing_but_what_is_out_of_reach() {
        let wrong_names = |hits, of| rate("wrong name", hits, of, None, Some(0.02)).met;
        assert_eq!((wrong_names(1, 10), wrong_names(0, 10)), (None, None));
        assert_eq!((wrong_names(1, 50), wrong_names(2, 50)), (Some(true), Some(false)));
        assert_eq!(wrong_names(5, 5), Some(false), "no further trial would mend it");
        let right = |hits, of| rate("right name", hits, of, Some(0.95), None);
        assert_eq!((right(3, 4).met, right(4, 4).met, right(0, 4).met), (None, None, Some(false)));
        assert_eq!((right(19, 20).met, right(18, 20).met), (Some(true), Some(false)));
        assert_eq!(right(0, 0).met, None);
        assert_eq!(rate("inside", 8, 8, Some(0.9), Some(0.98)).met, None);
        assert_eq!(rate("inside", 47, 50, Some(0.9), Some(0.98)).met, Some(true));
        assert_eq!(rate("false cause", 0, 1, None, Some(0.01)).least_cases, 100);
        assert_eq!(
            (middle("error", &[0.5; 5], 0.1).met, middle("error", &[0.5; 6], 0.1).met),
            (None, Some(false))
        );
    }

    #[test]
    fn the_interval_is_wilsons() {
        // Newcombe, Statistics in Medicine 17 (1998), Table I: 81 of 263 and 0 of 20.
        let (low, high) = wilson(81, 263);
        assert!((low - 0.2553).abs() < 5e-5 && (high - 0.3662).abs() < 5e-5, "{low} {high}");
        let (low, high) = wilson(0, 20);
        assert!(low == 0.0 && (high - 0.1611).abs() < 5e-5, "{high}");
    }
}
