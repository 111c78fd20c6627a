//! The score test: how much of a residual a signature could explain once all nuisances had their share.

use crate::data::record::Data;
use crate::model::fit::dot;
use crate::model::noise::Noise;

/// A residual under one noise model, with what nuisances explain projected out.
#[derive(Debug, Clone)]
pub struct ScoreTest<'d> {
    data: &'d Data,
    noise: Noise,
    /// Orthonormal basis of the whitened nuisances.
    basis: Vec<Vec<f64>>,
    /// The raw samples that whiten to that basis.
    raw: Vec<Vec<f64>>,
    /// Whitened residual without its part in that basis.
    residual: Vec<f64>,
}

/// What a signature could explain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Score {
    /// By how much it fits best.
    pub amplitude: f64,
    /// Reduction of the whitened sum of squares: the score statistic.
    pub score: f64,
    /// Squared norm of the whitened, projected signature.
    pub energy: f64,
}

impl<'d> ScoreTest<'d> {
    /// `residual` is filled; `nuisances` are raw columns.
    pub fn new(data: &'d Data, noise: &Noise, residual: &[f64], nuisances: &[impl AsRef<Vec<f64>>]) -> Self {
        let (mut basis, mut raw): (Vec<Vec<f64>>, Vec<Vec<f64>>) = (Vec::new(), Vec::new());
        for column in nuisances {
            let mut filled = column.as_ref().clone();
            data.fill(&mut filled);
            let mut w = noise.whiten(data, &filled);
            let before = dot(&w, &w);
            // Twice is enough (Kahan and Parlett).
            for _ in 0..2 {
                for (b, r) in basis.iter().zip(&raw) {
                    let c = dot(b, &w);
                    subtract(&mut w, c, b);
                    subtract(&mut filled, c, r);
                }
            }
            let after = dot(&w, &w);
            if after > 1e-10 * before && after > 0.0 {
                let scale = 1.0 / after.sqrt();
                w.iter_mut().chain(&mut filled).for_each(|w| *w *= scale);
                basis.push(w);
                raw.push(filled);
            }
        }
        let mut score_test = Self { data, noise: noise.clone(), basis, raw, residual: Vec::new() };
        score_test.residual = score_test.project(residual);
        score_test
    }

    /// Whitens (raw samples, filled) and projects.
    pub fn project(&self, samples: &[f64]) -> Vec<f64> {
        let mut w = self.noise.whiten(self.data, samples);
        for b in &self.basis {
            let c = dot(b, &w);
            subtract(&mut w, c, b);
        }
        w
    }

    /// Raw samples (filled) without what the nuisances explain of them in this score test.
    pub fn without_nuisances(&self, samples: &[f64]) -> Vec<f64> {
        let w = self.noise.whiten(self.data, samples);
        let mut rest = samples.to_vec();
        for (b, r) in self.basis.iter().zip(&self.raw) {
            subtract(&mut rest, dot(b, &w), r);
        }
        rest
    }

    /// The record.
    pub fn data(&self) -> &'d Data {
        self.data
    }

    /// The noise model.
    pub fn noise(&self) -> &Noise {
        &self.noise
    }

    /// The basis of the whitened nuisances.
    pub fn basis(&self) -> &[Vec<f64>] {
        &self.basis
    }

    /// As [`ScoreTest::project`] for samples that may have gaps.
    pub fn signature(&self, samples: &[f64]) -> Vec<f64> {
        self.project(&self.data.filled(samples))
    }

    /// Product of a whitened signature with the residual, and its energy, both beside the nuisances: without taking them
    /// off, as the residual has no part in them.
    fn product(&self, samples: &[f64]) -> (f64, f64) {
        let w = self.noise.whiten(self.data, &self.data.filled(samples));
        let whole = dot(&w, &w);
        let nuisances: f64 = self.basis.iter().map(|b| dot(b, &w).powi(2)).sum();
        let energy = whole - nuisances;
        // Less than rounding leaves is nothing.
        (dot(&w, &self.residual), if energy > 1e-9 * whole { energy } else { 0.0 })
    }

    /// The score of a raw signature.
    pub fn score(&self, samples: &[f64]) -> Score {
        let (product, energy) = self.product(samples);
        if energy.is_nan() || energy <= 0.0 {
            return Score { amplitude: 0.0, score: 0.0, energy: 0.0 };
        }
        Score { amplitude: product / energy, score: product * product / energy, energy }
    }

    /// The score of a raw signature that has one size only: it is taken whole or not at all, and may do harm.
    pub fn whole(&self, samples: &[f64]) -> f64 {
        let (product, energy) = self.product(samples);
        2.0 * product - energy
    }

    /// The whitened, projected residual.
    pub fn residual(&self) -> &[f64] {
        &self.residual
    }
}

/// a - c b, in place.
fn subtract(a: &mut [f64], c: f64, b: &[f64]) {
    a.iter_mut().zip(b).for_each(|(a, b)| *a -= c * b);
}

/// Cosine of the angle between two projected signatures.
pub fn cosine(a: &[f64], b: &[f64]) -> f64 {
    let scale = (dot(a, a) * dot(b, b)).sqrt();
    if scale > 0.0 { dot(a, b) / scale } else { 0.0 }
}
