//! Simulated test flights with a controller in the loop.

use whirlstand_control::{Controller, Estimator};
use whirlstand_vehicle::{Simulator, SimulatorError, Vehicle};

/// The controller in the loop, and where the test signal enters.
#[derive(Debug, Clone)]
pub struct ClosedLoop {
    /// Name of the law, as in a launch file.
    pub law: String,
    /// The law, at its initial state.
    pub controller: Controller,
    /// The estimator that feeds the law, at its initial state.
    pub estimator: Estimator,
    /// Point at which the test signal enters.
    pub through: InjectionPoint,
}

/// Point at which the test signal enters the loop.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum InjectionPoint {
    /// The test signals are added to the command: one signal per input.
    Command,
    /// The test signals are added to the setpoint: one signal for each of the states with these indices.
    Setpoint(Vec<usize>),
}

/// Signals of a simulated flight, steps x signals, row after row.
#[derive(Debug, Clone, PartialEq)]
pub struct FlightData {
    /// Applied inputs, steps x inputs, SI.
    pub inputs: Vec<f64>,
    /// Outputs, steps x outputs, SI.
    pub outputs: Vec<f64>,
    /// True when the simulation diverged.
    pub diverged: bool,
}

/// Simulates test signals without noise, with the timing of the bench; `closed` is the controller in the
/// loop, if any.
///
/// # Errors
/// When the vehicle cannot be simulated.
pub fn fly(
    vehicle: &Vehicle,
    period_s: f64,
    signals: &[Vec<f64>],
    closed: Option<&ClosedLoop>,
) -> Result<FlightData, SimulatorError> {
    match closed {
        None => open(vehicle, period_s, signals),
        Some(closed) => closed.fly(vehicle, period_s, signals),
    }
}

fn open(vehicle: &Vehicle, period_s: f64, signals: &[Vec<f64>]) -> Result<FlightData, SimulatorError> {
    let mut simulator = Simulator::expected(vehicle, period_s)?;
    let steps = signals.first().map_or(0, Vec::len);
    let inputs: Vec<f64> = (0..steps).flat_map(|k| signals.iter().map(move |s| s[k])).collect();
    let mut outputs = vec![0.0; steps * vehicle.outputs.len()];
    simulator.run(&inputs, &mut outputs);
    Ok(FlightData { inputs, outputs, diverged: simulator.diverged() })
}

impl ClosedLoop {
    /// Step j: the command of step j - 1 is applied, sensors are read, filter and law compute command j.
    fn fly(
        &self,
        vehicle: &Vehicle,
        period_s: f64,
        signals: &[Vec<f64>],
    ) -> Result<FlightData, SimulatorError> {
        let mut simulator = Simulator::expected(vehicle, period_s)?;
        let (mut controller, mut estimator) = (self.controller.clone(), self.estimator.clone());
        let (n, m, p) = (vehicle.states.len(), vehicle.inputs.len(), vehicle.outputs.len());
        let steps = signals.first().map_or(0, Vec::len);
        let mut flown = FlightData {
            inputs: Vec::with_capacity(steps * m),
            outputs: Vec::with_capacity(steps * p),
            diverged: false,
        };
        let tracked = match &self.through {
            InjectionPoint::Command => 0,
            InjectionPoint::Setpoint(states) => states.iter().fold(0u64, |bits, i| bits | 1 << i),
        };
        let mut reference = vec![0.0; n];
        let mut added = vec![0.0; m];
        let mut command: Vec<f64> = vehicle.inputs.iter().map(whirlstand_vehicle::Input::neutral).collect();
        let mut before = command.clone();
        for k in 0..steps {
            simulator.apply(&command);
            let y = simulator.measure();
            flown.outputs.extend_from_slice(y);
            let fresh = vehicle.outputs.iter().enumerate();
            let fresh = fresh.filter(|(_, o)| (k as u64).is_multiple_of(u64::from(o.every)));
            let fresh = fresh.fold(0u64, |bits, (i, _)| bits | 1 << i);
            estimator.step(y, fresh, &before, &command);
            flown.inputs.extend_from_slice(simulator.applied());
            before.copy_from_slice(simulator.applied());
            match &self.through {
                InjectionPoint::Command => {
                    added.iter_mut().zip(signals).for_each(|(a, s)| *a = s[k]);
                    controller.set_test_input(&added);
                }
                InjectionPoint::Setpoint(states) => {
                    states.iter().zip(signals).for_each(|(i, s)| reference[*i] = s[k]);
                }
            }
            controller.step(estimator.x(), &reference, tracked, &mut command);
            simulator.advance();
        }
        flown.diverged = simulator.diverged();
        Ok(flown)
    }
}
