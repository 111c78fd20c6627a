//! The linear form of a law near its target, and its closed loop.

use nalgebra::DMatrix;
use serde::Serialize;

use crate::margins::ReturnRatio;
use crate::sampled_plant::SampledPlant;

/// A linear feedback with memory, around the predicted state p:
/// `u = -gain p - memory_gain w`, `w+ = memory w + memory_input p`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LinearLaw {
    /// Gain on the predicted state, m x n.
    #[serde(serialize_with = "crate::rows::serialize")]
    pub gain: DMatrix<f64>,
    /// Gain on the memory, m x q; the first columns belong to the integrals of the error, the others to
    /// super-twisting.
    #[serde(serialize_with = "crate::rows::serialize")]
    pub memory_gain: DMatrix<f64>,
    /// Transition matrix of the memory, q x q.
    #[serde(serialize_with = "crate::rows::serialize")]
    pub memory: DMatrix<f64>,
    /// Input matrix of the memory, q x n.
    #[serde(serialize_with = "crate::rows::serialize")]
    pub memory_input: DMatrix<f64>,
}

impl LinearLaw {
    /// The closed loop without its delay, in the states `[p; w]`.
    pub fn undelayed(&self, plant: &SampledPlant) -> DMatrix<f64> {
        let (n, q) = (plant.size(), self.memory.nrows());
        let mut m = DMatrix::zeros(n + q, n + q);
        m.view_mut((0, 0), (n, n)).copy_from(&(plant.transition() - plant.drive() * &self.gain));
        m.view_mut((0, n), (n, q)).copy_from(&-(plant.drive() * &self.memory_gain));
        m.view_mut((n, 0), (q, n)).copy_from(&self.memory_input);
        m.view_mut((n, n), (q, q)).copy_from(&self.memory);
        m
    }

    /// The closed loop with its delay, in the states `[x; u; w]`: plant, command in force, memory of the law.
    pub fn closed_loop(&self, plant: &SampledPlant) -> DMatrix<f64> {
        let (n, m, q) = (plant.size(), plant.input_count(), self.memory.nrows());
        let mut predict = DMatrix::zeros(n, n + m + q);
        predict.view_mut((0, 0), (n, n)).copy_from(plant.transition());
        predict.view_mut((0, n), (n, m)).copy_from(plant.drive());
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

    /// Return ratio of the loop opened where the commands enter the plant; the law continues to predict with
    /// its own commands, and stores those.
    pub fn return_ratio(&self, plant: &SampledPlant) -> ReturnRatio {
        let (n, m, q) = (plant.size(), plant.input_count(), self.memory.nrows());
        let (own, known) = (plant.own_count(), plant.size() - plant.own_count());
        // States: those of the plant, the acting u, the past commands known to the law, the u that it
        // assumes, w.
        let believed = n + m + known;
        let size = believed + m + q;
        let (phi, gamma) = (plant.transition(), plant.drive());
        let mut predict = DMatrix::zeros(n, size);
        predict.columns_mut(0, own).copy_from(&phi.columns(0, own));
        predict.columns_mut(n + m, known).copy_from(&phi.columns(own, known));
        predict.columns_mut(believed, m).copy_from(gamma);
        let mut command = -(&self.gain * &predict);
        let mut tail = command.view_mut((0, believed + m), (m, q));
        tail -= &self.memory_gain;
        let mut a = DMatrix::zeros(size, size);
        a.view_mut((0, 0), (n, n)).copy_from(phi);
        a.view_mut((0, n), (n, m)).copy_from(gamma);
        a.rows_mut(n + m, known).copy_from(&predict.rows(own, known));
        a.rows_mut(believed, m).copy_from(&command);
        a.rows_mut(believed + m, q).copy_from(&(&self.memory_input * &predict));
        let mut w_w = a.view_mut((believed + m, believed + m), (q, q));
        w_w += &self.memory;
        let mut b = DMatrix::zeros(size, m);
        b.view_mut((n, 0), (m, m)).fill_with_identity();
        let ratio = ReturnRatio { a, b, c: -command, period_s: plant.period_s() };
        if plant.delayed().is_some() { ratio.compressed() } else { ratio }
    }
}
