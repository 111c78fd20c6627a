//! The control law with its connection to the vehicle.

use std::ops::RangeInclusive;

use whirlstand_control::design::LeftOut;
use whirlstand_control::{Controller, Declined, Design};
use whirlstand_msgs::{AdjustmentVerdict, MAX_INPUTS, Setpoint, flags};
use whirlstand_vehicle::{Effect, LinearModel, SimulatorError, Vehicle};

use crate::config::{ControllerConfig, NodeConfig};
use crate::error::NodeError;
use crate::setup::Setup;

/// Range of factors on the law's feedback in flight: 20 dB to each side, beyond any gain margin to be shown.
const GAIN: RangeInclusive<f64> = 0.1..=10.0;

#[derive(Clone)]
pub(crate) enum Law {
    /// Closed loop.
    Designed { controller: Box<Controller>, states: usize, inputs: usize, add_stick: bool },
    /// Open loop: the stick passes through.
    Manual,
}

/// The controller of a design with its compensation of nonlinear effects, and the requested compensations
/// that are unsafe and declined.
///
/// # Errors
/// When an effect does not fit the vehicle.
pub fn controller_of(
    design: &Design,
    config: &ControllerConfig,
    model: &Vehicle,
) -> Result<(Controller, Vec<Declined>), SimulatorError> {
    let mut controller = Controller::new(design);
    let declined = match config.compensate.is_empty() {
        true => Vec::new(),
        false => controller.compensate(design, &LinearModel::new(model)?, &config.compensate),
    };
    Ok((controller, declined))
}

/// Effects of the vehicle that neither this law's design nor its compensation contains.
///
/// # Errors
/// When an effect does not fit the vehicle.
pub fn left_out(
    design: &Design,
    config: &ControllerConfig,
    model: &Vehicle,
) -> Result<Vec<LeftOut>, SimulatorError> {
    let (_, declined) = controller_of(design, config, model)?;
    let told = |(effect, why): (Effect, &'static str)| {
        let is = |name: &str| effect.kind().name() == name;
        let asked = config.compensate.iter().any(|c| is(c.name())) && effect.window().is_always();
        let unsafe_ = declined.iter().find(|d| is(d.effect.name()) && d.place == effect.place());
        let why = match unsafe_ {
            Some(declined) => declined.why.clone(),
            None if asked => return None,
            None => why.to_owned(),
        };
        Some(LeftOut { effect: effect.kind().name().into(), place: effect.place().into(), why })
    };
    Ok(LinearModel::new(model)?.left_out.into_iter().filter_map(told).collect())
}

impl Law {
    pub(crate) fn new(config: &NodeConfig, setup: &Setup) -> Result<Self, NodeError> {
        let Some(options) = config.controller.options() else { return Ok(Self::Manual) };
        let plant = setup.control_plant(config)?;
        let what = format!("a {} controller", options.name());
        let design = Design::new(&plant, &options).map_err(|e| setup.refuse(&what, &e))?;
        let (controller, declined) = controller_of(&design, &config.controller, &setup.model)
            .map_err(|reason| setup.refuse(&what, &reason))?;
        for Declined { effect, place, why } in declined {
            tracing::warn!("{} of {place} is not compensated: {why}", effect.name());
        }
        Ok(Self::Designed {
            controller: Box::new(controller),
            states: plant.own_count(),
            inputs: plant.input_count(),
            add_stick: config.controller.add_stick,
        })
    }

    /// Computes the inputs for the next period from the estimated states of a step; returns the command's flags.
    pub(crate) fn step(
        &mut self,
        step: u64,
        x: &[f64],
        setpoint: &Setpoint,
        u: &mut [f64; MAX_INPUTS],
    ) -> u32 {
        match self {
            Self::Manual => {
                *u = setpoint.stick;
                flags::MANUAL
            }
            Self::Designed { controller, states, inputs, add_stick } => {
                if *add_stick {
                    controller.set_test_input(&setpoint.stick[..*inputs]);
                }
                controller.set_step(step);
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

    /// Computes inputs as [`Self::step`], or takes inputs that are given `by_hand`: the law then follows
    /// these, so that it can take over from there.
    pub(super) fn step_or_follow(
        &mut self,
        step: u64,
        x: &[f64],
        setpoint: &Setpoint,
        by_hand: Option<&[f64; MAX_INPUTS]>,
        u: &mut [f64; MAX_INPUTS],
    ) -> u32 {
        let Some(given) = by_hand else { return self.step(step, x, setpoint, u) };
        *u = *given;
        if let Self::Designed { controller, states, inputs, .. } = self {
            let (x, wanted) = (&x[..*states], &setpoint.x[..*states]);
            controller.set_step(step);
            controller.fly_along_by_hand(&u[..*inputs], x, wanted, setpoint.tracked);
        }
        flags::MANUAL
    }

    /// Sets the factor on the law's feedback; refused outside [`GAIN`], and by a law without feedback.
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

    /// Number of steps after which a law that runs in parallel has only true commands in its memory.
    pub(super) fn memory_steps(&self) -> u64 {
        match self {
            Self::Manual => 0,
            Self::Designed { controller, .. } => controller.memory_steps() as u64,
        }
    }

    /// Runs in parallel with the law in charge, which has just taken the step, so that this law can take over
    /// in the next.
    pub(super) fn fly_along(&mut self, flying: &Self, x: &[f64], setpoint: &Setpoint) {
        if let (Self::Designed { controller, states, .. }, Self::Designed { controller: other, .. }) =
            (self, flying)
        {
            let (x, wanted) = (&x[..*states], &setpoint.x[..*states]);
            controller.fly_along(other, x, wanted, setpoint.tracked);
        }
    }

    /// Resets to the initial state, for a new run.
    pub(super) fn reset(&mut self) {
        if let Self::Designed { controller, .. } = self {
            controller.reset();
        }
    }
}
