//! The discrete-time linear model of a filter.

use nalgebra::DMatrix;

/// The discrete-time model of a [`super::KalmanFilter`] with n states, m inputs and p outputs.
#[derive(Debug, Clone, PartialEq)]
pub struct FilterModel {
    /// State transition F, n x n.
    pub f: DMatrix<f64>,
    /// Input matrix G, n x m.
    pub g: DMatrix<f64>,
    /// Output matrix H, p x n.
    pub h: DMatrix<f64>,
    /// Feed-through D, p x m.
    pub d: DMatrix<f64>,
    /// Covariance of the process noise per step, n x n, positive semidefinite.
    pub q: DMatrix<f64>,
    /// Variances of the p measurements, positive.
    pub variance: Vec<f64>,
}
