//! The age of the measurements, estimated beside a filter: the two-stage filter of Friedland (1969).
//!
//! A filter takes each measurement for one of its own step. Those of a real vehicle are older, by a time that is
//! unknown and changes slowly, and by a different time in each sample. To first order a measurement that is older by
//! `b` differs by the outputs' slope times `-b`. The common age is a bias with this time-varying influence: its effect
//! on the filter's state is followed (the response V of Friedland), and it is estimated from the filter's innovations.
//! What differs from sample to sample is noise for the filter.
//!
//! Source: B. Friedland, Treatment of bias in recursive filtering, IEEE Trans. Automatic Control 14 (1969).

use super::filter::KalmanFilter;
use crate::kernel::{Block, blocks};

/// Estimator of the measurements' age beside a [`KalmanFilter`]. A step allocates nothing.
#[derive(Debug, Clone)]
pub struct MeasurementAge {
    /// Variance of the age, s^2, and its growth in a step.
    variance: f64,
    walk: f64,
    /// Error of the filter's state per second of age: V.
    response: Vec<Block>,
    scratch: Vec<Block>,
    /// Sensitivity of the innovations to the age, and whitened.
    sensitivity: Vec<Block>,
    white: Vec<Block>,
    whitened: Vec<f64>,
    change: Vec<f64>,
}

/// Standard deviations of the age, s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AgeSpread {
    /// Of the age at the beginning.
    pub initial_s: f64,
    /// Of its change within a second.
    pub per_second_s: f64,
}

impl MeasurementAge {
    /// An estimator beside `filter`, which has not made a step yet and whose step is `period_s`.
    pub fn new(filter: &KalmanFilter, period_s: f64, spread: AgeSpread) -> Self {
        let (n, p) = (filter.x().len(), filter.outputs);
        let of = |rows: usize| vec![[0.0; 4]; blocks(rows)];
        Self {
            variance: spread.initial_s.powi(2),
            walk: spread.per_second_s.powi(2) * period_s,
            response: of(n),
            scratch: of(n),
            sensitivity: of(p),
            white: of(p),
            whitened: vec![0.0; p],
            change: vec![0.0; n],
        }
    }

    /// Follows a step of the filter, whose measurements changed by `slope` per second, and returns the change of the
    /// estimated age, s. The caller adds it to the age with which it prepares measurements, and [`Self::change`] to the
    /// state of the filter.
    pub fn step(&mut self, filter: &KalmanFilter, slope: &[f64]) -> f64 {
        let gains = filter.recursion.gains();
        self.scratch.fill([0.0; 4]);
        filter.f.add(&mut self.scratch, self.response.as_flattened());
        std::mem::swap(&mut self.response, &mut self.scratch);
        self.sensitivity.fill([0.0; 4]);
        for (s, slope) in self.sensitivity.as_flattened_mut().iter_mut().zip(slope) {
            *s = -slope;
        }
        filter.h.add(&mut self.sensitivity, self.response.as_flattened());
        let sensitivity = &self.sensitivity.as_flattened()[..filter.outputs];
        self.white.fill([0.0; 4]);
        gains.whitening.add(&mut self.white, sensitivity);
        gains.gain.subtract(&mut self.response, sensitivity);
        let age = self.update(filter.whitened());
        for (change, response) in self.change.iter_mut().zip(self.response.as_flattened()) {
            *change = response * age;
        }
        age
    }

    /// Estimates the age from whitened innovations, one after the other.
    fn update(&mut self, innovations: &[f64]) -> f64 {
        let (mut age, mut p) = (0.0, self.variance + self.walk);
        for ((w, s), white) in innovations.iter().zip(self.white.as_flattened()).zip(&mut self.whitened) {
            let variance = 1.0 + s * s * p;
            let error = w - s * age;
            *white = error / variance.sqrt();
            age += p * s * error / variance;
            p /= variance;
        }
        self.variance = p;
        age
    }

    /// Begins anew with a standard deviation of the age, s, beside a filter whose state owes nothing to the age.
    pub fn begin(&mut self, std_s: f64) {
        self.variance = std_s * std_s;
        self.response.fill([0.0; 4]);
    }

    /// Change of the filter's state that belongs to the last change of the age.
    pub fn change(&self) -> &[f64] {
        &self.change
    }

    /// Innovations of the last step, whitened and without what the age explains, as [`KalmanFilter::whitened`].
    pub fn whitened(&self) -> &[f64] {
        &self.whitened
    }

    /// Standard deviation of the age, s.
    pub fn std(&self) -> f64 {
        self.variance.max(0.0).sqrt()
    }
}
