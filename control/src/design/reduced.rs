//! The plant of a design: with integrals, and with a prediction over the input delays.

use nalgebra::DMatrix;

use super::ahead::{Lookahead, to_the_latest};
use super::linear_law::LinearLaw;
use crate::sampled_model::SampledModel;
use crate::sampled_plant::SampledPlant;

/// A closed loop on the state that delayed inputs can still change.
pub struct ReducedLoop {
    /// Transition matrix.
    pub matrix: DMatrix<f64>,
    /// Scales of the states.
    pub scales: Vec<f64>,
    /// Number of states that are past commands.
    pub registers: usize,
}

impl ReducedLoop {
    /// The transition matrix in states divided by their scales.
    pub fn scaled(&self) -> DMatrix<f64> {
        let s = &self.scales;
        DMatrix::from_fn(s.len(), s.len(), |i, j| self.matrix[(i, j)] * s[j] / s[i])
    }
}

/// The plant with integrals of the error of some states: `w+ = w + T p_i`.
pub fn with_integrals(plant: &SampledPlant, integral: &[usize]) -> (DMatrix<f64>, DMatrix<f64>) {
    with_integrals_of(plant.phi(), plant.gamma(), plant.period_s(), integral)
}

/// The plant with integrals, for any sampled plant.
pub fn with_integrals_of(
    transition: &DMatrix<f64>,
    drive: &DMatrix<f64>,
    period_s: f64,
    integral: &[usize],
) -> (DMatrix<f64>, DMatrix<f64>) {
    let (n, m, q) = (transition.nrows(), drive.ncols(), integral.len());
    let mut phi = DMatrix::identity(n + q, n + q);
    phi.view_mut((0, 0), (n, n)).copy_from(transition);
    let mut gamma = DMatrix::zeros(n + q, m);
    gamma.view_mut((0, 0), (n, m)).copy_from(drive);
    for (row, &i) in integral.iter().enumerate() {
        phi[(n + row, i)] = period_s;
    }
    (phi, gamma)
}

/// The plant of pole placement and sliding mode: without delay, with the predicted state in place of the
/// vehicle's.
pub struct Reduced {
    /// Transition matrix.
    pub phi: DMatrix<f64>,
    /// Input matrix.
    pub gamma: DMatrix<f64>,
    ahead: Ahead,
}

/// Prediction of the state that is fed back.
enum Ahead {
    /// No input is delayed.
    Nothing,
    /// Over the longest delay, for all inputs: `p = map [s; integrals]` ([`to_the_latest`]).
    Latest(DMatrix<f64>),
    /// Over each input's own delay.
    Each(Lookahead),
}

impl Reduced {
    /// The plant with integrals, for a nonlinear law: prediction over the longest delay for all inputs, from
    /// known commands, for any future demand of the law.
    pub fn to_the_latest(plant: &SampledPlant, integral: &[usize]) -> Self {
        Self::new(plant, integral, |model, phi| {
            let (map, gamma) = to_the_latest(model, phi, integral.len());
            (gamma, Ahead::Latest(map))
        })
    }

    /// The plant with integrals, for a linear law: prediction over each input's own delay.
    pub fn of_each(plant: &SampledPlant, integral: &[usize]) -> Self {
        Self::new(plant, integral, |model, phi| {
            let ahead = Lookahead::new(model, plant.delays_s(), plant.period_s(), phi, integral.len());
            (ahead.input.clone(), Ahead::Each(ahead))
        })
    }

    fn new(
        plant: &SampledPlant,
        integral: &[usize],
        reduce: impl FnOnce(&SampledModel, &DMatrix<f64>) -> (DMatrix<f64>, Ahead),
    ) -> Self {
        let (phi, gamma) = with_integrals(plant, integral);
        let (gamma, ahead) = match plant.delayed() {
            None => (gamma, Ahead::Nothing),
            Some(model) => reduce(model, &phi),
        };
        Self { phi, gamma, ahead }
    }

    /// The loop closed by a feedback on the reduced state, followed by further states of the law.
    pub fn closed(
        &self,
        plant: &SampledPlant,
        integral: &[usize],
        feedback: &DMatrix<f64>,
    ) -> Option<ReducedLoop> {
        if matches!(self.ahead, Ahead::Nothing) {
            return None;
        }
        Some(ReducedLoop {
            matrix: &self.phi - &self.gamma * feedback,
            scales: scaling(plant, integral).0,
            registers: 0,
        })
    }

    /// Converts a feedback on the reduced state to one on the states and integrals.
    pub fn whole(&self, feedback: &DMatrix<f64>) -> DMatrix<f64> {
        match &self.ahead {
            Ahead::Nothing => feedback.clone(),
            Ahead::Latest(map) => feedback * map,
            Ahead::Each(ahead) => ahead.whole(feedback),
        }
    }
}

/// Input matrix of the integrals from the states.
pub fn integral_input(plant: &SampledPlant, integral: &[usize]) -> DMatrix<f64> {
    let mut g = DMatrix::zeros(integral.len(), plant.size());
    integral.iter().enumerate().for_each(|(row, &i)| g[(row, i)] = plant.period_s());
    g
}

/// Splits a gain on the states and integrals into its two parts.
pub fn split(plant: &SampledPlant, integral: &[usize], gain: &DMatrix<f64>) -> LinearLaw {
    let (n, q) = (plant.size(), integral.len());
    LinearLaw {
        gain: gain.columns(0, n).into_owned(),
        memory_gain: gain.columns(n, q).into_owned(),
        memory: DMatrix::identity(q, q),
        memory_input: integral_input(plant, integral),
    }
}

/// Scales of the states with their integrals (over one second), and of the inputs.
pub fn scaling(plant: &SampledPlant, integral: &[usize]) -> (Vec<f64>, Vec<f64>) {
    let mut state = plant.scales().to_vec();
    state.extend(integral.iter().map(|&i| plant.scales()[i]));
    (state, plant.inputs().iter().map(|i| i.authority()).collect())
}
