//! The Kalman filter, wired to the vehicle's sensors.

use whirlstand_control::{Estimator, EstimatorError, EstimatorKind, EstimatorOptions, SampledPlant, Sensors};
use whirlstand_msgs::{Estimate, Head, MAX_INPUTS, MAX_OUTPUTS, Message, flags};
use whirlstand_vehicle::{Engine, LinearModel, Vehicle};

use crate::config::NodeConfig;
use crate::error::NodeError;
use crate::setup::Setup;
use crate::signals::{Measurement, OutputMap};

/// Noise that the filter assumes of a sensor that declares none, in SI units: small against every sensor that
/// flies, and large enough for the arithmetic.
const LEAST_NOISE: f64 = 1e-6;

/// Outputs whose bias travels in `Estimate`, in its order.
const BIASES: [&str; 4] = ["roll", "pitch", "roll_rate", "pitch_rate"];

pub(crate) struct Filter {
    estimator: Estimator,
    new: Estimator,
    map: OutputMap,
    outputs: usize,
    states: usize,
    inputs: usize,
    /// Output behind each of [`BIASES`].
    biases: [Option<usize>; BIASES.len()],
    feedthrough: bool,
}

impl Filter {
    pub(crate) fn new(config: &NodeConfig, setup: &Setup) -> Result<Self, NodeError> {
        let vehicle = &setup.model;
        let what = match config.estimator.kind {
            EstimatorKind::Kinematic => "a kinematic estimator",
            EstimatorKind::Model => "a model-based estimator",
        };
        let plant = setup.control_plant(config)?;
        let estimator = filter_of(vehicle, &plant, &config.estimator, config.plant.engine.into())
            .map_err(|e| setup.refuse(what, &e))?;
        Ok(Self {
            new: estimator.clone(),
            estimator,
            map: setup.map.clone(),
            outputs: vehicle.outputs.len(),
            states: vehicle.states.len(),
            inputs: vehicle.inputs.len(),
            biases: BIASES.map(|name| vehicle.output_index(name)),
            feedthrough: vehicle.d.iter().any(|v| *v != 0.0),
        })
    }

    /// The filter alone, before its first step.
    pub(crate) fn into_estimator(self) -> Estimator {
        self.new
    }

    /// Whether a measurement shows the input of the same moment.
    pub(super) fn has_feedthrough(&self) -> bool {
        self.feedthrough
    }

    /// Begins anew.
    pub(super) fn restart(&mut self) {
        self.estimator = self.new.clone();
    }

    /// A step without a measurement.
    pub(super) fn predict(&mut self, u_before: &[f64; MAX_INPUTS]) {
        let y = [0.0; MAX_OUTPUTS];
        let u = &u_before[..self.inputs];
        self.estimator.step(&y[..self.outputs], 0, u, u);
    }

    /// A step with a measurement; false when a value in it could not be used.
    pub(super) fn step(
        &mut self,
        measurement: &Measurement,
        u_before: &[f64; MAX_INPUTS],
        u_now: &[f64; MAX_INPUTS],
    ) -> bool {
        let mut y = [0.0; MAX_OUTPUTS];
        let mut fresh = [false; MAX_OUTPUTS];
        let (y, fresh) = (&mut y[..self.outputs], &mut fresh[..self.outputs]);
        let clean = self.map.read(measurement, y, fresh);
        let valid = fresh.iter().enumerate().fold(0, |bits, (i, f)| bits | u64::from(*f) << i);
        self.estimator.step(y, valid, &u_before[..self.inputs], &u_now[..self.inputs]);
        clean
    }

    /// What the filter believes now.
    pub(super) fn estimate(&self, head: Head) -> Estimate {
        let e = &self.estimator;
        let mut estimate = Estimate {
            head,
            nis: e.nis(),
            dof: e.dof(),
            count: self.states as u32,
            flags: if e.converged() { flags::CONVERGED } else { 0 },
            ..Estimate::zeroed()
        };
        estimate.x[..self.states].copy_from_slice(e.x());
        estimate.std[..self.states].copy_from_slice(e.std());
        for (bias, output) in estimate.bias.iter_mut().zip(self.biases) {
            *bias = output.map_or(0.0, |i| e.bias()[i]);
        }
        estimate
    }
}

/// The filter that the estimator runs for a vehicle whose engine does as said.
///
/// # Errors
/// [`EstimatorError`].
pub fn filter_of(
    vehicle: &Vehicle,
    plant: &SampledPlant,
    options: &EstimatorOptions,
    engine: Engine,
) -> Result<Estimator, EstimatorError> {
    let linear = LinearModel::new(vehicle).map_err(|e| EstimatorError::Sensors(e.to_string()))?;
    let outputs = vehicle.outputs.iter().zip(&linear.variance);
    let sensors = Sensors {
        c: linear.c.columns(0, linear.own).into_owned(),
        d: linear.d.clone(),
        std: outputs.map(|(o, added)| o.sensor_std(engine, *added).max(LEAST_NOISE)).collect(),
        names: vehicle.outputs.iter().map(|o| o.name.clone()).collect(),
    };
    Estimator::of(plant, &sensors, Some(&linear), options)
}
