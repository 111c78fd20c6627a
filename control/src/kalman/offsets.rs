//! What stands still and is not known: biases of sensors and offsets of inputs, each a state that hardly moves.
//!
//! An offset of an input is the model of any steady force that the inputs could hold (a centre of gravity beside the
//! middle, a bent blade, wind). As a state of the filter it makes the estimates right at rest, so that a law that integrates
//! their error leaves none (Muske and Badgwell, "Disturbance modeling for offset-free linear model predictive control",
//! J. Process Control 12, 2002; Pannocchia and Rawlings, AIChE Journal 49, 2003).

use super::error::EstimatorError;
use super::options::{EstimatorKind, EstimatorOptions};
use crate::options::Selector;
use crate::sampled_plant::SampledPlant;

/// Standard deviation of an offset at the start and its random walk per sqrt(s), in parts of the input's authority.
const START: f64 = 0.2;
const WALK: f64 = 0.01;

/// Outputs whose bias and inputs whose offset is estimated.
pub struct Offsets<'a> {
    /// The outputs.
    pub biased: &'a [usize],
    /// The inputs, with standard deviation at the start and walk per sqrt(s).
    pub trimmed: &'a [(usize, f64, f64)],
}

/// The inputs whose offset is estimated, each once, with standard deviation at the start and walk per sqrt(s).
///
/// # Errors
/// [`EstimatorError::Option`] for a name that is no input, a size that is not positive, and a filter without inputs.
pub fn trimmed(
    plant: &SampledPlant,
    options: &EstimatorOptions,
) -> Result<Vec<(usize, f64, f64)>, EstimatorError> {
    let refuse = |option: &'static str, why: String| Err(EstimatorError::Option { option, why });
    if options.kind == EstimatorKind::Kinematic && !options.input_bias.is_empty() {
        return refuse("input_bias", "the kinematic filter knows no inputs; kind = \"model\" does".into());
    }
    for (option, value) in
        [("input_bias_std", options.input_bias_std), ("input_bias_walk", options.input_bias_walk)]
    {
        if let Some(value) = value.filter(|v| !(v.is_finite() && *v > 0.0)) {
            return refuse(option, format!("{value} is not positive"));
        }
    }
    let names = plant.input_names();
    let mut found: Vec<(usize, f64, f64)> = Vec::new();
    for selector in &options.input_bias {
        let at = match selector {
            Selector::Index(i) => Some(*i).filter(|i| *i < names.len()),
            Selector::Name(name) => names.iter().position(|n| n == name),
        };
        let Some(at) = at else {
            return refuse(
                "input_bias",
                format!("{selector:?} is not an input; the inputs are {}", names.join(", ")),
            );
        };
        if found.iter().all(|(i, ..)| *i != at) {
            let authority = plant.inputs()[at].authority();
            let start = options.input_bias_std.unwrap_or(START * authority);
            found.push((at, start, options.input_bias_walk.unwrap_or(WALK * authority)));
        }
    }
    Ok(found)
}
