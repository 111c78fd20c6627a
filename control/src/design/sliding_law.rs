//! The sliding surface with its reaching law.

use nalgebra::DMatrix;
use serde::Serialize;

/// Reaching law of the surface.
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
        /// Gain k1, one per surface.
        k1: Vec<f64>,
        /// Gain k2, one per surface.
        k2: Vec<f64>,
        /// Half-width of the boundary layer, input units times s.
        layer: Vec<f64>,
    },
}

/// The surface `s = surface [p; w]`, with the predicted state p and the integrals w of the error, and its
/// law.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SlidingLaw {
    /// Surface matrix, m x (n + integrals), scaled so that the surface responds to its input like an
    /// integrator.
    #[serde(serialize_with = "crate::rows::serialize")]
    pub surface: DMatrix<f64>,
    /// Gain of the equivalent control, m x (n + integrals).
    #[serde(serialize_with = "crate::rows::serialize")]
    pub equivalent: DMatrix<f64>,
    /// Poles of the motion on the surface, discrete, `[re, im]`.
    pub surface_poles: Vec<[f64; 2]>,
    /// Reaching law.
    pub switching: Switching,
    /// The reaching condition, as text with figures.
    pub reaching: String,
    /// Largest matched disturbance, in input units, against which the layer is reached and held; per input.
    pub matched_disturbance: Vec<f64>,
}
