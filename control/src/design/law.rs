//! The three laws, each brought to one linear form.

use nalgebra::DMatrix;
use serde::Serialize;

use super::report::pole;
use super::{DesignError, resolve};
use crate::lqr::sampled_cost;
use crate::margins::ReturnRatio;
use crate::options::{LqrOptions, PpcOptions, SmcOptions};
use crate::place::place;
use crate::riccati::dare;
use crate::sampled_plant::SampledPlant;
use crate::smc::{Shaping, Surface};

/// A linear feedback with memory, around the predicted state p:
/// `u = -gain p - memory_gain w`, `w+ = memory w + memory_input p`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LinearLaw {
    /// m x n.
    #[serde(serialize_with = "crate::rows::serialize")]
    pub gain: DMatrix<f64>,
    /// m x q; the first columns belong to the integrals of the error, the others to super-twisting.
    #[serde(serialize_with = "crate::rows::serialize")]
    pub memory_gain: DMatrix<f64>,
    /// q x q.
    #[serde(serialize_with = "crate::rows::serialize")]
    pub memory: DMatrix<f64>,
    /// q x n.
    #[serde(serialize_with = "crate::rows::serialize")]
    pub memory_input: DMatrix<f64>,
}

/// How the surface is reached and held.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Switching {
    /// `s+ = (1 - rate T) s - gain T sat(s / layer)` (Gao, Wang and Homaifa 1995).
    ConstantPlusProportional {
        /// Exponential rate, 1/s.
        rate: f64,
        /// Switching gain, input units, one per surface.
        gain: Vec<f64>,
        /// Half-width of the boundary layer, input units times s.
        layer: Vec<f64>,
    },
    /// `s+ = s - T k1 s / sqrt(max(|s|, layer)) + T v`, `v+ = v - T k2 sat(s / layer)` (Levant 1993, with a layer).
    SuperTwisting {
        /// k1, per surface.
        k1: Vec<f64>,
        /// k2, per surface.
        k2: Vec<f64>,
        /// Half-width of the boundary layer, input units times s.
        layer: Vec<f64>,
    },
}

/// The surface `s = surface [p; w]`, p the predicted state and w the integrals of the error, and its law.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SlidingLaw {
    /// m x (n + integrals), scaled so that an input moves its surface as it would an integrator.
    #[serde(serialize_with = "crate::rows::serialize")]
    pub surface: DMatrix<f64>,
    /// Equivalent control, m x (n + integrals).
    #[serde(serialize_with = "crate::rows::serialize")]
    pub equivalent: DMatrix<f64>,
    /// Poles of the motion on the surface, discrete, `[re, im]`.
    pub surface_poles: Vec<[f64; 2]>,
    /// Reaching and holding.
    pub switching: Switching,
    /// The reaching condition, in words and figures.
    pub reaching: String,
    /// Largest matched disturbance, in input units, against which the layer is reached and held; per input.
    pub matched_disturbance: Vec<f64>,
}

/// The plant with integrals of the error of some states: `w+ = w + T p_i`.
fn with_integrals(plant: &SampledPlant, integral: &[usize]) -> (DMatrix<f64>, DMatrix<f64>) {
    let (n, m, q) = (plant.state_count(), plant.input_count(), integral.len());
    let mut phi = DMatrix::identity(n + q, n + q);
    phi.view_mut((0, 0), (n, n)).copy_from(plant.phi());
    let mut gamma = DMatrix::zeros(n + q, m);
    gamma.view_mut((0, 0), (n, m)).copy_from(plant.gamma());
    for (row, &i) in integral.iter().enumerate() {
        phi[(n + row, i)] = plant.period_s();
    }
    (phi, gamma)
}

fn integral_input(plant: &SampledPlant, integral: &[usize]) -> DMatrix<f64> {
    let mut g = DMatrix::zeros(integral.len(), plant.state_count());
    integral.iter().enumerate().for_each(|(row, &i)| g[(row, i)] = plant.period_s());
    g
}

/// Splits a gain on the states and their integrals.
fn split(plant: &SampledPlant, integral: &[usize], gain: &DMatrix<f64>) -> LinearLaw {
    let (n, q) = (plant.state_count(), integral.len());
    LinearLaw {
        gain: gain.columns(0, n).into_owned(),
        memory_gain: gain.columns(n, q).into_owned(),
        memory: DMatrix::identity(q, q),
        memory_input: integral_input(plant, integral),
    }
}

/// Linear-quadratic regulator for the sampled continuous cost.
pub fn lqr(plant: &SampledPlant, o: &LqrOptions, integral: &[usize]) -> Result<LinearLaw, DesignError> {
    let (n, m, dt) = (plant.state_count(), plant.input_count(), plant.period_s());
    let q = resolve::weights("q", o.q.as_ref(), plant.state_names(), resolve::bryson(plant, 0.01), true)?;
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
    let diagonal = |v: &[f64]| DMatrix::from_diagonal(&nalgebra::DVector::from_column_slice(v));
    let cost = sampled_cost(plant.a(), plant.b(), &diagonal(&q), &diagonal(&r), dt)?;
    let (phi, gamma) = with_integrals(plant, integral);
    let size = n + integral.len();
    let mut qd = DMatrix::zeros(size, size);
    qd.view_mut((0, 0), (n, n)).copy_from(&cost.q);
    integral_q.iter().enumerate().for_each(|(k, v)| qd[(n + k, n + k)] = v * dt);
    let mut sd = DMatrix::zeros(size, m);
    sd.view_mut((0, 0), (n, m)).copy_from(&cost.s);
    let solution = dare(&phi, &gamma, &qd, &cost.r, Some(&sd))?;
    Ok(split(plant, integral, &solution.gain))
}

/// Robust pole placement.
pub fn ppc(plant: &SampledPlant, o: &PpcOptions, integral: &[usize]) -> Result<LinearLaw, DesignError> {
    let (phi, gamma) = with_integrals(plant, integral);
    let poles: Vec<_> = match &o.poles {
        Some(list) => {
            if o.bandwidth.is_some() || o.damping.is_some() {
                let second = if o.bandwidth.is_some() { "bandwidth" } else { "damping" };
                return Err(DesignError::Conflict { first: "poles", second });
            }
            list.iter().map(|p| pole(*p, plant.period_s())).collect()
        }
        None => {
            let bandwidth = resolve::positive("bandwidth", o.bandwidth, resolve::bandwidth(plant)?)?;
            let damping = resolve::positive("damping", o.damping, 0.8)?.min(1.0);
            let poles = resolve::default_poles(plant, bandwidth, damping, integral.len())?;
            poles.iter().map(|p| (p * plant.period_s()).exp()).collect()
        }
    };
    // Eigenvectors are as orthogonal as their units: radians and metres are made comparable first.
    let (state, input) = scaling(plant, integral);
    let scaled_phi = DMatrix::from_fn(phi.nrows(), phi.ncols(), |i, j| phi[(i, j)] * state[j] / state[i]);
    let scaled_gamma = DMatrix::from_fn(phi.nrows(), input.len(), |i, j| gamma[(i, j)] * input[j] / state[i]);
    let placed = place(&scaled_phi, &scaled_gamma, &poles)?;
    let gain = DMatrix::from_fn(input.len(), phi.nrows(), |i, j| placed.gain[(i, j)] * input[i] / state[j]);
    Ok(split(plant, integral, &gain))
}

/// Sizes of the states with their integrals (over one second), and of the inputs.
fn scaling(plant: &SampledPlant, integral: &[usize]) -> (Vec<f64>, Vec<f64>) {
    let mut state = plant.scales().to_vec();
    state.extend(integral.iter().map(|&i| plant.scales()[i]));
    (state, plant.inputs().iter().map(|i| i.authority()).collect())
}

/// What shapes the sliding surface: the poles on it, or the cost along it.
fn shaping(plant: &SampledPlant, o: &SmcOptions, integral: &[usize]) -> Result<Shaping, DesignError> {
    let (n, m, dt) = (plant.state_count(), plant.input_count(), plant.period_s());
    match (&o.poles, &o.q) {
        (Some(_), Some(_)) => Err(DesignError::Conflict { first: "poles", second: "q" }),
        (Some(poles), None) => {
            let wanted = n + integral.len() - m.min(n);
            if poles.len() != wanted {
                return Err(DesignError::Count { option: "poles", got: poles.len(), wanted });
            }
            Ok(Shaping::Poles(poles.iter().map(|p| pole(*p, dt)).collect()))
        }
        (None, q) => {
            let mut q =
                resolve::weights("q", q.as_ref(), plant.state_names(), resolve::bryson(plant, 0.1), true)?;
            let extra: Vec<f64> = integral.iter().map(|&i| 0.25 * q[i]).collect();
            q.extend(extra);
            Ok(Shaping::Cost(DMatrix::from_diagonal(&nalgebra::DVector::from_vec(q)) * dt))
        }
    }
}

/// Sliding mode with a surface by least cost or by poles.
pub fn smc(
    plant: &SampledPlant,
    o: &SmcOptions,
    integral: &[usize],
) -> Result<(LinearLaw, SlidingLaw), DesignError> {
    let dt = plant.period_s();
    let (phi, gamma) = with_integrals(plant, integral);
    let shaping = shaping(plant, o, integral)?;
    let surface = Surface::design(&phi, &gamma, dt, &shaping)?;
    let bandwidth = resolve::bandwidth(plant)?;
    let rate = resolve::positive("reaching_rate", o.reaching_rate, bandwidth)?;
    let authority = plant.inputs().iter().map(|i| 0.2 * i.authority()).collect();
    let names = plant.input_names();
    let gain = resolve::weights("switching_gain", o.switching_gain.as_ref(), names, authority, false)?;
    let layer_rate = (4.0 * bandwidth + rate).min(0.5 / dt);
    let narrow = gain.iter().map(|g| g / (layer_rate - rate).max(0.1 * layer_rate)).collect();
    let layer = resolve::weights("boundary_layer", o.boundary_layer.as_ref(), names, narrow, false)?;
    let c = &surface.c;
    let reaching = Reaching { gain: &gain, layer: &layer, rate };
    let (law, switching, reaching) = if o.super_twisting {
        super_twisting(plant, integral, &surface, &reaching)?
    } else {
        constant_plus_proportional(plant, integral, &surface, &reaching)?
    };
    let sliding = SlidingLaw {
        surface: c.clone(),
        equivalent: surface.equivalent.clone(),
        surface_poles: surface.poles.iter().map(|p| [p.re, p.im]).collect(),
        switching,
        reaching,
        matched_disturbance: gain,
    };
    Ok((law, sliding))
}

/// How the surface is reached, one value an input.
struct Reaching<'a> {
    gain: &'a [f64],
    layer: &'a [f64],
    rate: f64,
}

/// Second order: the law, its switching, and why the surface is reached.
fn super_twisting(
    plant: &SampledPlant,
    integral: &[usize],
    surface: &Surface,
    Reaching { gain, layer, .. }: &Reaching<'_>,
) -> Result<(LinearLaw, Switching, String), DesignError> {
    let dt = plant.period_s();
    let k1: Vec<f64> = gain.iter().map(|g| 1.5 * g.sqrt()).collect();
    let k2: Vec<f64> = gain.iter().map(|g| 1.1 * g).collect();
    let mut total = surface.equivalent.clone();
    for i in 0..plant.input_count() {
        let slope = k1[i] / layer[i].sqrt();
        if slope * dt > 1.0 {
            return Err(DesignError::Reaching {
                why: format!(
                    "k1 T / sqrt(layer) = {:.3} at {} is above one, so the surface would be overshot within a period; \
                     widen `boundary_layer` or lower `switching_gain`",
                    slope * dt,
                    plant.input_names()[i]
                ),
            });
        }
        let row = total.row(i) + surface.c.row(i) * slope;
        total.set_row(i, &row);
    }
    let law = twisting_law(plant, integral, &total, &surface.c, &k2, layer);
    Ok((
        law,
        Switching::SuperTwisting { k1, k2, layer: layer.to_vec() },
        "second order: with k1 = 1.5 sqrt(g) and k2 = 1.1 g, s and its rate reach zero in finite time against \
         matched disturbances that change by less than g per second (Levant 1993)"
            .to_owned(),
    ))
}

/// First order with a boundary layer: the law, its switching, and why the surface is reached.
fn constant_plus_proportional(
    plant: &SampledPlant,
    integral: &[usize],
    surface: &Surface,
    Reaching { gain, layer, rate }: &Reaching<'_>,
) -> Result<(LinearLaw, Switching, String), DesignError> {
    let mut total = surface.equivalent.clone();
    let mut worst: f64 = 0.0;
    for i in 0..plant.input_count() {
        let slope = rate + gain[i] / layer[i];
        worst = worst.max(slope * plant.period_s());
        let row = total.row(i) + surface.c.row(i) * slope;
        total.set_row(i, &row);
    }
    if worst > 1.0 {
        return Err(DesignError::Reaching {
            why: format!(
                "(rate + gain / layer) T = {worst:.3} is above one, so the surface would be overshot within a period \
                 and the command would chatter; widen `boundary_layer` or lower `switching_gain`"
            ),
        });
    }
    Ok((
        split(plant, integral, &total),
        Switching::ConstantPlusProportional { rate: *rate, gain: gain.to_vec(), layer: layer.to_vec() },
        format!(
            "|s| falls in every period outside the boundary layer, without overshoot: (rate + gain / layer) T = \
             {worst:.4} <= 1, against any matched disturbance below the switching gain"
        ),
    ))
}

/// The super-twisting law within its layer: one more memory per surface, which the surface drives.
fn twisting_law(
    plant: &SampledPlant,
    integral: &[usize],
    total: &DMatrix<f64>,
    c: &DMatrix<f64>,
    k2: &[f64],
    layer: &[f64],
) -> LinearLaw {
    let (n, m, q, dt) = (plant.state_count(), plant.input_count(), integral.len(), plant.period_s());
    let mut memory = DMatrix::identity(q + m, q + m);
    let mut memory_input = DMatrix::zeros(q + m, n);
    memory_input.rows_mut(0, q).copy_from(&integral_input(plant, integral));
    for i in 0..m {
        let slope = -dt * k2[i] / layer[i];
        memory_input.set_row(q + i, &(c.row(i).columns(0, n) * slope));
        memory.view_mut((q + i, 0), (1, q)).copy_from(&(c.row(i).columns(n, q) * slope));
    }
    let mut memory_gain = DMatrix::zeros(m, q + m);
    memory_gain.columns_mut(0, q).copy_from(&total.columns(n, q));
    memory_gain.columns_mut(q, m).copy_from(&-DMatrix::<f64>::identity(m, m));
    LinearLaw { gain: total.columns(0, n).into_owned(), memory_gain, memory, memory_input }
}

impl LinearLaw {
    /// The closed loop without its delay, in the states `[p; w]`.
    pub fn undelayed(&self, plant: &SampledPlant) -> DMatrix<f64> {
        let (n, q) = (plant.state_count(), self.memory.nrows());
        let mut m = DMatrix::zeros(n + q, n + q);
        m.view_mut((0, 0), (n, n)).copy_from(&(plant.phi() - plant.gamma() * &self.gain));
        m.view_mut((0, n), (n, q)).copy_from(&-(plant.gamma() * &self.memory_gain));
        m.view_mut((n, 0), (q, n)).copy_from(&self.memory_input);
        m.view_mut((n, n), (q, q)).copy_from(&self.memory);
        m
    }

    /// The closed loop as it runs, in the states `[x; u; w]`: plant, command in force, memory of the law.
    pub fn closed_loop(&self, plant: &SampledPlant) -> DMatrix<f64> {
        let (n, m, q) = (plant.state_count(), plant.input_count(), self.memory.nrows());
        let mut predict = DMatrix::zeros(n, n + m + q);
        predict.view_mut((0, 0), (n, n)).copy_from(plant.phi());
        predict.view_mut((0, n), (n, m)).copy_from(plant.gamma());
        let mut loop_ = DMatrix::zeros(n + m + q, n + m + q);
        loop_.rows_mut(0, n).copy_from(&predict);
        loop_.rows_mut(n, m).copy_from(&-(&self.gain * &predict));
        loop_.rows_mut(n + m, q).copy_from(&(&self.memory_input * &predict));
        let mut u_w = loop_.view_mut((n, n + m), (m, q));
        u_w -= &self.memory_gain;
        let mut w_w = loop_.view_mut((n + m, n + m), (q, q));
        w_w += &self.memory;
        loop_
    }

    /// The loop opened where the commands enter the plant; the law goes on predicting with its own commands.
    pub fn return_ratio(&self, plant: &SampledPlant) -> ReturnRatio {
        let (n, m, q) = (plant.state_count(), plant.input_count(), self.memory.nrows());
        // States: x, u that acts, u that the law believes in, w.
        let size = n + 2 * m + q;
        let mut predict = DMatrix::zeros(n, size);
        predict.view_mut((0, 0), (n, n)).copy_from(plant.phi());
        predict.view_mut((0, n + m), (n, m)).copy_from(plant.gamma());
        let mut command = -(&self.gain * &predict);
        let mut tail = command.view_mut((0, n + 2 * m), (m, q));
        tail -= &self.memory_gain;
        let mut a = DMatrix::zeros(size, size);
        a.view_mut((0, 0), (n, n)).copy_from(plant.phi());
        a.view_mut((0, n), (n, m)).copy_from(plant.gamma());
        a.rows_mut(n + m, m).copy_from(&command);
        a.rows_mut(n + 2 * m, q).copy_from(&(&self.memory_input * &predict));
        let mut w_w = a.view_mut((n + 2 * m, n + 2 * m), (q, q));
        w_w += &self.memory;
        let mut b = DMatrix::zeros(size, m);
        b.view_mut((n, 0), (m, m)).fill_with_identity();
        ReturnRatio { a, b, c: -command, period_s: plant.period_s() }
    }
}
