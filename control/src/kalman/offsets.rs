//! Unknown constants (biases of sensors and offsets of inputs), each modelled as an almost constant state.
//!
//! An offset of an input models any steady force that the inputs could balance (an eccentric centre of
//! gravity, a bent blade, wind). As a state of the filter it makes the estimates unbiased at rest, so that a
//! control law with integral action leaves no steady-state error (Muske and Badgwell, "Disturbance modeling
//! for offset-free linear model predictive control", J. Process Control 12, 2002; Pannocchia and Rawlings,
//! AIChE Journal 49, 2003).

use super::error::EstimatorError;
use super::options::{EstimatorKind, EstimatorOptions};
use crate::options::Selector;
use crate::sampled_plant::SampledPlant;

/// Initial standard deviation of an offset and (`WALK`) its random walk per sqrt(s), relative to the input's
/// authority.
const START: f64 = 0.2;
const WALK: f64 = 0.01;

/// Outputs with an estimated bias, and inputs with an estimated offset.
pub struct Offsets<'a> {
    /// Indices of the biased outputs.
    pub biased: &'a [usize],
    /// Inputs with an estimated offset: index, initial standard deviation, and walk per sqrt(s).
    pub trimmed: &'a [(usize, f64, f64)],
}

/// Inputs with an estimated offset, each once: index, initial standard deviation, and walk per sqrt(s).
///
/// # Errors
/// Returns [`EstimatorError::Option`] for an unknown input, a size that is not positive, or a filter without
/// inputs.
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
