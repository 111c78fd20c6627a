//! Score test: how much of a residual a signature could explain once all nuisance parameters are accounted
//! for.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use crate::data::record::Data;
use crate::model::columns::{Column, Sparse, dot, subtract_all};
use crate::model::noise::Noise;

/// A residual under one noise model, with the nuisances projected out.
#[derive(Debug, Clone)]
pub struct ScoreTest<'d> {
    data: &'d Data,
    noise: Noise,
    /// Orthonormal basis of the whitened nuisances.
    basis: Sparse,
    /// The nuisances of the basis, and their coefficients: one row per basis function.
    nuisances: Vec<Column>,
    shares: Vec<Vec<f64>>,
    /// Whitened residual without its component in that basis.
    residual: Vec<f64>,
}

/// Result of a score test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Score {
    /// Amplitude of the best fit.
    pub amplitude: f64,
    /// Reduction of the whitened sum of squares: the score statistic.
    pub score: f64,
    /// Squared norm of the whitened, projected signature.
    pub energy: f64,
}

/// The start of a candidate that scores best in a score test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScoredStart {
    /// Index of the start.
    pub start: usize,
    /// Index of the score test.
    pub score_test: usize,
    /// Its amplitude there.
    pub amplitude: f64,
    /// Its score there.
    pub score: f64,
}

impl<'d> ScoreTest<'d> {
    /// Prepares a test; `residual` is filled, `nuisances` are columns that are not whitened.
    pub fn new(data: &'d Data, noise: &Noise, residual: &[f64], nuisances: &[Column]) -> Self {
        let (mut basis, mut shares): (Sparse, Vec<Vec<f64>>) = (Sparse::default(), Vec::new());
        for (i, column) in nuisances.iter().enumerate() {
            let mut w = noise.whiten(data, &data.filled(column));
            let mut share = vec![0.0; nuisances.len()];
            share[i] = 1.0;
            let before = dot(&w, &w);
            // Orthogonalising twice is enough (Giraud, Langou and Rozloznik 2005).
            for _ in 0..2 {
                let by = basis.dots(&w);
                basis.subtract_from(&mut w, &by);
                for (c, other) in by.iter().zip(&shares) {
                    share.iter_mut().zip(other).for_each(|(s, o)| *s -= c * o);
                }
            }
            let after = dot(&w, &w);
            if after > 1e-10 * before && after > 0.0 {
                let scale = 1.0 / after.sqrt();
                w.iter_mut().chain(&mut share).for_each(|w| *w *= scale);
                basis.push(w);
                shares.push(share);
            }
        }
        let nuisances = nuisances.iter().map(Arc::clone).collect();
        let mut score_test =
            Self { data, noise: noise.clone(), basis, nuisances, shares, residual: Vec::new() };
        score_test.residual = score_test.project(residual);
        score_test
    }

    /// Whitens samples (filled) and projects out the nuisances.
    pub fn project(&self, samples: &[f64]) -> Vec<f64> {
        let mut w = self.noise.whiten(self.data, samples);
        let by = self.basis.dots(&w);
        self.basis.subtract_from(&mut w, &by);
        w
    }

    /// Samples (filled, not whitened) minus the part that the nuisances explain in this score test.
    pub fn without_nuisances(&self, samples: &[f64]) -> Vec<f64> {
        let w = self.noise.whiten(self.data, samples);
        let mut by = vec![0.0; self.nuisances.len()];
        for (c, share) in self.basis.dots(&w).iter().zip(&self.shares) {
            by.iter_mut().zip(share).for_each(|(b, s)| *b += c * s);
        }
        let mut rest = samples.to_vec();
        subtract_all(&mut rest, &by, &self.nuisances);
        // Filling is linear: the nuisances' values in samples that do not count are removed with it.
        self.data.fill(&mut rest);
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
        self.basis.columns()
    }

    /// Whitens and projects as [`ScoreTest::project`], for samples that may have gaps.
    pub fn signature(&self, samples: &[f64]) -> Vec<f64> {
        self.project(&self.data.filled(samples))
    }

    /// Inner products of signatures (filled, not whitened) with each other and with the residual, all after projection.
    /// The projection need not be carried out: the residual has no nuisance component, and what the signatures' nuisance
    /// components have in common follows from their coefficients.
    pub fn products<S: AsRef<[f64]>>(&self, signatures: &[S]) -> (DMatrix<f64>, DVector<f64>) {
        let white = signatures.iter().map(|samples| self.noise.whiten(self.data, samples.as_ref()));
        let white = Sparse::new(white.collect());
        let by: Vec<Vec<f64>> = white.columns().iter().map(|w| self.basis.dots(w)).collect();
        let mut products = white.products();
        for (i, of) in by.iter().enumerate() {
            let whole = products[(i, i)];
            for (j, other) in by.iter().enumerate() {
                products[(i, j)] -= dot(of, other);
            }
            // An energy below rounding counts as zero.
            if products[(i, i)] <= 1e-9 * whole {
                products[(i, i)] = 0.0;
            }
        }
        (products, DVector::from_vec(white.dots(&self.residual)))
    }

    /// Inner product of a signature, which may have gaps, with the residual, and its energy, as by
    /// [`ScoreTest::products`].
    fn product(&self, samples: &[f64]) -> (f64, f64) {
        let (energy, product) = self.products(&[self.data.filled(samples)]);
        (product[0], energy[(0, 0)])
    }

    /// The score of a signature that is not whitened.
    pub fn score(&self, samples: &[f64]) -> Score {
        let (product, energy) = self.product(samples);
        if energy.is_nan() || energy <= 0.0 {
            return Score { amplitude: 0.0, score: 0.0, energy: 0.0 };
        }
        Score { amplitude: product / energy, score: product * product / energy, energy }
    }

    /// The score of a signature with a fixed amplitude of one: it may also make the fit worse.
    pub fn whole(&self, samples: &[f64]) -> f64 {
        let (product, energy) = self.product(samples);
        2.0 * product - energy
    }

    /// The whitened, projected residual.
    pub fn residual(&self) -> &[f64] {
        &self.residual
    }
}

/// Cosine of the angle between two projected signatures.
pub fn cosine(a: &[f64], b: &[f64]) -> f64 {
    let scale = (dot(a, a) * dot(b, b)).sqrt();
    if scale > 0.0 { dot(a, b) / scale } else { 0.0 }
}
