//! Results of a tuning on a known true vehicle: the old law, the new law, and one designed on the truth fly it.

use serde::Serialize;
use whirlstand_nodes::config::LawKind;
use whirlstand_nodes::setup::Setup;

use super::draws::Draws;
use super::joint::Joint;
use super::judge::{Gain, Judged, LawFigures, compare};
use super::pilot::Pilot;
use super::trials::Trials;
use crate::campaign::limits;
use crate::command::vehicles::find;
use crate::error::Failure;
use crate::file::Plan;
use whirlstand_vehicle::Vehicle;

/// Offset of the truth's seeds from those of the draws, so that no flight has noise on which a law was
/// chosen.
const FRESH: u64 = 1 << 32;

/// Flights of the three laws on the true vehicle.
pub(super) struct Flights {
    vehicle: Vehicle,
    old: Vec<Judged>,
    new: Vec<Judged>,
    designed: Vec<Judged>,
}

/// Results of the laws on the true vehicle.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct OnTruth {
    /// Figures of the old law.
    pub before: LawFigures,
    /// Figures of the law in `tuned.toml`: the old one where that was kept.
    pub after: LawFigures,
    /// Figures of the new law, kept or not.
    pub new: LawFigures,
    /// Figures of a law of the same kind and options as the new one, designed on the truth.
    pub designed: LawFigures,
    /// Comparison of the law in `tuned.toml` with the old one.
    pub gain: Gain,
    /// Comparison of the new law with the old one.
    pub gain_of_new: Gain,
    /// Comparison of the law designed on the truth with the old one: the attainable gain.
    pub gain_of_designed: Gain,
    /// (before - after) / (before - designed), of the median costs; absent where either loses the vehicle on most flights or
    /// the costs are the same.
    pub share: Option<f64>,
    /// The same share for the new law.
    pub share_of_new: Option<f64>,
}

/// Flies three laws on the vehicle in `path`: the old one and the new one, `laws`, and one that is designed on
/// that vehicle. `None` when a signal ended it.
///
/// # Errors
/// When the vehicle cannot be read, has other signals, or no law can be designed for it.
pub(super) fn fly(
    path: &str,
    plan: &Plan,
    [old, new]: [&Pilot; 2],
    count: u64,
) -> Result<Option<Flights>, Failure> {
    let vehicle = find(path)?;
    if let Some(what) = vehicle.signals_differ(&plan.vehicle) {
        return Err(Failure::Mend(format!(
            "--truth {path}: its {what} are not those of {}, which the launch file flies",
            plan.vehicle.name
        )));
    }
    let config = &plan.config;
    let designed = match new.controller.law {
        LawKind::Manual => None,
        _ => Some(Pilot::new(config, (&vehicle, path), new.controller.clone())?),
    };
    let draws = Draws::new(config, path, &vehicle, Joint::new(&[], &[]));
    let plant = Setup::plant_of(&vehicle, Setup::period_s(config)).map_err(Failure::mend)?;
    let trials = Trials { draws: &draws, vehicle: &vehicle, plant: &plant, limits: &limits(plan) };
    let laws: Vec<&Pilot> = [Some(old), Some(new), designed.as_ref()].into_iter().flatten().collect();
    let flown = trials.fly(&laws, FRESH..FRESH + count, &|_| {})?;
    Ok(flown.map(|flown| {
        let mut laws = flown.into_iter().map(|trials| trials.into_iter().map(|t| t.judged).collect());
        let mut next = || -> Vec<Judged> { laws.next().unwrap_or_default() };
        Flights { old: next(), new: next(), designed: next(), vehicle }
    }))
}

impl Flights {
    /// The figures of the flights, where the new law was `kept` or not.
    pub fn judged(self, kept: bool) -> OnTruth {
        let Self { vehicle, old, new, designed } = self;
        let figures = |judged: &[Judged]| LawFigures::of(judged, &vehicle);
        let chosen = if kept { &new } else { &old };
        let median = |judged: &[Judged]| {
            let mut costs: Vec<f64> = judged.iter().map(|j| j.cost).collect();
            costs.sort_by(f64::total_cmp);
            costs.get(costs.len() / 2).copied().unwrap_or(f64::NAN)
        };
        let share = |of: &[Judged]| {
            let share = (median(&old) - median(of)) / (median(&old) - median(&designed));
            share.is_finite().then_some(share)
        };
        OnTruth {
            share: share(chosen),
            share_of_new: share(&new),
            before: figures(&old),
            after: figures(chosen),
            new: figures(&new),
            designed: figures(&designed),
            gain: compare(&old, chosen),
            gain_of_new: compare(&old, &new),
            gain_of_designed: compare(&old, &designed),
        }
    }
}
