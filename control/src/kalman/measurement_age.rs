//! Estimation of the age of the measurements alongside a filter: the two-stage filter of Friedland (1969).
//!
//! A filter assigns each measurement to its own step. The measurements of a real vehicle are older, by a
//! slowly changing, unknown time and by a different time in each sample. To first order, the age `b` of a
//! measurement changes it by the outputs' slope times `-b`. The common age is a bias with this time-varying
//! influence: its effect on the filter's state is propagated (the response V of Friedland), and it is
//! estimated from the filter's innovations. The variation from sample to sample is noise for the filter.
//!
//! Source: B. Friedland, Treatment of bias in recursive filtering, IEEE Trans. Automatic Control 14 (1969).

use super::filter::KalmanFilter;
use crate::kernel::{Block, blocks};

/// Estimator of the age of the measurements alongside a [`KalmanFilter`]. A step allocates nothing.
#[derive(Debug, Clone)]
pub struct MeasurementAge {
    /// Variance of the age, s^2, and (`walk`) its increase per step.
    variance: f64,
    walk: f64,
    /// Whether the age is held as it is.
    held: bool,
    /// Friedland's response V: the error of the filter's state per second of age.
    response: Vec<Block>,
    scratch: Vec<Block>,
    /// Sensitivity of the innovations to the age; `white`: whitened.
    sensitivity: Vec<Block>,
    white: Vec<Block>,
    whitened: Vec<f64>,
    change: Vec<f64>,
}

/// Standard deviations of the age, s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AgeSpread {
    /// Standard deviation of the initial age.
    pub initial_s: f64,
    /// Standard deviation of its change per second.
    pub per_second_s: f64,
}

impl MeasurementAge {
    /// An estimator for `filter`, which must not have made a step yet and has the sampling period `period_s`.
    pub fn new(filter: &KalmanFilter, period_s: f64, spread: AgeSpread) -> Self {
        let (n, p) = (filter.x().len(), filter.outputs);
        let of = |rows: usize| vec![[0.0; 4]; blocks(rows)];
        Self {
            variance: spread.initial_s.powi(2),
            walk: spread.per_second_s.powi(2) * period_s,
            held: false,
            response: of(n),
            scratch: of(n),
            sensitivity: of(p),
            white: of(p),
            whitened: vec![0.0; p],
            change: vec![0.0; n],
        }
    }

    /// Processes a step of the filter, whose measurements changed by `slope` per second, and returns the
    /// change of the estimated age, s. The caller adds it to the age with which it prepares measurements, and
    /// [`Self::change`] to the state of the filter.
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

    /// Updates the age estimate sequentially with the whitened innovations; returns the change of the age.
    fn update(&mut self, innovations: &[f64]) -> f64 {
        if self.held {
            self.whitened.iter_mut().zip(innovations).for_each(|(own, e)| *own = *e);
            return 0.0;
        }
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

    /// Restarts with a standard deviation of the age, s, for a filter whose state does not depend on the age.
    pub fn begin(&mut self, std_s: f64) {
        self.held = false;
        self.variance = std_s * std_s;
        self.response.fill([0.0; 4]);
    }

    /// Holds the age as it is until [`Self::begin`]: innovations of a changed vehicle say nothing about it.
    pub fn hold(&mut self) {
        self.held = true;
    }

    /// Change of the filter's state that corresponds to the last change of the age.
    pub fn change(&self) -> &[f64] {
        &self.change
    }

    /// Whitened innovations of the last step after the correction of the age, as [`KalmanFilter::whitened`].
    pub fn whitened(&self) -> &[f64] {
        &self.whitened
    }

    /// Standard deviation of the age, s.
    pub fn std(&self) -> f64 {
        self.variance.max(0.0).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};

    use super::*;
    use crate::kalman::FilterModel;

    /// Compares the two stages with the textbook filter whose state is augmented by the age; for a constant
    /// age they are equal.
    #[test]
    fn both_stages_together_are_the_filter_with_the_age_as_a_state() {
        let dt = 0.01;
        let model = FilterModel {
            f: DMatrix::from_row_slice(2, 2, &[1.0, dt, -0.02, 0.98]),
            g: DMatrix::zeros(2, 1),
            h: DMatrix::from_row_slice(2, 2, &[1.0, 0.0, 0.0, 1.0]),
            d: DMatrix::zeros(2, 1),
            q: DMatrix::from_row_slice(2, 2, &[1e-8, 0.0, 0.0, 1e-5]),
            variance: vec![1e-4, 4e-4],
        };
        let (initial, spread) = ([0.1, 0.3], AgeSpread { initial_s: 0.02, per_second_s: 0.0 });
        let mut filter = KalmanFilter::new(model.clone(), &initial);
        let mut stage = MeasurementAge::new(&filter, dt, spread);
        let mut f = DMatrix::identity(3, 3);
        f.view_mut((0, 0), (2, 2)).copy_from(&model.f);
        let mut q = DMatrix::zeros(3, 3);
        q.view_mut((0, 0), (2, 2)).copy_from(&model.q);
        q[(2, 2)] = spread.per_second_s.powi(2) * dt;
        let mut p = DMatrix::from_diagonal(&DVector::from_column_slice(&[0.01, 0.09, 4e-4]));
        p[(2, 2)] += q[(2, 2)];
        let mut whole = DVector::zeros(3);
        let mut age = 0.0;
        for k in 0..200u32 {
            let t = f64::from(k) * dt;
            let slope = [3.0 * (5.0 * t).sin(), 2.0 * (7.0 * t).cos()];
            let y = [0.1 * (11.0 * t).sin(), 0.2 * (3.0 * t).cos() - 0.03 * slope[1]];
            let mask = [3, 3, 1, 0, 2][k as usize % 5];
            if k > 0 {
                whole = &f * &whole;
                p = &f * &p * f.transpose() + &q;
            }
            let (mut nis, mut rows) = (0.0, Vec::new());
            for i in (0..2).filter(|i| mask >> i & 1 == 1) {
                let mut h = DVector::zeros(3);
                (h[i], h[2]) = (1.0, -slope[i]);
                let variance = (h.transpose() * &p * &h)[0] + model.variance[i];
                let error = y[i] - h.dot(&whole);
                let gain = &p * &h / variance;
                whole += &gain * error;
                p -= &gain * h.transpose() * &p;
                nis += error * error / variance;
                rows.push(error / variance.sqrt());
            }
            // The measurements, corrected by the estimated age.
            let aged: Vec<f64> = y.iter().zip(slope).map(|(y, slope)| y + slope * age).collect();
            filter.step_uncertain(&aged, mask, (&[], &[]));
            age += stage.step(&filter, &slope);
            let x: Vec<f64> = filter.x().iter().zip(stage.change()).map(|(x, change)| x + change).collect();
            filter.set_state(&x);
            let close =
                |a: f64, b: f64, what: &str| assert!((a - b).abs() < 1e-9, "step {k}, {what}: {a}, not {b}");
            close(age / spread.initial_s, whole[2] / spread.initial_s, "age");
            close(x[0] / 0.1, whole[0] / 0.1, "angle");
            close(stage.std() / spread.initial_s, p[(2, 2)].sqrt() / spread.initial_s, "std");
            let sum: f64 = stage.whitened().iter().map(|w| w * w).sum();
            close(sum / (1.0 + nis), nis / (1.0 + nis), "whitened innovations");
        }
    }

    #[test]
    fn what_is_pushed_counts_as_uncertain() {
        let model = FilterModel {
            f: DMatrix::identity(1, 1),
            g: DMatrix::zeros(1, 1),
            h: DMatrix::identity(1, 1),
            d: DMatrix::zeros(1, 1),
            q: DMatrix::zeros(1, 1),
            variance: vec![1.0],
        };
        let mut filter = KalmanFilter::new(model, &[1.0]);
        filter.step_uncertain(&[0.0], 1, (&[], &[]));
        // Half of the variance remains; the pushes add 1.5 to it, and `more` adds 2 to that of the
        // measurement.
        filter.step_uncertain(&[2.0], 1, (&[1.0, 0.5f64.sqrt()], &[2.0]));
        assert!((filter.whitened()[0] - 2.0 / 5f64.sqrt()).abs() < 1e-12, "{:?}", filter.whitened());
        assert!((filter.x()[0] - 2.0 * 2.0 / 5.0).abs() < 1e-12, "{:?}", filter.x());
    }
}
