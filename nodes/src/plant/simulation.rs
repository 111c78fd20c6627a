//! The simulated vehicle with its publishers.

use whirlstand_bus::{Bus, Publisher};
use whirlstand_msgs::{Disturbance, Head, Imu, MAX_OUTPUTS, MAX_STATES, Message, Odometry, Outputs, Truth};
use whirlstand_vehicle::{Simulator, Vehicle};

use super::outside::Outside;
use crate::config::NodeConfig;
use crate::error::NodeError;
use crate::gate::Applied;
use crate::setup::Setup;
use crate::signals::{Measurement, OutputMap};

pub(super) struct Simulation {
    simulator: Simulator,
    map: OutputMap,
    states: usize,
    inputs: usize,
    outputs: usize,
    period_ns: u64,
    imu: Publisher<Imu>,
    odometry: Option<Publisher<Odometry>>,
    numbered: Option<Publisher<Outputs>>,
    truth: Publisher<Truth>,
    disturbance: Publisher<Disturbance>,
    /// True when truth and disturbance are published.
    telemetry: bool,
    always_telemetry: bool,
    outside: Outside,
    published: Option<[f64; MAX_STATES]>,
    /// Measurement of the current step, made in advance unless it contains the input of the same time.
    measured: Option<Measurement>,
    feedthrough: bool,
    /// Last published measurement.
    last: Measurement,
    /// The vehicle, and the bounds of its states.
    vehicle: Vehicle,
    bounds: Vec<f64>,
}

impl Simulation {
    pub(super) fn open(bus: &Bus, config: &NodeConfig, setup: &Setup) -> Result<Self, NodeError> {
        let (simulator, bounds) = simulated(config, setup)?;
        let vehicle = setup.vehicle.clone();
        let odometry = if setup.map.has_odometry() { Some(bus.publisher()?) } else { None };
        let numbered = if setup.map.has_outputs() { Some(bus.publisher()?) } else { None };
        Ok(Self {
            simulator,
            map: setup.map.clone(),
            states: vehicle.states.len(),
            inputs: setup.limits.count,
            outputs: vehicle.outputs.len(),
            period_ns: config.period_ns,
            imu: bus.publisher()?,
            odometry,
            numbered,
            truth: bus.publisher()?,
            disturbance: bus.publisher()?,
            telemetry: config.telemetry,
            always_telemetry: config.telemetry,
            outside: Outside::open(bus, config.plant.inject, bounds.clone(), config.period_ns)?,
            published: None,
            measured: None,
            feedthrough: vehicle.d.iter().any(|v| *v != 0.0),
            last: Measurement::zeroed(),
            bounds,
            vehicle,
        })
    }

    /// Publishes the messages of step `step`, with the measurement last, as the others wait for it.
    pub(super) fn publish(&mut self, step: u64, applied: &Applied) -> Result<(), NodeError> {
        let head = Head { seq: 0, step, stamp_ns: step * self.period_ns };
        let measured = step + u64::from(self.measured.is_some());
        self.outside.act(head, measured, &mut self.simulator)?;
        self.simulator.apply(&applied.u[..self.inputs]);
        if self.telemetry {
            self.publish_truth(head, applied.flags)?;
        }
        let mut measured = self.measured.take().unwrap_or_else(|| self.measure());
        measured.set_head(head);
        measured.imu.flags = applied.flags;
        self.last = measured;
        if let Some(publisher) = &mut self.odometry {
            publisher.send(&measured.odometry)?;
        }
        if let Some(publisher) = &mut self.numbered {
            publisher.send(&measured.outputs)?;
        }
        Ok(self.imu.send(&measured.imu)?)
    }

    fn measure(&mut self) -> Measurement {
        let mut y = [0.0; MAX_OUTPUTS];
        let y = &mut y[..self.outputs];
        y.copy_from_slice(self.simulator.measure());
        self.map.fill(y, self.simulator.fresh())
    }

    /// Publishes the last measurement again, for a peer that was not running yet, or whose answer was lost.
    pub(super) fn repeat_measurement(&mut self) -> Result<(), NodeError> {
        if let Some(publisher) = &mut self.odometry {
            publisher.send_again(&self.last.odometry)?;
        }
        if let Some(publisher) = &mut self.numbered {
            publisher.send_again(&self.last.outputs)?;
        }
        Ok(self.imu.send_again(&self.last.imu)?)
    }

    /// Advances the vehicle by one period, and measures while the others work unless the measurement contains
    /// the next input.
    pub(super) fn integrate(&mut self) {
        self.simulator.advance();
        if !self.feedthrough {
            self.measured = Some(self.measure());
        }
    }

    /// Error when the vehicle's state has left its model.
    pub(super) fn left_model(&self) -> Option<NodeError> {
        diverged(&self.simulator, &self.bounds, &self.vehicle)
    }

    /// Work between steps, the last of which is `step`: answers requests from outside, and checks whether
    /// truth and disturbance have subscribers, where the run itself does not need them.
    pub(super) fn attend(&mut self, step: u64) -> Result<(), NodeError> {
        self.outside.attend(Head { seq: 0, step, stamp_ns: step * self.period_ns })?;
        if !self.always_telemetry {
            self.telemetry = self.truth.has_subscribers()? || self.disturbance.has_subscribers()?;
        }
        Ok(())
    }

    /// True when the end of the run was requested from outside.
    pub(super) fn is_to_end(&self) -> bool {
        self.outside.is_to_end()
    }

    /// Number of unusable messages from outside.
    pub(super) fn refused(&self) -> u64 {
        self.outside.refused()
    }

    fn publish_truth(&mut self, head: Head, flags: u32) -> Result<(), NodeError> {
        let mut truth =
            Truth { head, states: self.states as u32, inputs: self.inputs as u32, flags, ..Truth::zeroed() };
        truth.x[..self.states].copy_from_slice(self.simulator.state());
        truth.u[..self.inputs].copy_from_slice(self.simulator.applied());
        self.truth.send(&truth)?;
        let mut dx = [0.0; MAX_STATES];
        dx[..self.states].copy_from_slice(self.simulator.disturbance());
        if self.published != Some(dx) {
            self.published = Some(dx);
            let message = Disturbance { head, dx, count: self.states as u32, reserved: 0 };
            self.disturbance.send(&message)?;
        }
        Ok(())
    }
}

/// The vehicle with the effects of the launch file, in its initial state, and the bounds of its states.
///
/// # Errors
/// [`NodeError::Vehicle`] for an effect that does not fit, [`NodeError::Config`] for a state that the vehicle does not have.
pub(crate) fn simulated(config: &NodeConfig, setup: &Setup) -> Result<(Simulator, Vec<f64>), NodeError> {
    let mut vehicle = setup.vehicle.clone();
    let wrong = |reason: String| NodeError::Vehicle { origin: config.vehicle.origin.clone(), reason };
    for effect in &config.effects {
        vehicle.add_effect(effect.clone()).map_err(|e| wrong(e.to_string()))?;
    }
    let mut simulator =
        Simulator::new(&vehicle, Setup::period_s(config), config.seed).map_err(|e| wrong(e.to_string()))?;
    simulator.set_engine(config.plant.engine.into());
    let mut x = vec![0.0; vehicle.states.len()];
    for (name, &value) in &config.plant.initial {
        let i = vehicle.state_index(name).ok_or_else(|| NodeError::Config {
            field: format!("plant.initial.{name}"),
            value: value.to_string(),
            reason: format!(
                "the vehicle's states are {}",
                vehicle.states.iter().map(|s| s.name.as_str()).collect::<Vec<_>>().join(", ")
            ),
        })?;
        x[i] = value;
    }
    simulator.set_state(&x);
    let bounds = vehicle.state_bounds(&x);
    Ok((simulator, bounds))
}

/// Error when the vehicle's state has left its model.
pub(crate) fn diverged(simulator: &Simulator, bounds: &[f64], vehicle: &Vehicle) -> Option<NodeError> {
    let (i, value) = simulator.beyond(bounds)?;
    Some(NodeError::Diverged {
        vehicle: vehicle.name.clone(),
        state: vehicle.states[i].name.clone(),
        value,
        bound: bounds[i],
        step: simulator.step_index(),
        time_s: simulator.time_s(),
    })
}
