//! A law with its filter, designed for a model of the vehicle.

use whirlstand_control::design::{EstimatedLoop, LoopFigures};
use whirlstand_control::{Design, Estimator, EstimatorError};
use whirlstand_nodes::config::{ControllerConfig, NodeConfig, VehicleSource};
use whirlstand_nodes::estimator::filter_of;
use whirlstand_nodes::setup::Setup;
use whirlstand_vehicle::{LinearModel, Vehicle};

use crate::error::Failure;

/// A law with its filter.
pub(super) struct Pilot {
    /// The design of the law; `None` for control by stick alone.
    pub design: Option<Design>,
    /// Options of the controller.
    pub controller: ControllerConfig,
    /// Vehicle model used by law and filter.
    pub model: VehicleSource,
    estimator: Estimator,
}

impl Pilot {
    /// Designs law and filter for `model` as the nodes of a bench do.
    ///
    /// # Errors
    /// When either cannot be designed, with the reason.
    pub fn new(
        config: &NodeConfig,
        (model, origin): (&Vehicle, &str),
        controller: ControllerConfig,
    ) -> Result<Self, Failure> {
        let plant = Setup::plant_of(model, Setup::period_s(config)).map_err(Failure::mend)?;
        let design = match controller.options() {
            None => None,
            Some(options) => Some(Design::new(&plant, &options).map_err(|e| {
                Failure::Mend(format!("{} cannot be designed for {}: {e}", options.name(), model.name))
            })?),
        };
        let refuse =
            |e: EstimatorError| Failure::Mend(format!("no filter can be designed for {}: {e}", model.name));
        let estimator =
            filter_of(model, &plant, &config.estimator, config.plant.engine.into()).map_err(refuse)?;
        let model = VehicleSource { origin: origin.into(), text: model.to_toml() };
        Ok(Self { design, controller, model, estimator })
    }

    /// Margins of the loop with the filter around the actual vehicle; `None` for control by stick alone.
    pub fn loop_around(&self, linear: &LinearModel, vehicle: &Vehicle) -> Option<LoopFigures> {
        let design = self.design.as_ref()?;
        let every: Vec<u32> = vehicle.outputs.iter().map(|o| o.every).collect();
        let figures = EstimatedLoop::new(&design.plant, &design.linear, &self.estimator, linear, &every);
        Some(figures.map_or_else(
            |e| LoopFigures::Absent { why: e.to_string() },
            |known| LoopFigures::Known(Box::new(known)),
        ))
    }
}
