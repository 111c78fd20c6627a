//! Weights of a law, optimised for the launch file's expectations.

use std::cell::{Cell, RefCell};

use argmin::core::{CostFunction, Error, Executor, State};
use argmin::solver::neldermead::NelderMead;
use serde::Serialize;
use whirlstand_control::design::LoopFigures;
use whirlstand_control::{LawOptions, Weights};
use whirlstand_nodes::config::{ControllerConfig, NodeConfig};
use whirlstand_vehicle::{LinearModel, Vehicle};

use super::judge::Judged;
use super::pilot::Pilot;
use super::trials::Trials;
use crate::error::Failure;

/// Number of draws on which weights are chosen; these draws are not used for the judgement.
const CHOICE: u64 = 16;

/// Most iterations of the search after the first simplex.
const MOST_ITERATIONS: u64 = 40;

/// First step of each weight in the natural logarithm: a factor of two.
const FIRST_STEP: f64 = std::f64::consts::LN_2;

/// Greatest change of any weight in the natural logarithm: a factor of a hundred.
const FARTHEST: f64 = 4.605_170_185_988_091;

/// Objective of weights that are not flown, because they give no law or too sensitive a loop: more than that of
/// any flight.
const NOT_FLOWN: f64 = 1e6;

/// Objective of a draw on which the vehicle was lost: more than that of any completed flight.
const LOST: f64 = 1e3;

/// The chosen weights, and the data on which they were chosen.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Retuned {
    /// First draw on which the weights were chosen; draws with lower numbers are those of the judgement.
    pub first_draw: u64,
    /// Number of these draws.
    pub draws: u64,
    /// Number of weight sets that were flown on all of these draws.
    pub tried: u64,
    /// Number of weight sets that were refused, because they give no law or too sensitive a loop.
    pub refused: u64,
    /// The objective that is minimised: `expectations`, the mean over the draws of the greatest figure as a
    /// multiple of its limit, or `cost` without expectations.
    pub against: &'static str,
    /// The objective with the original weights.
    pub before: f64,
    /// The objective with the chosen weights.
    pub after: f64,
    /// Largest permitted peak of the sensitivity.
    pub sensitivity_limit: f64,
    /// Peak of the sensitivity with the chosen weights.
    pub sensitivity: Option<f64>,
    /// The factor on each weight.
    pub factors: Vec<(String, f64)>,
}

/// A weight, or a group of weights with one common factor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Knob {
    /// LQR: the weight of an input.
    Input(usize),
    /// LQR: the weights of rates whose integral is a state too.
    Rates,
    /// LQR: the weights of the integrals.
    Integrals,
    /// PPC: the bandwidth.
    Bandwidth,
    /// SMC: the boundary layer of an input.
    Layer(usize),
}

/// The weights of a law that can be chosen.
struct Knobs {
    /// The options with every default written out.
    options: LawOptions,
    knobs: Vec<Knob>,
    /// Whether each state is a rate whose integral is a state too.
    is_rate: Vec<bool>,
    inputs: Vec<String>,
}

impl Knobs {
    fn new(pilot: &Pilot) -> Result<Self, Failure> {
        let refuse = |why: &str| Failure::Mend(format!("--retune: {why}"));
        let design =
            pilot.design.as_ref().ok_or_else(|| refuse("manual control has no weights to choose"))?;
        let plant = &design.plant;
        let options = design.options.resolved(plant).map_err(Failure::mend)?;
        let inputs = 0..plant.input_count();
        let mut is_rate = vec![false; plant.own_count()];
        for (rate, _) in plant.kinematic_rows().into_iter().flatten() {
            is_rate[rate] = true;
        }
        let knobs = match &options {
            LawOptions::Lqr(o) => {
                let mut knobs: Vec<Knob> = inputs.map(Knob::Input).collect();
                knobs.extend(is_rate.contains(&true).then_some(Knob::Rates));
                knobs.extend((!o.integral.is_empty()).then_some(Knob::Integrals));
                knobs
            }
            LawOptions::Ppc(o) if o.poles.is_some() => {
                return Err(refuse("controller.poles fixes the poles, so there is no bandwidth to choose"));
            }
            LawOptions::Ppc(_) => vec![Knob::Bandwidth],
            LawOptions::Smc(_) => inputs.map(Knob::Layer).collect(),
        };
        Ok(Self { options, knobs, is_rate, inputs: plant.input_names().to_vec() })
    }

    /// The options with each weight multiplied by e to the power of its element of `by`.
    fn turned(&self, by: &[f64]) -> LawOptions {
        let mut options = self.options.clone();
        for (knob, by) in self.knobs.iter().zip(by) {
            let factor = by.clamp(-FARTHEST, FARTHEST).exp();
            match (knob, &mut options) {
                (Knob::Input(i), LawOptions::Lqr(o)) => scale(&mut o.r, |at| at == *i, factor),
                (Knob::Rates, LawOptions::Lqr(o)) => scale(&mut o.q, |at| self.is_rate[at], factor),
                (Knob::Integrals, LawOptions::Lqr(o)) => {
                    o.integral_q.iter_mut().flatten().for_each(|weight| *weight *= factor);
                }
                (Knob::Bandwidth, LawOptions::Ppc(o)) => o.bandwidth = o.bandwidth.map(|b| b * factor),
                (Knob::Layer(i), LawOptions::Smc(o)) => scale(&mut o.boundary_layer, |at| at == *i, factor),
                _ => {}
            }
        }
        options
    }

    fn name(&self, knob: Knob) -> String {
        match knob {
            Knob::Input(i) => format!("r of {}", self.inputs[i]),
            Knob::Rates => "q of the rates".into(),
            Knob::Integrals => "integral_q".into(),
            Knob::Bandwidth => "bandwidth".into(),
            Knob::Layer(i) => format!("boundary_layer of {}", self.inputs[i]),
        }
    }
}

fn scale(weights: &mut Option<Weights>, of: impl Fn(usize) -> bool, factor: f64) {
    if let Some(Weights::List(list)) = weights {
        list.iter_mut().enumerate().filter(|(at, _)| of(*at)).for_each(|(_, weight)| *weight *= factor);
    }
}

/// The controller options of a launch file, with the options of a law written into them.
fn with_options(controller: &ControllerConfig, options: &LawOptions) -> ControllerConfig {
    let mut controller = controller.clone();
    match options {
        LawOptions::Lqr(o) => {
            (controller.q, controller.r) = (o.q.clone(), o.r.clone());
            controller.integral_q.clone_from(&o.integral_q);
        }
        LawOptions::Ppc(o) => controller.bandwidth = o.bandwidth,
        LawOptions::Smc(o) => controller.boundary_layer.clone_from(&o.boundary_layer),
    }
    controller
}

/// The problem for which weights are chosen.
pub(super) struct Wanted<'a> {
    /// Configuration of the bench.
    pub config: &'a NodeConfig,
    /// The vehicle for which the law is designed, and the folder of its file.
    pub model: (&'a Vehicle, &'a str),
    /// The flights of the laws.
    pub trials: &'a Trials<'a>,
    /// First draw that is not used for the judgement.
    pub first_draw: u64,
    /// Largest permitted peak of the sensitivity.
    pub sensitivity_limit: f64,
}

/// The search, with its counters.
struct Search<'a> {
    wanted: &'a Wanted<'a>,
    knobs: &'a Knobs,
    controller: &'a ControllerConfig,
    linear: &'a LinearModel,
    counts: &'a Counts,
}

#[derive(Default)]
struct Counts {
    tried: Cell<u64>,
    refused: Cell<u64>,
    interrupted: Cell<bool>,
    failure: RefCell<Option<Failure>>,
}

impl Search<'_> {
    /// The law with these weights, and the peak of the sensitivity with its filter; `None` where the weights give
    /// no law.
    fn pilot(&self, by: &[f64]) -> Option<(Pilot, f64)> {
        let controller = with_options(self.controller, &self.knobs.turned(by));
        let pilot = Pilot::new(self.wanted.config, self.wanted.model, controller).ok()?;
        let around = pilot.loop_around(self.linear, self.wanted.model.0);
        let peak = match (around, &pilot.design) {
            (Some(LoopFigures::Known(known)), _) if known.spectral_radius < 1.0 => {
                known.multivariable_margins.max_sensitivity
            }
            (Some(LoopFigures::Known(_)), _) => return None,
            // A filter that settles too slowly gives no margins; the margins of the law alone are used.
            (_, Some(design)) => design.multivariable_margins.max_sensitivity,
            (_, None) => return None,
        };
        Some((pilot, peak))
    }

    /// The objective of these weights on the draws of the choice.
    fn count(&self, by: &[f64]) -> Result<f64, Failure> {
        let beyond = by.iter().map(|v| (v.abs() - FARTHEST).max(0.0)).sum::<f64>();
        let Some((pilot, peak)) = self.pilot(by) else {
            self.counts.refused.set(self.counts.refused.get() + 1);
            return Ok(2.0 * NOT_FLOWN + beyond);
        };
        if peak > self.wanted.sensitivity_limit || beyond > 0.0 {
            self.counts.refused.set(self.counts.refused.get() + 1);
            return Ok(NOT_FLOWN + peak.min(NOT_FLOWN / 2.0) + beyond);
        }
        self.counts.tried.set(self.counts.tried.get() + 1);
        let numbers = self.wanted.first_draw..self.wanted.first_draw + CHOICE;
        let Some(flown) = self.wanted.trials.fly(&[&pilot], numbers, &|_| {})? else {
            self.counts.interrupted.set(true);
            return Err(Failure::Run("the search was interrupted by a signal".into()));
        };
        let each = flown.iter().flatten().map(|trial| counted(&trial.judged).min(LOST));
        Ok(each.sum::<f64>() / CHOICE as f64)
    }
}

/// The objective of a flight: its greatest figure as a multiple of the limit, or its cost without
/// expectations.
fn counted(judged: &Judged) -> f64 {
    if judged.lost { LOST } else { judged.of_limit.unwrap_or(judged.cost) }
}

impl CostFunction for &Search<'_> {
    type Param = Vec<f64>;
    type Output = f64;

    /// The solver panics on an error at the vertices of its first simplex. An error is therefore kept for later,
    /// and nothing more is flown.
    fn cost(&self, by: &Vec<f64>) -> Result<f64, Error> {
        if self.counts.failure.borrow().is_some() {
            return Ok(2.0 * NOT_FLOWN);
        }
        Ok(self.count(by).unwrap_or_else(|failure| {
            self.counts.failure.replace(Some(failure));
            2.0 * NOT_FLOWN
        }))
    }
}

/// Chooses weights for the law of `pilot` by the simplex method of Nelder and Mead (1965). Returns the law with
/// these weights and a description of the choice. The law is unchanged where no other weights have a smaller
/// objective. `None` when a signal ended it.
///
/// # Errors
/// For a law without weights, and when a flight fails for another reason than the loss of the vehicle.
pub(super) fn retune(pilot: Pilot, wanted: &Wanted<'_>) -> Result<Option<(Pilot, Retuned)>, Failure> {
    let knobs = Knobs::new(&pilot)?;
    let linear = LinearModel::new(wanted.model.0).map_err(Failure::mend)?;
    let counts = Counts::default();
    let search =
        Search { wanted, knobs: &knobs, controller: &pilot.controller, linear: &linear, counts: &counts };
    let start = vec![0.0; knobs.knobs.len()];
    let mut simplex = vec![start.clone()];
    for at in 0..start.len() {
        let mut corner = start.clone();
        corner[at] = -FIRST_STEP;
        simplex.push(corner);
    }
    let solver = NelderMead::new(simplex).with_sd_tolerance(1e-3).map_err(Failure::run)?;
    let found = Executor::new(&search, solver).configure(|state| state.max_iters(MOST_ITERATIONS)).run();
    let found = match (found, counts.interrupted.get(), counts.failure.take()) {
        (_, true, _) => return Ok(None),
        (_, _, Some(failure)) => return Err(failure),
        (Err(error), ..) => return Err(Failure::run(error)),
        (Ok(found), ..) => found,
    };
    let before = search.count(&start)?;
    let best = found.state().get_best_param().cloned().unwrap_or_else(|| start.clone());
    let best_count = found.state().get_best_cost();
    let chosen = if best_count < before && best_count < NOT_FLOWN { best } else { start };
    let after = best_count.min(before);
    let (chosen_pilot, sensitivity) = match search.pilot(&chosen) {
        Some((chosen, peak)) => (Some(chosen), Some(peak)),
        None => (None, None),
    };
    let told = Retuned {
        first_draw: wanted.first_draw,
        draws: CHOICE,
        tried: counts.tried.get(),
        refused: counts.refused.get(),
        against: if wanted.trials.limits.iter().any(|l| l.key.contains('.')) {
            "expectations"
        } else {
            "cost"
        },
        before,
        after,
        sensitivity_limit: wanted.sensitivity_limit,
        sensitivity,
        factors: knobs.knobs.iter().zip(&chosen).map(|(k, by)| (knobs.name(*k), by.exp())).collect(),
    };
    Ok(Some((chosen_pilot.unwrap_or(pilot), told)))
}
