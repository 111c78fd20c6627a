//! Linear-quadratic regulator, with and without input delays.

use nalgebra::DMatrix;
use whirlstand_vehicle::split_time;

use super::linear_law::LinearLaw;
use super::reduced::{ReducedLoop, split, with_integrals, with_integrals_of};
use super::{DesignError, resolve};
use crate::lqr::sampled_cost;
use crate::options::LqrOptions;
use crate::riccati::dare;
use crate::sampled_model::SampledModel;
use crate::sampled_plant::SampledPlant;

/// Weights of a regulator: of the vehicle's own states, of the inputs, and of the integrals.
pub struct LqrWeights {
    pub q: Vec<f64>,
    pub r: Vec<f64>,
    pub integral_q: Vec<f64>,
}

/// The weights of the options, with the defaults.
pub fn weights(plant: &SampledPlant, o: &LqrOptions, integral: &[usize]) -> Result<LqrWeights, DesignError> {
    let q = resolve::weights("q", o.q.as_ref(), plant.own_names(), resolve::bryson(plant, 0.01), true)?;
    let authority = plant.inputs().iter().map(|i| 1.0 / (i.authority() * i.authority())).collect();
    let r = resolve::weights("r", o.r.as_ref(), plant.input_names(), authority, false)?;
    let integral_q = match &o.integral_q {
        None => integral.iter().map(|&i| 0.25 * q[i]).collect(),
        Some(list) if list.len() == integral.len() => list.clone(),
        Some(list) => {
            return Err(DesignError::Count { option: "integral_q", got: list.len(), wanted: integral.len() });
        }
    };
    if let Some(value) = integral_q.iter().find(|v| !(v.is_finite() && **v > 0.0)) {
        return Err(DesignError::Value { option: "integral_q", value: *value, needed: "positive" });
    }
    Ok(LqrWeights { q, r, integral_q })
}

/// Linear-quadratic regulator for the sampled continuous cost.
pub fn lqr(
    plant: &SampledPlant,
    o: &LqrOptions,
    integral: &[usize],
) -> Result<(LinearLaw, Option<ReducedLoop>), DesignError> {
    let (n, m, dt) = (plant.state_count(), plant.input_count(), plant.period_s());
    let LqrWeights { mut q, r, integral_q } = weights(plant, o, integral)?;
    // Actuator states have no weight, as R weights their inputs.
    q.resize(n, 0.0);
    let diagonal = |v: &[f64]| DMatrix::from_diagonal(&nalgebra::DVector::from_column_slice(v));
    if let Some(model) = plant.delayed() {
        let problem = Regulator { q: diagonal(&q), r: diagonal(&r) * dt, integral_q: &integral_q };
        let (gain, reduced) = delayed_regulator(plant, model, &problem, integral)?;
        let linear = split(plant, integral, &gain);
        return Ok((linear, Some(reduced)));
    }
    let cost = sampled_cost(plant.a(), plant.b(), &diagonal(&q), &diagonal(&r), dt)?;
    let (phi, gamma) = with_integrals(plant, integral);
    let size = n + integral.len();
    let mut qd = DMatrix::zeros(size, size);
    qd.view_mut((0, 0), (n, n)).copy_from(&cost.q);
    integral_q.iter().enumerate().for_each(|(k, v)| qd[(n + k, n + k)] = v * dt);
    let mut sd = DMatrix::zeros(size, m);
    sd.view_mut((0, 0), (n, m)).copy_from(&cost.s);
    let solution = dare(&phi, &gamma, &qd, &cost.r, Some(&sd))?;
    Ok((split(plant, integral, &solution.gain), None))
}

/// Weights of the regulator: of the continuous states, of the inputs over a period, and of the integrals.
struct Regulator<'a> {
    q: DMatrix<f64>,
    r: DMatrix<f64>,
    integral_q: &'a [f64],
}

/// Largest number of states of the Riccati equation: differences between input delays count, not their common
/// part.
const MOST_STATES: usize = 120;

/// Regulator of a plant with delayed inputs. No command of the present changes the states before the shortest
/// delay is over, so the equation is that of the plant with all delays reduced by it, and its gain acts on
/// the prediction over it.
fn delayed_regulator(
    plant: &SampledPlant,
    model: &SampledModel,
    problem: &Regulator<'_>,
    integral: &[usize],
) -> Result<(DMatrix<f64>, ReducedLoop), DesignError> {
    let (m, dt, motion) = (plant.input_count(), plant.period_s(), plant.state_count());
    let common = plant.delays_s().iter().map(|d| split_time(*d, dt).0 as usize).min().unwrap_or(0);
    let reduced = model.sooner(common, dt)?;
    let (known, q) = (reduced.layout.known(), integral.len());
    if known > MOST_STATES {
        return Err(DesignError::Spread { states: known, most: MOST_STATES });
    }
    let (phi, gamma) = with_integrals_of(&reduced.f, &reduced.g, dt, integral);
    let cost = reduced.cost(&problem.q)?;
    let size = known + q;
    let mut qd = DMatrix::zeros(size, size);
    qd.view_mut((0, 0), (known, known)).copy_from(&cost.view((0, 0), (known, known)));
    problem.integral_q.iter().enumerate().for_each(|(k, v)| qd[(known + k, known + k)] = v * dt);
    let mut sd = DMatrix::zeros(size, m);
    sd.view_mut((0, 0), (known, m)).copy_from(&cost.view((0, known), (known, m)));
    let rd = cost.view((known, known), (m, m)) + &problem.r;
    let solution = dare(&phi, &gamma, &qd, &rd, Some(&sd))?;
    // From the present states to those after the common delay: integrals and motion propagate, later commands
    // are unknown.
    let (whole_phi, _) = with_integrals_of(&model.f, &model.g, dt, integral);
    let mut ahead = DMatrix::<f64>::identity(model.f.nrows() + q, model.f.nrows() + q);
    (0..common).for_each(|_| ahead = &whole_phi * &ahead);
    let mut map = DMatrix::zeros(size, model.f.nrows() + q);
    map.rows_mut(0, motion).copy_from(&ahead.rows(0, motion));
    map.rows_mut(known, q).copy_from(&ahead.rows(model.f.nrows(), q));
    for (i, count) in reduced.layout.commands.iter().enumerate() {
        (1..=*count)
            .for_each(|back| map[(reduced.layout.command(i, back), model.layout.command(i, back))] = 1.0);
    }
    let past = reduced.layout.commands.iter().zip(plant.inputs()).flat_map(|(n, l)| vec![l.authority(); *n]);
    let mut scales: Vec<f64> = plant.scales().iter().copied().chain(past).collect();
    scales.extend(integral.iter().map(|&i| plant.scales()[i]));
    let loop_ = ReducedLoop { matrix: &phi - &gamma * &solution.gain, scales, registers: known - motion };
    Ok((solution.gain * map, loop_))
}
