//! The control law, wired to the vehicle.

use std::ops::RangeInclusive;

use whirlstand_control::{Controller, Design};
use whirlstand_msgs::{AdjustmentVerdict, MAX_INPUTS, Setpoint, flags};
use whirlstand_vehicle::{LinearModel, Vehicle};

use crate::config::{Compensation, ControllerConfig, NodeConfig};
use crate::error::NodeError;
use crate::setup::Setup;

/// Factors on the law's feedback that can be set in flight: 20 dB to each side, wider than any gain margin to be shown.
const GAIN: RangeInclusive<f64> = 0.1..=10.0;

#[derive(Clone)]
pub(crate) enum Law {
    /// Closed loop.
    Designed { controller: Box<Controller>, states: usize, inputs: usize, add_stick: bool },
    /// Open loop: the stick passes through.
    Manual,
}

/// The controller that runs a design, with what it does about effects that are not linear.
///
/// # Errors
/// Why an effect cannot be taken off, in a sentence.
pub fn controller_of(
    design: &Design,
    config: &ControllerConfig,
    model: &Vehicle,
) -> Result<Controller, String> {
    let mut controller = Controller::new(design);
    if config.compensate.contains(&Compensation::DeadZone) {
        let linear = LinearModel::new(model).map_err(|e| e.to_string())?;
        if !controller.compensate_dead_zones(&linear.dead_zones) {
            return Err("a dead zone leaves an input no room within its limits, so that it cannot be jumped over; take \
                        dead_zone out of `compensate`"
                .into());
        }
    }
    Ok(controller)
}

impl Law {
    pub(crate) fn new(config: &NodeConfig, setup: &Setup) -> Result<Self, NodeError> {
        let Some(options) = config.controller.options() else { return Ok(Self::Manual) };
        let plant = setup.control_plant(config)?;
        let what = format!("a {} controller", options.name());
        let design = Design::new(&plant, &options).map_err(|e| setup.refuse(&what, &e))?;
        let controller = controller_of(&design, &config.controller, &setup.model)
            .map_err(|reason| setup.refuse(&what, &reason))?;
        Ok(Self::Designed {
            controller: Box::new(controller),
            states: plant.own_count(),
            inputs: plant.input_count(),
            add_stick: config.controller.add_stick,
        })
    }

    /// Computes the inputs for the next period from the estimated states; returns the command's flags.
    pub(crate) fn step(&mut self, x: &[f64], setpoint: &Setpoint, u: &mut [f64; MAX_INPUTS]) -> u32 {
        match self {
            Self::Manual => {
                *u = setpoint.stick;
                flags::MANUAL
            }
            Self::Designed { controller, states, inputs, add_stick } => {
                if *add_stick {
                    controller.set_test_input(&setpoint.stick[..*inputs]);
                }
                let outcome = controller.step(
                    &x[..*states],
                    &setpoint.x[..*states],
                    setpoint.tracked,
                    &mut u[..*inputs],
                );
                if outcome.saturated { flags::SATURATED } else { 0 }
            }
        }
    }

    /// Multiplies the law's feedback; refused beyond [`GAIN`], and by a law without feedback.
    pub(super) fn adjust_gain(&mut self, factor: f64) -> AdjustmentVerdict {
        match self {
            Self::Manual => AdjustmentVerdict::NotOfThisLaw,
            Self::Designed { .. } if !factor.is_finite() => AdjustmentVerdict::Unusable,
            Self::Designed { .. } if !GAIN.contains(&factor) => AdjustmentVerdict::OutOfRange,
            Self::Designed { controller, .. } => {
                controller.set_loop_gain(factor);
                AdjustmentVerdict::Done
            }
        }
    }

    /// Back to rest, for a new run.
    pub(super) fn reset(&mut self) {
        if let Self::Designed { controller, .. } = self {
            controller.reset();
        }
    }
}
