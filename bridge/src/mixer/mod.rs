//! Mixer from the outputs of an autopilot to the inputs of the vehicle.
//!
//! An autopilot drives motors or swashplate servos; the model of the vehicle is driven by `u_roll` and
//! `u_pitch`. The mixer inverts the autopilot's own mixer: the demand of all actuators about each axis, as a
//! share of the largest possible one, times the scale of the vehicle's input.
//!
//! | axis | positive | full deflection (1) |
//! |---|---|---|
//! | roll | right side down | left motors full, right motors still; swashplate full to the right |
//! | pitch | nose up | front motors full, rear motors still; swashplate full to the rear |
//! | yaw | nose to the right | counter-clockwise motors full, the others still |
//! | collective | upwards | all motors full; swashplate full up |

mod frame;

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use whirlstand_vehicle::Vehicle;

pub use frame::{Demand, Frame, FrameKind, MAX_OUTPUTS};

use crate::config::ConfigError;
use crate::quantity;

/// Options of the mixer.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MixerOptions {
    /// Arrangement of the actuators.
    pub frame: FrameKind,
    /// Output of each actuator, from 1, in the order of the frame; the autopilot's own order when absent.
    pub outputs: Option<Vec<usize>>,
    /// Azimuth of each swashplate servo, clockwise from the nose, rad; for the frame `ccpm`.
    #[serde(deserialize_with = "quantity::angles")]
    pub azimuths: Option<Vec<f64>>,
    /// Outputs with reversed sign, from 1.
    pub reversed: Vec<usize>,
    /// Collective at which the vehicle keeps its height, 0 to 1 for motors, -1 to 1 for a swashplate.
    pub hover: Option<f64>,
    /// Mapping of roll to the vehicle.
    pub roll: AxisOptions,
    /// Mapping of pitch to the vehicle.
    pub pitch: AxisOptions,
    /// Mapping of yaw to the vehicle, if it has a yaw axis.
    pub yaw: AxisOptions,
    /// Mapping of the collective to the vehicle, if it has a vertical axis.
    pub vertical: AxisOptions,
}

/// Mapping of one axis to the vehicle: input = trim + scale x demand, or the inputs that give its
/// acceleration.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AxisOptions {
    /// Input of the vehicle; `u_` and the axis when absent.
    pub input: Option<String>,
    /// Input at full deflection; when absent, the input's limit, with the sign for which a positive demand
    /// gives a positive rotation of the model.
    pub scale: Option<f64>,
    /// Acceleration of the axis at full deflection, rad/s^2 or m/s^2, in place of a scale. The inputs that
    /// cause it, and no acceleration of the other axes, follow from B; either every axis has it, or none.
    #[serde(deserialize_with = "quantity::acceleration")]
    pub acceleration: Option<f64>,
    /// Input at zero demand.
    pub trim: f64,
}

/// Converts outputs of an autopilot to inputs of the vehicle.
#[derive(Debug, Clone, PartialEq)]
pub struct Mixer {
    frame: Frame,
    outputs: Vec<usize>,
    reversed: Vec<bool>,
    hover: f64,
    axes: Vec<Axis>,
    /// Gain from each axis's demand to each axis's input.
    gains: DMatrix<f64>,
    count: usize,
    neutral: Vec<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Axis {
    demand: Demand,
    input: usize,
    size: Size,
    trim: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Size {
    /// Input at full deflection.
    Input(f64),
    /// Acceleration of the axis at full deflection.
    Acceleration(f64),
}

impl Mixer {
    /// A mixer for a vehicle; `native` is the order of the autopilot's outputs, from 1, as
    /// [`MixerOptions::outputs`].
    ///
    /// # Errors
    /// [`ConfigError`] when an input is missing or its size unknown, or the actuators are impossible.
    pub fn new(options: &MixerOptions, native: &[usize], vehicle: &Vehicle) -> Result<Self, ConfigError> {
        let frame = Frame::new(options.frame, options.azimuths.as_deref())?;
        let wrong = |key: &str, message: String| Err(ConfigError::new(&["mixer", key], message));
        let outputs =
            options.outputs.clone().unwrap_or_else(|| native.iter().copied().take(frame.count()).collect());
        if outputs.len() != frame.count() {
            return wrong("outputs", format!("{} outputs are needed, not {}", frame.count(), outputs.len()));
        }
        for (key, list) in [("outputs", &outputs), ("reversed", &options.reversed)] {
            if let Some(bad) = list.iter().find(|o| !(1..=MAX_OUTPUTS).contains(*o)) {
                return wrong(key, format!("outputs are numbered from 1 to {MAX_OUTPUTS}, {bad} is none"));
            }
        }
        let hover = options.hover.unwrap_or(if frame.is_motors() { 0.5 } else { 0.0 });
        if !(-1.0..=1.0).contains(&hover) {
            return wrong(
                "hover",
                format!("a share of the full collective is expected, -1 to 1, not {hover}"),
            );
        }
        let mut axes = Vec::new();
        for (demand, own, required) in [
            (Demand::Roll, &options.roll, true),
            (Demand::Pitch, &options.pitch, true),
            (Demand::Yaw, &options.yaw, false),
            (Demand::Vertical, &options.vertical, false),
        ] {
            if let Some(axis) = axis(demand, own, required, vehicle)? {
                axes.push(axis);
            }
        }
        Ok(Self {
            reversed: outputs.iter().map(|o| options.reversed.contains(o)).collect(),
            frame,
            outputs,
            hover,
            gains: gains(&axes, vehicle)?,
            axes,
            count: vehicle.inputs.len(),
            neutral: vehicle.inputs.iter().map(whirlstand_vehicle::Input::neutral).collect(),
        })
    }

    /// Number of the vehicle's inputs.
    pub fn inputs(&self) -> usize {
        self.count
    }

    /// Neutral inputs.
    pub fn neutral(&self) -> &[f64] {
        &self.neutral
    }

    /// The outputs used by the mixer.
    pub fn used<'o>(&'o self, outputs: &'o [f64]) -> impl Iterator<Item = f64> + 'o {
        self.outputs.iter().filter_map(|o| outputs.get(o - 1).copied())
    }

    /// The first output used by the mixer, from 1, among those whose bit is set.
    pub fn first_used(&self, bits: u32) -> Option<usize> {
        self.outputs.iter().copied().filter(|output| bits >> (output - 1) & 1 == 1).min()
    }

    /// Demand of the outputs about an axis, as a share of the largest possible one.
    pub fn demand(&self, demand: Demand, outputs: &[f64]) -> f64 {
        let value = |i: usize| {
            let value = self.outputs.get(i).and_then(|o| outputs.get(o - 1)).copied().unwrap_or(0.0);
            match (self.reversed[i], self.frame.is_motors()) {
                (false, _) => value,
                (true, true) => 1.0 - value,
                (true, false) => -value,
            }
        };
        let hover = if demand == Demand::Vertical { self.hover } else { 0.0 };
        (0..self.frame.count()).map(|i| self.frame.share(demand, i) * value(i)).sum::<f64>() - hover
    }

    /// Writes the inputs for `outputs` to `u`, which has one element for each input of the vehicle. Inputs
    /// without an axis are neutral. A missing output counts as zero.
    pub fn mix(&self, outputs: &[f64], u: &mut [f64]) {
        u.copy_from_slice(&self.neutral);
        for axis in &self.axes {
            u[axis.input] = axis.trim;
        }
        for (j, from) in self.axes.iter().enumerate() {
            let demand = self.demand(from.demand, outputs);
            for (i, to) in self.axes.iter().enumerate() {
                // Zero gains are skipped, so that NaN does not spread.
                if self.gains[(i, j)] != 0.0 {
                    u[to.input] += self.gains[(i, j)] * demand;
                }
            }
        }
    }
}

fn axis(
    demand: Demand,
    options: &AxisOptions,
    required: bool,
    vehicle: &Vehicle,
) -> Result<Option<Axis>, ConfigError> {
    let wrong = |key: &str, message: String| Err(ConfigError::new(&["mixer", demand.name(), key], message));
    let name = options.input.clone().unwrap_or_else(|| format!("u_{}", demand.name()));
    let Some(input) = vehicle.input_index(&name) else {
        if !required && options.input.is_none() {
            return Ok(None);
        }
        let known = vehicle.inputs.iter().map(|i| i.name.as_str()).collect::<Vec<_>>().join(", ");
        let message = format!("the vehicle {} has no input \"{name}\"; it has {known}", vehicle.name);
        return wrong("input", message);
    };
    let finite = |key: &str, value: f64| {
        let expected = || ConfigError::new(&["mixer", demand.name(), key], "a finite number is expected");
        Some(value).filter(|v| v.is_finite()).ok_or_else(expected)
    };
    let size = match (options.acceleration, options.scale.or_else(|| default_scale(demand, input, vehicle))) {
        (Some(_), _) if options.scale.is_some() => {
            return wrong(
                "scale",
                "scale and acceleration are two ways to say the same: give one of them".into(),
            );
        }
        (Some(acceleration), _) => Size::Acceleration(finite("acceleration", acceleration)?),
        (None, Some(scale)) => Size::Input(finite("scale", scale)?),
        (None, None) => {
            let message = format!(
                "the input {name} of the vehicle {} has no finite limit or does not act on {}, so that its size and sign \
                 are unknown: give a scale",
                vehicle.name,
                demand.state()
            );
            return wrong("scale", message);
        }
    };
    Ok(Some(Axis { demand, input, size, trim: finite("trim", options.trim)? }))
}

/// Gains from each axis's demand to each axis's input: the scales, or the inverse of the part of B from
/// inputs to accelerations of the axes, times the accelerations.
fn gains(axes: &[Axis], vehicle: &Vehicle) -> Result<DMatrix<f64>, ConfigError> {
    let n = axes.len();
    let mut accelerations = DMatrix::zeros(n, n);
    let mut scales = DMatrix::zeros(n, n);
    let mut accelerated = 0;
    for (i, axis) in axes.iter().enumerate() {
        match axis.size {
            Size::Input(scale) => scales[(i, i)] = scale,
            Size::Acceleration(acceleration) => {
                accelerations[(i, i)] = acceleration;
                accelerated += 1;
            }
        }
    }
    if accelerated == 0 {
        return Ok(scales);
    }
    let wrong = |message: String| Err(ConfigError::new(&["mixer"], message));
    if accelerated < n {
        let names: Vec<_> = axes.iter().map(|a| a.demand.name()).collect();
        return wrong(format!(
            "either all axes have an acceleration or none: {} are the axes",
            names.join(", ")
        ));
    }
    let mut effect = DMatrix::zeros(n, n);
    for (i, axis) in axes.iter().enumerate() {
        let name = axis.demand.state();
        let Some(state) = vehicle.state_index(name) else {
            return wrong(format!(
                "the vehicle {} has no state {name} to accelerate: give scales",
                vehicle.name
            ));
        };
        for (j, input) in axes.iter().enumerate() {
            effect[(i, j)] = vehicle.b[(state, input.input)];
        }
    }
    match effect.try_inverse() {
        Some(inverse) => Ok(inverse * accelerations),
        None => wrong("the inputs of the axes do not accelerate them independently: give scales".into()),
    }
}

/// The larger of the input's two limits, with the sign of its effect on the axis.
fn default_scale(demand: Demand, input: usize, vehicle: &Vehicle) -> Option<f64> {
    let state = vehicle.state_index(demand.state())?;
    let effect = vehicle.b[(state, input)];
    let limits = &vehicle.inputs[input];
    let size = limits.upper.abs().max(limits.lower.abs());
    (effect != 0.0 && size.is_finite() && size > 0.0).then(|| size * effect.signum())
}

#[cfg(test)]
mod tests;
