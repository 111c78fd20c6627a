//! Options of the filter, from a launch file or a caller.

use serde::{Deserialize, Serialize};

use crate::options::{Selector, Weights};

/// Prediction model of the filter.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum EstimatorKind {
    /// Kinematics only: angles from rates and positions from speeds; rates are estimated from angles, without
    /// inputs.
    Kinematic,
    /// The discretised vehicle model with its inputs.
    #[default]
    Model,
}

/// Model of a sensor's declared vibration in the filter.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum VibrationModel {
    /// White noise with the variance of the vibration.
    #[default]
    Noise,
    /// Oscillators at the vibration's frequencies, whose signals are not part of the estimated states.
    Oscillator,
}

/// Options of the filter; in a launch file, the table `[estimator]`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EstimatorOptions {
    /// Prediction model.
    pub kind: EstimatorKind,
    /// Model of declared vibration.
    pub vibration: VibrationModel,
    /// Density of the white noise on the derivative of each state, SI units times sqrt(s), by state. Default:
    /// zero for kinematic rows; otherwise the state's scale per sqrt(s), three times that for the kinematic
    /// filter.
    pub process_noise: Option<Weights>,
    /// Outputs whose bias is estimated. Default: gyros, which are rates whose angle is measured too.
    pub bias: Option<Vec<Selector>>,
    /// Initial standard deviation of the biases, SI units. Default: ten times the output's noise.
    pub bias_std: Option<f64>,
    /// Random walk of the biases, SI units per sqrt(s). Default: a hundredth of the output's noise.
    pub bias_walk: Option<f64>,
    /// Inputs whose constant offset (trim) is estimated as an additional state, so that an unmodelled steady
    /// force does not bias the estimates. Default: none.
    pub input_bias: Vec<Selector>,
    /// Initial standard deviation of the offsets, input units. Default: a fifth of the input's authority.
    pub input_bias_std: Option<f64>,
    /// Random walk of the offsets, input units per sqrt(s). Default: a hundredth of the input's authority.
    pub input_bias_walk: Option<f64>,
    /// Outputs used. Default: all with the model; all but gyros with the kinematic filter, as in the paper.
    pub outputs: Option<Vec<Selector>>,
}
