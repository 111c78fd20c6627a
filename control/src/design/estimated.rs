//! The loop as it is flown: the law with the filter's estimate in the loop.
//!
//! A regulator on the measured state has margins that one on an estimate does not have (Doyle, "Guaranteed
//! margins for LQG regulators", IEEE Trans. Autom. Control 23, 1978), so the margins with the filter are
//! reported besides those of the law alone.

use nalgebra::DMatrix;
use serde::Serialize;
use thiserror::Error;
use whirlstand_linalg::{DecompositionError, eigenvalues};
use whirlstand_vehicle::{DiscretiseError, LinearModel};

use super::linear_law::LinearLaw;
use super::report::{Pole, round_delays};
use crate::kalman::{Estimator, FilterModel};
use crate::margins::{LoopMargins, MultivariableMargins, ReturnRatio};
use crate::riccati::{RiccatiError, dare};
use crate::sampled_model::SampledModel;
use crate::sampled_plant::SampledPlant;

/// Largest number of filter states for which the settled gain is computed.
const MOST_STATES: usize = 150;

/// Figures of the loop with its filter at its settled gain.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EstimatedLoop {
    /// Poles of the filter; where its model equals the vehicle, the loop's poles are these and the law's.
    pub estimator_poles: Vec<Pole>,
    /// Largest magnitude of a pole of the whole loop.
    pub spectral_radius: f64,
    /// Margins at each input, the other loops closed.
    pub loop_margins: Vec<LoopMargins>,
    /// Margins at all inputs at once.
    pub multivariable_margins: MultivariableMargins,
    /// Poles of the whole loop with the actual vehicle.
    #[serde(skip)]
    pub poles: Vec<Pole>,
    #[serde(skip)]
    ratio: ReturnRatio,
}

/// Figures of the loop with its filter, if they exist.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum LoopFigures {
    /// The figures.
    Known(Box<EstimatedLoop>),
    /// The figures cannot be computed.
    Absent {
        /// Reason, as a sentence.
        why: String,
    },
}

/// Reason why the figures of the loop with its filter cannot be computed.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum EstimatedLoopError {
    /// The filter has too many states.
    #[error("the filter has {states} states; up to {MOST_STATES} its settled gain is computed")]
    Size {
        /// Number of states.
        states: usize,
    },
    /// The gain does not converge.
    #[error("the filter has no settled gain: {0}")]
    Riccati(#[from] RiccatiError),
    /// An unstable mode of the plant is too fast for the period.
    #[error(transparent)]
    Discretise(#[from] DiscretiseError),
    /// An eigenvalue iteration failed.
    #[error(transparent)]
    Decomposition(#[from] DecompositionError),
}

impl EstimatedLoop {
    /// The loop of a law with `estimator`, around the vehicle that `linear` describes, which delivers output
    /// i every `every[i]` steps: a slower output is modelled as proportionally noisier.
    ///
    /// # Errors
    /// [`EstimatedLoopError`].
    pub fn new(
        plant: &SampledPlant,
        law: &LinearLaw,
        estimator: &Estimator,
        linear: &LinearModel,
        every: &[u32],
    ) -> Result<Self, EstimatedLoopError> {
        let model = estimator.filter().model();
        if model.f.nrows() > MOST_STATES {
            return Err(EstimatedLoopError::Size { states: model.f.nrows() });
        }
        let gain = settled_gain(model, estimator.used(), every)?;
        let vehicle = SampledModel::new(linear, plant.period_s())?;
        let ratio = ratio((plant, law), model, &gain, &vehicle);
        let period = plant.period_s();
        let filter = &model.f - &model.f * &gain * &model.h;
        let mut poles = eigenvalues(&filter)?;
        let registers: usize = vehicle.layout.outputs.iter().sum();
        round_delays(&mut poles, registers);
        // The closed return ratio is the loop: its poles show whether it is stable, whatever model the filter
        // has.
        let closed = &ratio.a - &ratio.b * &ratio.c;
        let all = eigenvalues(&closed)?;
        let spectral_radius = all.iter().map(|p| p.norm()).fold(0.0, f64::max);
        let ratio = ratio.compressed();
        Ok(Self {
            estimator_poles: poles.iter().map(|p| Pole::discrete(*p, period)).collect(),
            spectral_radius,
            loop_margins: (0..ratio.inputs()).map(|i| ratio.loop_margins(i)).collect(),
            multivariable_margins: ratio.multivariable()?,
            poles: all.iter().map(|p| Pole::discrete(*p, period)).collect(),
            ratio,
        })
    }

    /// Greatest singular value of the sensitivity at each frequency, rad/s.
    ///
    /// # Errors
    /// [`DecompositionError`] when singular values do not converge.
    pub fn sensitivity(&self, frequencies: &[f64]) -> Result<Vec<f64>, DecompositionError> {
        frequencies.iter().map(|w| Ok(1.0 / self.ratio.smallest_difference(*w)?)).collect()
    }
}

/// Settled correction gain of the filter, n x p; zero at outputs that are not used.
fn settled_gain(model: &FilterModel, used: u64, every: &[u32]) -> Result<DMatrix<f64>, RiccatiError> {
    let p = model.h.nrows();
    let rows: Vec<usize> = (0..p).filter(|i| used >> i & 1 == 1).collect();
    let h = model.h.select_rows(&rows);
    let r = DMatrix::from_fn(rows.len(), rows.len(), |i, j| match i == j {
        true => model.variance[rows[i]] * f64::from(every.get(rows[i]).copied().unwrap_or(1)),
        false => 0.0,
    });
    let q = (&model.q + model.q.transpose()) * 0.5;
    let x = dare(&model.f.transpose(), &h.transpose(), &q, &r, None)?.x;
    let innovation = &h * &x * h.transpose() + r;
    let gain = innovation.lu().solve(&(&h * &x)).ok_or(RiccatiError::SingularInputWeight)?.transpose();
    let mut all = DMatrix::zeros(model.f.nrows(), p);
    rows.iter().enumerate().for_each(|(k, &i)| all.set_column(i, &gain.column(k)));
    Ok(all)
}

/// Return ratio of the loop opened where the commands enter the vehicle. States: the vehicle's with its
/// sensors, the command in force, the filter's prediction, the commands known to filter and law, the command
/// that they assume, the law's memory.
fn ratio(
    (plant, law): (&SampledPlant, &LinearLaw),
    model: &FilterModel,
    gain: &DMatrix<f64>,
    vehicle: &SampledModel,
) -> ReturnRatio {
    let (own, m, q) = (plant.own_count(), plant.input_count(), law.memory.nrows());
    let (nv, nf, known) = (vehicle.f.nrows(), model.f.nrows(), plant.size() - own);
    let at = [0, nv, nv + m, nv + m + nf, nv + m + nf + known, nv + 2 * m + nf + known];
    let size = at[5] + q;
    let unit = |from: usize, count: usize| {
        let mut rows = DMatrix::zeros(count, size);
        rows.columns_mut(from, count).fill_with_identity();
        rows
    };
    let (seen, acting, predicted) = (unit(at[0], nv), unit(at[1], m), unit(at[2], nf));
    let (past, command, memory) = (unit(at[3], known), unit(at[4], m), unit(at[5], q));
    // Inputs of the filter: the commands, and the known states where its model contains them.
    let stack = |parts: &[&DMatrix<f64>]| {
        let mut rows = DMatrix::zeros(parts.iter().map(|p| p.nrows()).sum(), size);
        let mut from = 0;
        for part in parts {
            rows.rows_mut(from, part.nrows()).copy_from(*part);
            from += part.nrows();
        }
        rows
    };
    let inputs = if model.g.ncols() > m { stack(&[&command, &past]) } else { command.clone() };
    let y = &vehicle.h * &seen + &vehicle.d * &acting;
    let innovation = y - &model.h * &predicted - &model.d * &inputs;
    let corrected = &predicted + gain * innovation;
    let state = stack(&[&corrected.rows(0, own).into_owned(), &past]);
    let ahead = plant.transition() * &state + plant.drive() * &command;
    let next = -(&law.gain * &ahead) - &law.memory_gain * &memory;
    let a = stack(&[
        &(&vehicle.f * &seen + &vehicle.g * &acting),
        &DMatrix::zeros(m, size),
        &(&model.f * &corrected + &model.g * &inputs),
        &ahead.rows(own, known).into_owned(),
        &next,
        &(&law.memory_input * &ahead + &law.memory * &memory),
    ]);
    let mut b = DMatrix::zeros(size, m);
    b.view_mut((at[1], 0), (m, m)).fill_with_identity();
    ReturnRatio { a, b, c: -next, period_s: plant.period_s() }
}
