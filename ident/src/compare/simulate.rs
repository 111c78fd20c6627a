//! Free run and short-term predictions of a vehicle against a record.

use nalgebra::{DMatrix, DVector};
use whirlstand_linalg::symmetric_eigen;
use whirlstand_vehicle::{Kind, Simulator, Vehicle};

use super::comparison::CompareError;
use super::grid::Grid;
use whirlstand_logs::stats::mean;

/// A free run with the initial state that fits the record best.
#[derive(Debug, Clone)]
pub struct FreeRun {
    /// Initial state, SI.
    pub initial: Vec<f64>,
    /// Simulated outputs, SI: one vector for each output of the grid.
    pub outputs: Vec<Vec<f64>>,
    /// True when the simulation diverged.
    pub diverged: bool,
}

/// Inverse variance of every measured output, so that all outputs have the same weight, as in their fits.
fn weights(grid: &Grid, vehicle: &Vehicle) -> Vec<f64> {
    let variance = |y: &[f64]| {
        let known: Vec<f64> = y.iter().copied().filter(|v| v.is_finite()).collect();
        let m = mean(&known);
        mean(&known.iter().map(|v| (v - m) * (v - m)).collect::<Vec<_>>())
    };
    let floor = |i: usize| vehicle.outputs[i].noise.powi(2).max(1e-12);
    grid.measured.iter().zip(&grid.outputs).map(|(y, &i)| 1.0 / variance(y).max(floor(i))).collect()
}

/// Perturbation of a state for the sensitivity of the outputs. Except for nonlinear effects, the motion is
/// linear in it.
const NUDGE: f64 = 1e-3;

/// Runs the vehicle freely with the measured inputs. The initial state is the least-squares estimate over the
/// whole record (Gauss-Newton; exact in one step for a linear vehicle), so that it is not counted as an error
/// of the model. States that the outputs do not show start at zero.
///
/// Inputs before the record are unknown: delays and filters are assumed to hold either the resting commands
/// or the record's first ones, whichever fits the record better.
pub fn free_run(grid: &Grid, vehicle: &Vehicle) -> Result<FreeRun, CompareError> {
    let weights = weights(grid, vehicle);
    let first = grid.inputs.get(..vehicle.inputs.len()).unwrap_or_default();
    let rested = free_run_from(grid, vehicle, &weights, &[])?;
    let held = free_run_from(grid, vehicle, &weights, first)?;
    let cost = |run: &FreeRun| -> f64 {
        let outputs = grid.measured.iter().zip(&run.outputs).zip(&weights);
        let errors = outputs.map(|((y, p), w)| {
            let squares = y.iter().zip(p).map(|(y, p)| (y - p) * (y - p)).filter(|e| e.is_finite());
            w * squares.sum::<f64>()
        });
        errors.sum()
    };
    Ok(if cost(&held) < cost(&rested) { held } else { rested })
}

fn free_run_from(
    grid: &Grid,
    vehicle: &Vehicle,
    weights: &[f64],
    before: &[f64],
) -> Result<FreeRun, CompareError> {
    let n = vehicle.states.len();
    let mut nominal = Simulator::expected_from(vehicle, grid.period_s, before)?;
    nominal.begin_at(grid.first_step);
    let mut initial = vec![0.0; n];
    for _ in 0..3 {
        let Some(change) = correction(grid, vehicle, &nominal, &initial, weights) else { break };
        initial.iter_mut().zip(change.iter()).for_each(|(x, d)| *x += d);
        let size = change.iter().zip(&initial).fold(0.0f64, |m, (d, x)| m.max(d.abs() / (x.abs() + NUDGE)));
        if size < 1e-6 {
            break;
        }
    }
    let mut simulator = nominal;
    simulator.set_state(&initial);
    let mut outputs = vec![Vec::with_capacity(grid.t.len()); grid.outputs.len()];
    let m = vehicle.inputs.len();
    for k in 0..grid.t.len() {
        simulator.apply(&grid.inputs[k * m..(k + 1) * m]);
        let y = simulator.measure();
        outputs.iter_mut().zip(&grid.outputs).for_each(|(column, &i)| column.push(y[i]));
        simulator.advance();
    }
    let diverged = simulator.diverged() || outputs.iter().flatten().any(|y| !y.is_finite());
    Ok(FreeRun { initial, outputs, diverged })
}

/// Change of the initial state that removes most of the residual; `None` when the run diverges.
fn correction(
    grid: &Grid,
    vehicle: &Vehicle,
    nominal: &Simulator,
    initial: &[f64],
    weights: &[f64],
) -> Option<DVector<f64>> {
    let (n, m) = (vehicle.states.len(), vehicle.inputs.len());
    let mut simulators = nudged(nominal, initial);
    let (mut normal, mut right) = (DMatrix::zeros(n, n), DVector::zeros(n));
    let mut slopes = vec![0.0; n];
    for k in 0..grid.t.len() {
        for simulator in &mut simulators {
            simulator.apply(&grid.inputs[k * m..(k + 1) * m]);
            simulator.measure();
        }
        for ((measured, &i), weight) in grid.measured.iter().zip(&grid.outputs).zip(weights) {
            if !measured[k].is_finite() {
                continue;
            }
            let y = simulators[n].measure()[i];
            for (slope, simulator) in slopes.iter_mut().zip(&mut simulators) {
                *slope = (simulator.measure()[i] - y) / NUDGE;
            }
            let error = measured[k] - y;
            for a in 0..n {
                right[a] += weight * slopes[a] * error;
                for b in 0..=a {
                    normal[(a, b)] += weight * slopes[a] * slopes[b];
                }
            }
        }
        simulators.iter_mut().for_each(Simulator::advance);
    }
    if simulators.iter().any(Simulator::diverged) {
        return None;
    }
    solve(normal, right)
}

/// Simulators with one state perturbed each, followed by one without a perturbation.
fn nudged(nominal: &Simulator, initial: &[f64]) -> Vec<Simulator> {
    (0..=initial.len())
        .map(|j| {
            let mut state = initial.to_vec();
            if let Some(x) = state.get_mut(j) {
                *x += NUDGE;
            }
            let mut simulator = nominal.clone();
            simulator.set_state(&state);
            simulator
        })
        .collect()
}

/// Solves the normal equations (lower triangle given) with columns scaled to one; directions that the data
/// hardly determine (below 1e-9 of the strongest) stay at zero.
fn solve(mut normal: DMatrix<f64>, mut right: DVector<f64>) -> Option<DVector<f64>> {
    let n = normal.nrows();
    let scale: Vec<f64> =
        (0..n).map(|i| if normal[(i, i)] > 0.0 { 1.0 / normal[(i, i)].sqrt() } else { 0.0 }).collect();
    for a in 0..n {
        for b in 0..=a {
            let v = normal[(a, b)] * scale[a] * scale[b];
            normal[(a, b)] = v;
            normal[(b, a)] = v;
        }
        right[a] *= scale[a];
    }
    if normal.iter().chain(right.iter()).any(|v| !v.is_finite()) {
        return None;
    }
    let (values, vectors) = symmetric_eigen(normal).ok()?;
    let strongest = values.max();
    let mut solution = DVector::zeros(n);
    for (value, vector) in values.iter().zip(vectors.column_iter()) {
        if *value > 1e-9 * strongest {
            solution.axpy(vector.dot(&right) / value, &vector, 1.0);
        }
    }
    solution.iter_mut().zip(&scale).for_each(|(x, s)| *x *= s);
    Some(solution)
}

/// Errors of predictions over one horizon, SI: one vector for each output of the grid; NaN where no
/// prediction was made.
///
/// The record is cut into parts of one horizon. The state at the start of a part is fitted to that part
/// (least squares), propagated through the next part with the measured inputs, and compared there: the model
/// is judged on data not used in the fit, and an integrator cannot drift far.
pub fn predictions(
    grid: &Grid,
    vehicle: &Vehicle,
    run: &FreeRun,
    horizon_s: f64,
) -> Result<Vec<Vec<f64>>, CompareError> {
    let (n, m, p) = (vehicle.states.len(), vehicle.inputs.len(), grid.outputs.len());
    let horizon = ((horizon_s / grid.period_s).round() as usize).max(8);
    let mut errors = vec![vec![f64::NAN; grid.t.len()]; p];
    if grid.t.len() < 2 * horizon {
        return Ok(errors);
    }
    let nominal = Simulator::expected(vehicle, grid.period_s)?;
    let weights = weights(grid, vehicle);
    // Without time-dependent effects, one response serves all parts.
    let timed = vehicle.effects.iter().any(|e| !e.window().is_always() || e.kind() == Kind::ModeTransition);
    let mut slopes = slopes(grid, &nominal, (0, 2 * horizon), n, m);
    for start in (0..=grid.t.len() - 2 * horizon).step_by(horizon) {
        if timed && start > 0 {
            slopes = self::slopes(grid, &nominal, (start, 2 * horizon), n, m);
        }
        let residual = residual(grid, run, &nominal, start, 2 * horizon, m);
        let (mut normal, mut right) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for k in 0..horizon {
            for j in 0..p {
                let (slope, e) = (&slopes[(k * p + j) * n..][..n], residual[k * p + j]);
                if e.is_finite() {
                    for a in 0..n {
                        right[a] += weights[j] * slope[a] * e;
                        for b in 0..=a {
                            normal[(a, b)] += weights[j] * slope[a] * slope[b];
                        }
                    }
                }
            }
        }
        let Some(x) = solve(normal, right) else { continue };
        for k in horizon..2 * horizon {
            for (j, column) in errors.iter_mut().enumerate() {
                let slope = &slopes[(k * p + j) * n..][..n];
                let shown: f64 = slope.iter().zip(x.iter()).map(|(s, x)| s * x).sum();
                column[start + k] = residual[k * p + j] - shown;
            }
        }
    }
    Ok(errors)
}

/// Sensitivity of each output to each initial state, step by step from `start` on: (steps x outputs) x
/// states, row after row.
fn slopes(grid: &Grid, nominal: &Simulator, (start, steps): (usize, usize), n: usize, m: usize) -> Vec<f64> {
    let mut nominal = nominal.clone();
    nominal.begin_at(grid.first_step + start as u64);
    let mut simulators = nudged(&nominal, &vec![0.0; n]);
    let mut slopes = Vec::with_capacity(steps * grid.outputs.len() * n);
    for k in start..start + steps {
        for simulator in &mut simulators {
            simulator.apply(&grid.inputs[k * m..(k + 1) * m]);
            simulator.measure();
        }
        for &i in &grid.outputs {
            let y = simulators[n].measure()[i];
            for simulator in &mut simulators[..n] {
                slopes.push((simulator.measure()[i] - y) / NUDGE);
            }
        }
        simulators.iter_mut().for_each(Simulator::advance);
    }
    slopes
}

/// Measured minus simulated from step `start` on, (steps x outputs): against the free run, or, where that
/// diverged, against a run from rest at `start`.
fn residual(
    grid: &Grid,
    run: &FreeRun,
    nominal: &Simulator,
    start: usize,
    steps: usize,
    m: usize,
) -> Vec<f64> {
    let p = grid.outputs.len();
    let mut residual = Vec::with_capacity(steps * p);
    let mut fresh = run.diverged.then(|| nominal.clone());
    if let Some(simulator) = &mut fresh {
        simulator.begin_at(grid.first_step + start as u64);
    }
    for k in start..start + steps {
        if let Some(simulator) = &mut fresh {
            simulator.apply(&grid.inputs[k * m..(k + 1) * m]);
            let y = simulator.measure();
            residual.extend(grid.outputs.iter().zip(&grid.measured).map(|(&i, measured)| measured[k] - y[i]));
            simulator.advance();
        } else {
            residual.extend(run.outputs.iter().zip(&grid.measured).map(|(y, measured)| measured[k] - y[k]));
        }
    }
    residual
}
