//! What a launch file or a caller can ask of the filter.

use serde::{Deserialize, Serialize};

use crate::options::{Selector, Weights};

/// Which model the filter predicts with.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum EstimatorKind {
    /// Angles from rates and positions from speeds only; angular rates from angles, no inputs.
    Kinematic,
    /// The discretised vehicle with its inputs.
    #[default]
    Model,
}

/// What the filter takes the declared vibration of a sensor for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum VibrationModel {
    /// White noise of its variance.
    #[default]
    Noise,
    /// Oscillators of its frequencies, which the states are freed of.
    Oscillator,
}

/// Options of the filter; in a launch file, the table `[estimator]`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EstimatorOptions {
    /// Which model.
    pub kind: EstimatorKind,
    /// What declared vibration is taken for.
    pub vibration: VibrationModel,
    /// Density of the white noise on the derivative of each state, SI units times sqrt(s), by state. Default:
    /// zero for kinematic rows; else the state's scale per sqrt(s), thrice that for the kinematic filter.
    pub process_noise: Option<Weights>,
    /// Outputs whose bias is estimated. Default: gyros, that is rates whose angle is measured as well.
    pub bias: Option<Vec<Selector>>,
    /// Standard deviation of these biases at the start, SI units. Default: ten times the output's noise.
    pub bias_std: Option<f64>,
    /// Random walk of these biases, SI units per sqrt(s). Default: a hundredth of the output's noise.
    pub bias_walk: Option<f64>,
    /// Inputs whose constant offset, the trim, is estimated as a further state: a steady force that nobody told of
    /// then does not bend the estimates. Default: none.
    pub input_bias: Vec<Selector>,
    /// Standard deviation of these offsets at the start, input units. Default: a fifth of the input's authority.
    pub input_bias_std: Option<f64>,
    /// Random walk of these offsets, input units per sqrt(s). Default: a hundredth of the input's authority.
    pub input_bias_walk: Option<f64>,
    /// Outputs used. Default: all for the model; all but gyros for the kinematic filter, as in the paper.
    pub outputs: Option<Vec<Selector>>,
}
