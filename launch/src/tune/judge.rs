//! Judgement of the flights of both laws.

use std::collections::BTreeMap;
use whirlstand_msgs::units::ShownUnit;

use serde::Serialize;
use whirlstand_campaign::{Proportion, more_often_in_pairs};
use whirlstand_control::SampledPlant;
use whirlstand_evaluate::expectation::{check, signal_figures};
use whirlstand_evaluate::{Expectation, Figure, Flight, RunSummary};
use whirlstand_logs::stats;
use whirlstand_vehicle::Vehicle;

/// Figures of an output and of an input that are reported.
const OUTPUT_FIGURES: [&str; 3] = ["peak", "recovery_s", "iae"];
const INPUT_FIGURES: [&str; 2] = ["rms", "travel_per_s"];

/// Weight of a rate whose angle is weighted as well.
const RATES: f64 = 0.01;

/// Share of the draws on which the new law must be the better one.
const BETTER_SHARE: f64 = 0.5;

/// Count of a figure without a value, as a multiple of its limit.
const NEVER: f64 = 10.0;

/// The judgement of one flight.
#[derive(Debug, Clone)]
pub(super) struct Judged {
    /// Whether a state left the validity of the model.
    pub lost: bool,
    /// Whether an expectation of the launch file is violated, or the vehicle was lost.
    pub violates: bool,
    /// The greatest figure of a signal as a multiple of its limit, 1 for one that just holds; [`NEVER`] for a
    /// figure without a value, such as the recovery time of a signal that does not recover. Absent where no
    /// expectation concerns a signal.
    pub of_limit: Option<f64>,
    /// Cost of the flight, see [`cost`]; infinite when the vehicle was lost.
    pub cost: f64,
    /// Figures of the flight, unless the vehicle was lost.
    pub figures: Option<RunSummary>,
}

impl Judged {
    /// The judgement of a flight on which a state left the model.
    pub fn lost() -> Self {
        Self { lost: true, violates: true, of_limit: None, cost: f64::INFINITY, figures: None }
    }

    /// The judgement of a completed flight.
    pub fn flown(figures: RunSummary, flight: &Flight, plant: &SampledPlant, limits: &[Expectation]) -> Self {
        let checked = check(limits, &figures.timing, Some(&figures));
        let shares = checked.iter().filter(|c| c.key.contains('.') && c.limit > 0.0);
        let shares = shares.map(|c| c.found.map_or(NEVER, |found| (found / c.limit).min(NEVER)));
        Self {
            lost: false,
            violates: checked.iter().any(|c| !c.holds),
            of_limit: shares.max_by(f64::total_cmp),
            cost: cost(flight, plant),
            figures: Some(figures),
        }
    }
}

/// Keys of the figures of a vehicle's signals that are reported.
pub(super) fn told_keys(vehicle: &Vehicle) -> Vec<String> {
    let outputs = vehicle.outputs.iter().flat_map(|o| OUTPUT_FIGURES.map(|f| format!("{}.{f}", o.name)));
    let inputs = vehicle.inputs.iter().flat_map(|i| INPUT_FIGURES.map(|f| format!("{}.{f}", i.name)));
    outputs.chain(inputs).collect()
}

impl Judged {
    /// A figure of the flight, where it has a value.
    pub fn value(&self, key: &str) -> Option<f64> {
        match self.figures.as_ref()?.figure(key)? {
            Figure::Value(value) => Some(value),
            Figure::Never | Figure::NoEvent => None,
        }
    }
}

/// Cost of a flight: mean square of the errors of all states and of all inputs, each divided by its size, with a
/// hundredth of the weight for rates (Bryson's rule, as the regulator's default). One number for accuracy and
/// effort, the same for every law.
pub(crate) fn cost(flight: &Flight, plant: &SampledPlant) -> f64 {
    let (n, m) = (plant.own_count(), plant.input_count());
    let mut weights: Vec<f64> = plant.scales()[..n].iter().map(|s| 1.0 / (s * s)).collect();
    for (rate, _) in plant.kinematic_rows().into_iter().flatten() {
        weights[rate] = RATES / plant.scales()[rate].powi(2);
    }
    let steps = (flight.states.len() / n).max(1);
    let states = flight.states.iter().zip(&flight.wanted).enumerate().map(|(k, (x, wanted))| {
        let error = if wanted.is_finite() { x - wanted } else { *x };
        weights[k % n] * error * error
    });
    let inputs =
        flight.inputs.iter().enumerate().map(|(k, u)| (u / plant.inputs()[k % m].authority()).powi(2));
    (states.sum::<f64>() + inputs.sum::<f64>()) / steps as f64
}

/// Distribution of a figure over all draws: median and central 95 %.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Spread {
    /// Median.
    pub median: f64,
    /// Quantile of 2.5 %.
    pub low: f64,
    /// Quantile of 97.5 %: 2.5 % of the draws are above.
    pub high: f64,
}

impl Spread {
    fn of(values: impl IntoIterator<Item = f64>) -> Option<Self> {
        let values: Vec<f64> = values.into_iter().filter(|v| v.is_finite()).collect();
        let at = |share: f64| stats::quantile(&values, share);
        (!values.is_empty()).then(|| Self { median: at(0.5), low: at(0.025), high: at(0.975) })
    }
}

/// Figures of the flights of one law.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct LawFigures {
    /// Share of the draws on which the vehicle was lost, with its interval.
    pub probability_unstable: Proportion,
    /// Share of the draws on which an expectation of the launch file is violated or the vehicle was lost, with
    /// its interval.
    pub probability_violated: Proportion,
    /// Cost; absent when the vehicle was lost on all draws.
    pub cost: Option<Spread>,
    /// Figures under the keys of `[expect]`, SI, over the draws that have them.
    pub figures: BTreeMap<String, Spread>,
    /// SI units of the figures.
    pub units: BTreeMap<String, ShownUnit>,
}

impl LawFigures {
    /// From the judgements of all draws.
    pub(super) fn of(judged: &[Judged], vehicle: &Vehicle) -> Self {
        let share = |of: &dyn Fn(&Judged) -> bool| {
            Proportion::new(judged.iter().filter(|j| of(j)).count() as u64, judged.len() as u64)
        };
        let spread =
            |key: String| Some((key.clone(), Spread::of(judged.iter().filter_map(|j| j.value(&key)))?));
        Self {
            probability_unstable: share(&|j| j.lost),
            probability_violated: share(&|j| j.violates),
            cost: Spread::of(judged.iter().map(|j| j.cost)),
            figures: told_keys(vehicle).into_iter().filter_map(spread).collect(),
            units: units(vehicle),
        }
    }
}

/// SI unit of every figure of a signal, by its key.
fn units(vehicle: &Vehicle) -> BTreeMap<String, ShownUnit> {
    let names = vehicle.outputs.iter().map(|o| &o.name).chain(vehicle.inputs.iter().map(|i| &i.name));
    let told = |f: &str| OUTPUT_FIGURES.contains(&f) || INPUT_FIGURES.contains(&f);
    names
        .flat_map(|name| {
            let figures = signal_figures(vehicle, name).unwrap_or_default();
            figures
                .into_iter()
                .filter(|(f, _)| told(f))
                .map(|(f, unit)| (format!("{name}.{f}"), unit.shown()))
                .collect::<Vec<_>>()
        })
        .collect()
}

/// Whether and by how much the new law is better.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Gain {
    /// New cost over old cost, draw by draw, geometric mean; absent when no draw has both.
    pub cost_ratio: Option<f64>,
    /// Lower end of the 95 % interval of that mean.
    pub cost_ratio_low: Option<f64>,
    /// See [`Self::cost_ratio_low`].
    pub cost_ratio_high: Option<f64>,
    /// Share of the draws on which the new law costs less.
    pub better_share: f64,
    /// Whether the new law is kept.
    pub certain: bool,
    /// The reason, in a sentence.
    pub why: String,
}

/// Compares the costs of two laws, flight by flight; the vehicle was lost on none of them.
pub(crate) fn compare_costs(old: &[f64], new: &[f64]) -> Gain {
    let judged = |costs: &[f64]| -> Vec<Judged> {
        let flown =
            |cost: &f64| Judged { lost: false, violates: false, of_limit: None, cost: *cost, figures: None };
        costs.iter().map(flown).collect()
    };
    compare(&judged(old), &judged(new))
}

/// Compares both laws draw by draw.
pub(super) fn compare(old: &[Judged], new: &[Judged]) -> Gain {
    let pairs = || old.iter().zip(new);
    let logs: Vec<f64> = pairs()
        .filter(|(a, b)| a.cost.is_finite() && b.cost.is_finite() && a.cost > 0.0 && b.cost > 0.0)
        .map(|(a, b)| (b.cost / a.cost).ln())
        .collect();
    let count = logs.len() as f64;
    let mean = logs.iter().sum::<f64>() / count;
    let variance = logs.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let half = 1.96 * (variance / count).sqrt();
    let known = (count >= 2.0).then_some((mean, half));
    let better = pairs().filter(|(a, b)| b.cost < a.cost).count() as f64 / old.len().max(1) as f64;
    let count_of = |list: &[Judged], of: &dyn Fn(&Judged) -> bool| list.iter().filter(|j| of(j)).count();
    let (lost_old, lost_new) = (count_of(old, &|j| j.lost), count_of(new, &|j| j.lost));
    let (violated_old, violated_new) = (count_of(old, &|j| j.violates), count_of(new, &|j| j.violates));
    let saves = lost_new < lost_old;
    let broken_alone = |a: &[Judged], b: &[Judged]| {
        a.iter().zip(b).filter(|(a, b)| a.violates && !b.violates).count() as u64
    };
    let keeps = more_often_in_pairs(broken_alone(old, new), broken_alone(new, old));
    let cheaper = known.is_some_and(|(mean, half)| mean + half < 0.0) && better > BETTER_SHARE;
    let why = if lost_new > lost_old {
        format!("the new law loses the vehicle on {lost_new} draws, the old one on {lost_old}")
    } else if violated_new > violated_old {
        format!("the new law breaks an expectation on {violated_new} draws, the old one on {violated_old}")
    } else if saves {
        format!("the old law loses the vehicle on {lost_old} draws, the new one on {lost_new}")
    } else if keeps {
        format!("the old law breaks an expectation on {violated_old} draws, the new one on {violated_new}")
    } else if cheaper {
        format!("the new law costs less on {:.0} % of the draws", 100.0 * better)
    } else {
        "it is not certain that the new law breaks expectations on fewer draws or costs less".into()
    };
    Gain {
        cost_ratio: known.map(|(mean, _)| mean.exp()),
        cost_ratio_low: known.map(|(mean, half)| (mean - half).exp()),
        cost_ratio_high: known.map(|(mean, half)| (mean + half).exp()),
        better_share: better,
        certain: lost_new <= lost_old && violated_new <= violated_old && (saves || keeps || cheaper),
        why,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flown(cost: f64) -> Judged {
        Judged { lost: cost.is_infinite(), violates: cost.is_infinite(), of_limit: None, cost, figures: None }
    }

    #[test]
    fn a_gain_is_certain_only_where_the_draws_agree() {
        let all = |costs: &[f64]| costs.iter().copied().map(flown).collect::<Vec<_>>();
        let old = all(&[1.0, 1.1, 0.9, 1.05]);
        let better = compare(&old, &all(&[0.5, 0.6, 0.45, 0.5]));
        assert!(better.certain && better.cost_ratio_high.unwrap() < 0.6, "{better:?}");
        let mixed = compare(&old, &all(&[0.5, 2.0, 0.4, 1.9]));
        assert!(!mixed.certain && mixed.why.contains("it is not certain"), "{mixed:?}");
        let fatal = compare(&old, &all(&[0.1, 0.1, 0.1, f64::INFINITY]));
        assert!(!fatal.certain && fatal.why.contains("loses the vehicle on 1 draws"), "{fatal:?}");
        let saved = compare(&all(&[f64::INFINITY; 4]), &old);
        assert!(saved.certain && saved.cost_ratio.is_none(), "{saved:?}");
        let same = compare(&old, &old);
        assert!(!same.certain, "{same:?}");
    }

    /// `[expect]` states the wishes of its author, which the cost does not know.
    #[test]
    fn fewer_broken_expectations_are_a_gain_whatever_they_cost() {
        let breaking = |count: usize, cost: f64| -> Vec<Judged> {
            (0..40).map(|k| Judged { violates: k < count, ..flown(cost) }).collect()
        };
        let kept = compare(&breaking(10, 1.0), &breaking(2, 1.2));
        assert!(kept.certain && kept.cost_ratio.unwrap() > 1.1, "{kept:?}");
        assert_eq!(kept.why, "the old law breaks an expectation on 10 draws, the new one on 2");
        let chance = compare(&breaking(10, 1.0), &breaking(7, 1.2));
        assert!(!chance.certain && chance.why.contains("it is not certain"), "{chance:?}");
        let more = compare(&breaking(2, 1.0), &breaking(10, 0.1));
        assert!(!more.certain && more.why.contains("the new law breaks an expectation on 10"), "{more:?}");
    }
}
