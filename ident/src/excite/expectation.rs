//! Expected accuracy of a flight: Cramer-Rao bounds of the parameters, detectability of effects.

use crate::identify::sweep::simulation;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use whirlstand_logs::shown::ShownUnit;
use whirlstand_vehicle::{Effect, Kind, SimulatorError, Vehicle};

use super::closed_loop::{ClosedLoop, FlightData, fly};
use super::flight::{ExpectedEffect, ExpectedParameter, Flight};
use crate::identify::data::Segment;
use crate::identify::normal::{Normal, Sums, pseudo_inverse};
use crate::identify::predictor::{Gains, NoiseStructure, Pattern};
use crate::identify::problem::{Problem, Sweep};
use crate::identify::spread::undetermined;
use crate::identify::{Nuisance, filter_error};

/// Detectability that a test requires.
const NEEDED: f64 = 12.0;

/// Effects whose detectability is computed: kind, parameters of the null effect, the varied parameter, and
/// its size. Sizes with the unit of the signal are shares of its largest value.
type Row = (Kind, &'static [(&'static str, f64)], &'static str, f64, bool);
const INPUT: &[Row] = &[
    (Kind::InputDelay, &[("delay_s", 0.0)], "delay_s", 0.02, false),
    (Kind::ActuatorLag, &[("time_constant_s", 0.0)], "time_constant_s", 0.02, false),
    (Kind::InputGain, &[("factor", 1.0)], "factor", 0.9, false),
    (Kind::GainDrift, &[("rate_per_s", 0.0)], "rate_per_s", -0.001, false),
    (Kind::InputBias, &[("offset", 0.0)], "offset", 0.05, true),
    (Kind::DeadZone, &[("width", 0.0)], "width", 0.05, true),
    (Kind::InputSaturation, &[("lower", -1e9), ("upper", 1e9)], "upper", 0.8, true),
    (Kind::RateLimit, &[("limit_per_s", 1e9)], "limit_per_s", 5.0, true),
    (Kind::Backlash, &[("width", 0.0)], "width", 0.05, true),
];
const STATE: &[Row] = &[
    (Kind::QuadraticDrag, &[("coefficient", 0.0)], "coefficient", 0.1, false),
    (Kind::CoulombFriction, &[("level", 0.0)], "level", 0.05, true),
];
const OUTPUT: &[Row] = &[
    (Kind::SensorBias, &[("offset", 0.0)], "offset", 0.02, true),
    (Kind::SensorDrift, &[("rate_per_s", 0.0)], "rate_per_s", 0.001, true),
    (Kind::SensorScale, &[("factor", 1.0)], "factor", 0.95, false),
    (Kind::SensorDelay, &[("delay_s", 0.0)], "delay_s", 0.02, false),
    (Kind::SensorLag, &[("time_constant_s", 0.0)], "time_constant_s", 0.02, false),
];

/// The flight as data: its inputs, and its outputs at the steps at which they are fresh.
fn segment(vehicle: &Vehicle, period_s: f64, flown: FlightData) -> Segment {
    let p = vehicle.outputs.len();
    let steps = flown.outputs.len() / p.max(1);
    let mut outputs = flown.outputs;
    for (at, value) in outputs.iter_mut().enumerate() {
        if !(at / p).is_multiple_of(vehicle.outputs[at % p].every as usize) {
            *value = f64::NAN;
        }
    }
    Segment {
        origin: "designed flight".into(),
        start_s: 0.0,
        first_step: 0,
        period_s,
        inputs: flown.inputs,
        outputs,
        steps,
    }
}

/// Model that evaluates a flight: the simulation of an open-loop fit, or the predictor of a closed-loop fit.
struct Observer<'a> {
    problem: &'a Problem,
    noise: &'a [f64],
    kind: Form<'a>,
}

enum Form<'a> {
    Simulation(Box<dyn Sweep + 'a>),
    Predictor(Gains, Vec<f64>),
}

impl<'a> Observer<'a> {
    fn new(problem: &'a Problem, noise: &'a [f64], data: &Segment, closed: bool) -> Option<Self> {
        let theta: Vec<f64> =
            problem.parameters.iter().map(|p| problem.vehicle.free_value(&p.target)).collect();
        let kind = if closed {
            let structure = NoiseStructure::new(problem);
            // Only the sensors are noisy; a small process noise keeps the filter gain from vanishing.
            let least = noise.iter().copied().filter(|n| *n > 0.0).fold(f64::INFINITY, f64::min);
            let driving = (1e-3 * least / problem.period_s.sqrt()).ln();
            let measuring = structure.outputs.iter().map(|i| noise[*i].ln());
            let noises: Vec<f64> = structure.states.iter().map(|_| driving).chain(measuring).collect();
            let pattern = Pattern::of(data, problem.p());
            // Gains are fixed, so that an effect's contribution to the innovations does not enter the
            // sensitivities.
            Form::Predictor(Gains::new(problem, &structure, &pattern, &theta, &noises, false)?, theta)
        } else {
            Form::Simulation(simulation(problem, &theta)?)
        };
        Some(Self { problem, noise, kind })
    }

    /// Normal equations of parameters and initial state over `data`, whitened; the residual is the difference
    /// of `data` from `nominal`, or the predictor's innovations.
    fn sums(&self, data: &Segment, nominal: &Segment) -> Option<Sums> {
        match &self.kind {
            Form::Predictor(gains, theta) => {
                let sums = filter_error::sums(self.problem, gains, data, theta)?;
                // The noise parameters are taken as known.
                let keep: Vec<usize> = (0..sums.right.len())
                    .filter(|i| !(theta.len()..theta.len() + gains.noise_parameters).contains(i))
                    .collect();
                Some(Sums {
                    information: sums.information.select_rows(&keep).select_columns(&keep),
                    right: sums.right.select_rows(&keep),
                    ..sums
                })
            }
            Form::Simulation(simulation) => {
                let (p, columns) = (self.noise.len(), simulation.columns());
                let mut normal = Normal::new(columns);
                let mut row = vec![0.0; columns];
                let nuisance = vec![0.0; self.problem.nuisances()];
                let fine = simulation.sweep(nominal, &nuisance, &mut |step| {
                    for (i, std) in self.noise.iter().enumerate() {
                        let at = step.k * p + i;
                        if *std > 0.0 && nominal.outputs[at].is_finite() {
                            let slopes = step.slopes(i);
                            row.iter_mut().zip(slopes).for_each(|(r, s)| *r = s / std);
                            normal.add(&row, (data.outputs[at] - nominal.outputs[at]) / std);
                        }
                    }
                });
                fine.then(|| normal.finish())
            }
        }
    }
}

/// Computes the expected accuracy of the parameters and the detectability of the effects.
pub fn expect(
    vehicle: &Vehicle,
    flight: &mut Flight,
    closed: Option<&ClosedLoop>,
) -> Result<(), SimulatorError> {
    let flown = |vehicle: &Vehicle| -> Result<Segment, SimulatorError> {
        Ok(segment(vehicle, flight.period_s, fly(vehicle, flight.period_s, &flight.signals, closed)?))
    };
    let data = [flown(vehicle)?];
    let nuisance = Nuisance { initial_state: true, output_offsets: false };
    let mut base = vehicle.clone();
    let Ok(mut problem) = Problem::new(vehicle, &data, nuisance) else {
        flight
            .remarks
            .push("The vehicle file has no free parameter, so no standard errors can be predicted.".into());
        return Ok(());
    };
    let noise: Vec<f64> = vehicle.outputs.iter().map(|o| o.noise).collect();
    if noise.iter().all(|n| *n == 0.0) {
        flight.remarks.push(
            "The vehicle file declares no sensor noise, so the accuracy of a record cannot be predicted."
                .into(),
        );
        return Ok(());
    }
    base.free.clear();
    problem.weights.iter_mut().zip(&noise).for_each(|(w, n)| *w = if *n > 0.0 { *w } else { 0.0 });
    let [data] = data;
    let Some(observer) = Observer::new(&problem, &noise, &data, closed.is_some()) else { return Ok(()) };
    let Some(information) = observer.sums(&data, &data).map(|s| s.information) else { return Ok(()) };
    flight.parameters = parameters(&problem, &information);
    let effects = effects(&base, &data, flight, &observer, &flown)?;
    flight.effects = effects;
    Ok(())
}

/// Smallest standard errors. Parameters that the flight does not determine are left out one after the other,
/// as in a fit.
fn parameters(problem: &Problem, information: &DMatrix<f64>) -> Vec<ExpectedParameter> {
    let np = problem.parameters.len();
    let reduced = crate::identify::spread::marginal(information, np);
    let mut left = problem.parameters.clone();
    let mut known: Vec<usize> = (0..np).collect();
    let mut errors = vec![None; np];
    while let Some(f) = reduced.as_ref().map(|f| f.select_rows(&known).select_columns(&known)) {
        let Some(covariance) = pseudo_inverse(&f) else { break };
        match undetermined(&f, &covariance, &left) {
            Some(u) if left.len() > 1 => {
                left.remove(u.index);
                known.remove(u.index);
            }
            _ => {
                for (at, i) in known.iter().enumerate() {
                    errors[*i] = Some(covariance[(at, at)].max(0.0).sqrt());
                }
                break;
            }
        }
    }
    let all = problem.parameters.iter().zip(errors);
    all.map(|(p, error)| ExpectedParameter {
        name: p.name.clone(),
        value: problem.vehicle.free_value(&p.target) / p.factor,
        unit: problem.vehicle.free_unit(&p.target),
        standard_error: error.map(|e| e / p.factor),
    })
    .collect()
}

fn effects(
    vehicle: &Vehicle,
    data: &Segment,
    flight: &Flight,
    observer: &Observer<'_>,
    flown: &(dyn Fn(&Vehicle) -> Result<Segment, SimulatorError> + Sync),
) -> Result<Vec<ExpectedEffect>, SimulatorError> {
    let amplitude = |name: &str| flight.commands.iter().find(|(n, _)| n == name).map_or(1.0, |(_, v)| *v);
    let peak = |name: &str| flight.peaks.iter().find(|(n, ..)| n == name).map_or(1.0, |(.., v)| *v);
    let mut candidates: Vec<(Effect, &str, f64, f64)> = Vec::new();
    let mut add = |row: &Row, place: &str, scale: f64| {
        let (kind, null, parameter, size, scaled) = *row;
        let size = if scaled { size * scale } else { size };
        let nothing = null.iter().find(|(n, _)| *n == parameter).map_or(0.0, |(_, v)| *v);
        if let Ok(mut effect) = Effect::new(kind, place, null)
            && effect.set_parameter(parameter, size).is_ok()
        {
            let distance = if nothing.abs() >= 1e9 { size } else { size - nothing };
            candidates.push((effect, parameter, size, distance));
        }
    };
    for input in &vehicle.inputs {
        INPUT.iter().for_each(|row| add(row, &input.name, amplitude(&input.name)));
    }
    for state in &vehicle.states {
        STATE.iter().for_each(|row| add(row, &state.name, peak(&state.name)));
    }
    for output in &vehicle.outputs {
        OUTPUT.iter().for_each(|row| add(row, &output.name, peak(&output.name)));
    }
    let judged = candidates.par_iter().map(|(effect, parameter, size, distance)| {
        let mut extended = vehicle.clone();
        extended.add_effect(effect.clone()).ok()?;
        let sums = observer.sums(&flown(&extended).ok()?, data)?;
        let right: &DVector<f64> = &sums.right;
        let imitated = right.dot(&(pseudo_inverse(&sums.information)? * right));
        let detectability = (sums.square - imitated).max(0.0);
        Some(ExpectedEffect {
            effect: effect.kind().name().into(),
            place: effect.place().into(),
            parameter: (*parameter).to_string(),
            size: *size,
            unit: effect.unit(parameter, vehicle).map_or_else(ShownUnit::default, |unit| unit.in_words()),
            detectability,
            least_size: if detectability > 0.0 {
                distance.abs() * (NEEDED / detectability).sqrt()
            } else {
                f64::INFINITY
            },
        })
    });
    Ok(judged.flatten().collect())
}
