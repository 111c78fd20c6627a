//! One step of the covariance: prediction, then sequential measurement updates in Joseph form.

use nalgebra::DMatrix;

use super::filter_model::FilterModel;
use super::flow::Flow;
use crate::kernel::{Block, Packed, add_scaled, blocks, dot};

/// Results of a covariance step: gain, whitening of the innovations, standard deviations and covariance.
#[derive(Debug, Clone)]
pub struct Gains {
    /// Bit mask of the measurements that these gains use.
    pub mask: u64,
    /// Kalman gain, states x outputs.
    pub gain: Packed,
    /// Whitening matrix, outputs x outputs, which transforms innovations to independent ones of unit
    /// variance.
    pub whitening: Packed,
    /// Standard deviations of the states after the measurements.
    pub std: Vec<f64>,
    /// Covariance after the measurements.
    pub p: Packed,
}

impl Gains {
    /// Zero gains, with the covariance `p`.
    pub fn none(p: &DMatrix<f64>, outputs: usize) -> Self {
        Self {
            mask: 0,
            gain: Packed::zeros(p.nrows(), outputs),
            whitening: Packed::zeros(outputs, outputs),
            std: p.diagonal().iter().map(|v| v.sqrt()).collect(),
            p: Packed::new(p),
        }
    }
}

/// Covariance of the estimate, with its model.
#[derive(Debug, Clone)]
pub struct Covariance {
    n: usize,
    outputs: usize,
    f: Packed,
    /// Rows of F, stored as columns.
    f_rows: Packed,
    q: Packed,
    /// Rows of H, stored as columns.
    h_rows: Packed,
    variance: Vec<f64>,
    p: Packed,
    product: Packed,
    /// Work vectors: P h; then the gain `k` of one measurement, and the correction `w` of the Joseph form.
    v: Vec<Block>,
    k: Vec<Block>,
    w: Vec<Block>,
}

impl Covariance {
    /// Starts with the covariance `p` of the model's states.
    pub fn new(model: &FilterModel, p: &DMatrix<f64>) -> Self {
        let n = p.nrows();
        let column = || vec![[0.0; 4]; blocks(n)];
        Self {
            n,
            outputs: model.h.nrows(),
            f: Packed::new(&model.f),
            f_rows: Packed::new(&model.f.transpose()),
            q: Packed::new(&model.q),
            h_rows: Packed::new(&model.h.transpose()),
            variance: model.variance.clone(),
            p: Packed::new(p),
            product: Packed::zeros(n, n),
            v: column(),
            k: column(),
            w: column(),
        }
    }

    /// The current covariance.
    pub fn p(&self) -> &Packed {
        &self.p
    }

    /// Sets the covariance.
    pub fn set(&mut self, p: &Packed) {
        self.p.copy_from(p);
    }

    /// Propagates the covariance over all steps of the map.
    pub fn flow_on(&mut self, flow: &mut Flow) {
        flow.apply(&mut self.p);
    }

    /// Largest change of an entry since `before`, relative to the product of its two standard deviations.
    pub fn change_from(&self, before: &Packed) -> f64 {
        let mut largest: f64 = 0.0;
        for j in 0..self.n {
            for i in 0..=j {
                let change = (self.p.entry(i, j) - before.entry(i, j)).abs();
                if change != 0.0 {
                    let share = change / (self.p.entry(i, i) * self.p.entry(j, j)).sqrt();
                    largest = if share.is_nan() { f64::INFINITY } else { largest.max(share) };
                }
            }
        }
        largest
    }

    /// Predicts the covariance: P becomes F P F' + Q.
    pub fn predict(&mut self) {
        self.product.clear();
        self.product.add_product(&self.f, &self.p, self.n);
        self.p.copy_from(&self.q);
        self.p.add_product(&self.product, &self.f_rows, self.n);
    }

    /// Adds the covariance of random state changes: for each vector of `pushes`, that vector times an
    /// independent random number of variance one.
    pub fn push(&mut self, pushes: &[f64]) {
        for push in pushes.chunks_exact(self.n) {
            self.v.as_flattened_mut()[..self.n].copy_from_slice(push);
            for (c, v) in push.iter().enumerate().filter(|(_, v)| **v != 0.0) {
                add_scaled(self.p.column_mut(c), &self.v, *v);
            }
        }
    }

    /// Updates the covariance by the measurements of `mask`, and computes the gains.
    pub fn update(&mut self, mask: u64, gains: &mut Gains) {
        self.update_beside(mask, &[], gains);
    }

    /// As [`Self::update`], with the variance of each measurement increased by its entry of `more`, where
    /// there is one.
    pub fn update_beside(&mut self, mask: u64, more: &[f64], gains: &mut Gains) {
        let n = self.n;
        gains.mask = mask;
        gains.gain.clear();
        gains.whitening.clear();
        for i in (0..self.outputs).filter(|i| mask >> i & 1 == 1) {
            let h = self.h_rows.column(i);
            self.v.fill([0.0; 4]);
            self.p.add(&mut self.v, h.as_flattened());
            let variance = self.variance[i] + more.get(i).copied().unwrap_or(0.0);
            let s = variance + dot(h, &self.v);
            let (inverse, root) = (1.0 / s, 1.0 / s.sqrt());
            self.k.fill([0.0; 4]);
            add_scaled(&mut self.k, &self.v, inverse);
            // The innovation after the previous measurements: row i of (I - H K).
            for j in (0..=i).filter(|j| mask >> j & 1 == 1) {
                let own = if i == j { 1.0 } else { 0.0 };
                let left = own - dot(h, gains.gain.column(j));
                add_scaled(gains.gain.column_mut(j), &self.k, left);
                gains.whitening.set(i, j, left * root);
            }
            // T = (I - k h) P, then P = T (I - k h)' + r k k' = T - (T h' - r k) k'.
            for (c, v) in self.v.as_flattened().iter().enumerate().take(n) {
                add_scaled(self.p.column_mut(c), &self.k, -v);
            }
            self.w.fill([0.0; 4]);
            self.p.add(&mut self.w, h.as_flattened());
            add_scaled(&mut self.w, &self.k, -variance);
            for (c, k) in self.k.as_flattened().iter().enumerate().take(n) {
                add_scaled(self.p.column_mut(c), &self.w, -k);
            }
        }
        self.p.symmetrise(n);
        gains.p.copy_from(&self.p);
        for (r, std) in gains.std.iter_mut().enumerate() {
            *std = self.p.entry(r, r).max(0.0).sqrt();
        }
    }
}
