//! The plant as a design sees it: with integrals, and with late inputs as far ahead as they reach.

use nalgebra::DMatrix;

use super::ahead::{Lookahead, to_the_latest};
use super::linear_law::LinearLaw;
use crate::sampled_model::SampledModel;
use crate::sampled_plant::SampledPlant;

/// A closed loop on the state that a late input can still change.
pub struct ReducedLoop {
    /// Its transition.
    pub matrix: DMatrix<f64>,
    /// Sizes of its states.
    pub scales: Vec<f64>,
    /// How many of its states are past commands.
    pub registers: usize,
}

impl ReducedLoop {
    /// The transition in states measured by their sizes.
    pub fn scaled(&self) -> DMatrix<f64> {
        let s = &self.scales;
        DMatrix::from_fn(s.len(), s.len(), |i, j| self.matrix[(i, j)] * s[j] / s[i])
    }
}

/// The plant with integrals of the error of some states: `w+ = w + T p_i`.
pub fn with_integrals(plant: &SampledPlant, integral: &[usize]) -> (DMatrix<f64>, DMatrix<f64>) {
    with_integrals_of(plant.phi(), plant.gamma(), plant.period_s(), integral)
}

/// The same for any sampled plant.
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

/// The plant that pole placement and sliding mode are designed for: without delay, its state ahead of that of the vehicle.
pub struct Reduced {
    /// Its transition.
    pub phi: DMatrix<f64>,
    /// Its input matrix.
    pub gamma: DMatrix<f64>,
    ahead: Ahead,
}

/// How far ahead of the vehicle the state is that is fed back.
enum Ahead {
    /// No input is late.
    Nothing,
    /// As far as the latest input reaches, for all of them: `p = map [s; integrals]` ([`to_the_latest`]).
    Latest(DMatrix<f64>),
    /// For each input as far as it is late.
    Each(Lookahead),
}

impl Reduced {
    /// The plant with integrals, for a law that is not linear: all inputs look as far ahead as the latest reaches, over commands
    /// that are known, whatever the law will ask for.
    pub fn to_the_latest(plant: &SampledPlant, integral: &[usize]) -> Self {
        Self::new(plant, integral, |model, phi| {
            let (map, gamma) = to_the_latest(model, phi, integral.len());
            (gamma, Ahead::Latest(map))
        })
    }

    /// The plant with integrals, for a linear law: each input looks as far ahead as it is late.
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

    /// The loop that a feedback on the reduced state closes, with further states of the law behind it.
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

    /// A feedback on the reduced state as one on the states and integrals.
    pub fn whole(&self, feedback: &DMatrix<f64>) -> DMatrix<f64> {
        match &self.ahead {
            Ahead::Nothing => feedback.clone(),
            Ahead::Latest(map) => feedback * map,
            Ahead::Each(ahead) => ahead.whole(feedback),
        }
    }
}

/// What the integrals take of the states.
pub fn integral_input(plant: &SampledPlant, integral: &[usize]) -> DMatrix<f64> {
    let mut g = DMatrix::zeros(integral.len(), plant.size());
    integral.iter().enumerate().for_each(|(row, &i)| g[(row, i)] = plant.period_s());
    g
}

/// Splits a gain on the states and their integrals.
pub fn split(plant: &SampledPlant, integral: &[usize], gain: &DMatrix<f64>) -> LinearLaw {
    let (n, q) = (plant.size(), integral.len());
    LinearLaw {
        gain: gain.columns(0, n).into_owned(),
        memory_gain: gain.columns(n, q).into_owned(),
        memory: DMatrix::identity(q, q),
        memory_input: integral_input(plant, integral),
    }
}

/// Sizes of the states with their integrals (over one second), and of the inputs.
pub fn scaling(plant: &SampledPlant, integral: &[usize]) -> (Vec<f64>, Vec<f64>) {
    let mut state = plant.scales().to_vec();
    state.extend(integral.iter().map(|&i| plant.scales()[i]));
    (state, plant.inputs().iter().map(|i| i.authority()).collect())
}
