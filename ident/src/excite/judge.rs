//! What a flight will tell: Cramer and Rao's bounds of the parameters, detectability of effects.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use whirlstand_vehicle::{Effect, Kind, Simulator, SimulatorError, Vehicle};

use super::{ExpectedEffect, ExpectedParameter, Flight};
use crate::identify::Nuisance;
use crate::identify::data::Segment;
use crate::identify::normal::{Normal, pseudo_inverse};
use crate::identify::problem::{Problem, Sweep};
use crate::identify::spread::undetermined;

/// Detectability that a test needs.
const NEEDED: f64 = 12.0;

/// Effects that are judged: kind, parameters that make it null, the parameter that grows, and its size. Sizes with the
/// unit of the signal are in shares of its greatest value.
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

/// The flight as data without measured values.
fn segment(vehicle: &Vehicle, flight: &Flight) -> Segment {
    let (m, p) = (vehicle.inputs.len(), vehicle.outputs.len());
    let steps = flight.inputs.first().map_or(0, Vec::len);
    let mut outputs = vec![f64::NAN; steps * p];
    for (i, output) in vehicle.outputs.iter().enumerate() {
        (0..steps).step_by(output.every as usize).for_each(|k| outputs[k * p + i] = 0.0);
    }
    Segment {
        origin: "designed flight".into(),
        start_s: 0.0,
        period_s: flight.period_s,
        inputs: (0..steps * m).map(|at| flight.inputs[at % m][at / m]).collect(),
        outputs,
        steps,
    }
}

/// Fills in parameters and effects.
pub fn judge(vehicle: &Vehicle, flight: &mut Flight) -> Result<(), SimulatorError> {
    let data = [segment(vehicle, flight)];
    let nuisance = Nuisance { initial_state: true, output_offsets: false };
    let mut base = vehicle.clone();
    let Ok(problem) = Problem::new(vehicle, &data, nuisance) else {
        flight
            .remarks
            .push("The vehicle file frees no parameter, so that no standard error can be expected.".into());
        return Ok(());
    };
    let noise: Vec<f64> = vehicle.outputs.iter().map(|o| o.noise).collect();
    if noise.iter().all(|n| *n == 0.0) {
        flight.remarks.push(
            "The vehicle file declares no sensor noise, so that nothing can be expected of a record.".into(),
        );
        return Ok(());
    }
    base.free.clear();
    let theta: Vec<f64> = problem.parameters.iter().map(|p| vehicle.free_value(&p.target)).collect();
    let Some(simulation) = problem.simulation(&theta) else { return Ok(()) };
    let Some(information) =
        sums(&*simulation, &data[0], &noise, problem.nuisances(), None).map(|s| s.information)
    else {
        return Ok(());
    };
    let np = theta.len();
    let reduced = crate::identify::spread::marginal(&information, np);
    let mut left = problem.parameters.clone();
    let mut known: Vec<usize> = (0..np).collect();
    // Parameters that the flight does not determine are left out one after the other, as in a fit.
    while let Some(f) = reduced.as_ref().map(|f| f.select_rows(&known).select_columns(&known)) {
        let Some(covariance) = pseudo_inverse(&f) else { break };
        match undetermined(&f, &covariance, &left) {
            Some(u) if left.len() > 1 => {
                left.remove(u.index);
                known.remove(u.index);
            }
            _ => {
                let error = |i: usize| {
                    known.iter().position(|k| *k == i).map(|at| covariance[(at, at)].max(0.0).sqrt())
                };
                flight.parameters = problem
                    .parameters
                    .iter()
                    .enumerate()
                    .map(|(i, p)| ExpectedParameter {
                        name: p.name.clone(),
                        value: theta[i] / p.factor,
                        standard_error: error(i).map(|e| e / p.factor),
                    })
                    .collect();
                break;
            }
        }
    }
    flight.effects = effects(&base, &data[0], flight, &*simulation, &information, &noise)?;
    Ok(())
}

/// Normal equations of the flight, whitened by the noise, with `change` (steps x outputs) as the residual.
fn sums(
    simulation: &dyn Sweep,
    data: &Segment,
    noise: &[f64],
    nuisances: usize,
    change: Option<&[f64]>,
) -> Option<crate::identify::normal::Sums> {
    let (p, columns) = (noise.len(), simulation.columns());
    let mut normal = Normal::new(columns);
    let mut row = vec![0.0; columns];
    let nuisance = vec![0.0; nuisances];
    let fine = simulation.sweep(data, &nuisance, &mut |step| {
        for (i, std) in noise.iter().enumerate() {
            if *std > 0.0 && data.outputs[step.k * p + i].is_finite() {
                let slopes = &step.slopes[i * columns..(i + 1) * columns];
                row.iter_mut().zip(slopes).for_each(|(r, s)| *r = s / std);
                normal.add(&row, change.map_or(0.0, |c| c[step.k * p + i] / std));
            }
        }
    });
    fine.then(|| normal.finish())
}

/// The outputs of the vehicle over the flight, steps x outputs.
fn outputs(vehicle: &Vehicle, data: &Segment) -> Result<Vec<f64>, SimulatorError> {
    let mut simulator = Simulator::expected(vehicle, data.period_s)?;
    let mut all = vec![0.0; data.outputs.len()];
    simulator.run(&data.inputs, &mut all);
    Ok(all)
}

fn effects(
    vehicle: &Vehicle,
    data: &Segment,
    flight: &Flight,
    simulation: &dyn Sweep,
    information: &DMatrix<f64>,
    noise: &[f64],
) -> Result<Vec<ExpectedEffect>, SimulatorError> {
    let nominal = outputs(vehicle, data)?;
    let amplitude = |name: &str| flight.amplitudes.iter().find(|(n, _)| n == name).map_or(1.0, |(_, v)| *v);
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
    let inverse = pseudo_inverse(information);
    let judged = candidates.par_iter().map(|(effect, parameter, size, distance)| {
        let mut extended = vehicle.clone();
        extended.add_effect(effect.clone()).ok()?;
        let changed = outputs(&extended, data).ok()?;
        let change: Vec<f64> = changed.iter().zip(&nominal).map(|(a, b)| a - b).collect();
        let sums = sums(simulation, data, noise, vehicle.states.len(), Some(&change))?;
        let right: &DVector<f64> = &sums.right;
        let imitated = right.dot(&(inverse.as_ref()? * right));
        let detectability = (sums.square - imitated).max(0.0);
        Some(ExpectedEffect {
            effect: effect.kind().name().into(),
            place: effect.place().into(),
            parameter: (*parameter).to_string(),
            size: *size,
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
