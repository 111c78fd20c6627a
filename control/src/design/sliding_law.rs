//! The surface of sliding mode and how it is reached and held.

use nalgebra::DMatrix;
use serde::Serialize;

/// How the surface is reached and held.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Switching {
    /// `s+ = (1 - rate T) s - gain T sat(s / layer)` (Gao, Wang and Homaifa 1995).
    ConstantPlusProportional {
        /// Exponential rate, 1/s.
        rate: f64,
        /// Switching gain, input units, one per surface.
        gain: Vec<f64>,
        /// Half-width of the boundary layer, input units times s.
        layer: Vec<f64>,
    },
    /// `s+ = s - T k1 s / sqrt(max(|s|, layer)) + T v`, `v+ = v - T k2 sat(s / layer)` (Levant 1993, with a layer).
    SuperTwisting {
        /// k1, per surface.
        k1: Vec<f64>,
        /// k2, per surface.
        k2: Vec<f64>,
        /// Half-width of the boundary layer, input units times s.
        layer: Vec<f64>,
    },
}

/// The surface `s = surface [p; w]`, p the predicted state and w the integrals of the error, and its law.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SlidingLaw {
    /// m x (n + integrals), scaled so that an input moves its surface as it would an integrator.
    #[serde(serialize_with = "crate::rows::serialize")]
    pub surface: DMatrix<f64>,
    /// Equivalent control, m x (n + integrals).
    #[serde(serialize_with = "crate::rows::serialize")]
    pub equivalent: DMatrix<f64>,
    /// Poles of the motion on the surface, discrete, `[re, im]`.
    pub surface_poles: Vec<[f64; 2]>,
    /// Reaching and holding.
    pub switching: Switching,
    /// The reaching condition, in words and figures.
    pub reaching: String,
    /// Largest matched disturbance, in input units, against which the layer is reached and held; per input.
    pub matched_disturbance: Vec<f64>,
}
