//! One vehicle instance for co-simulation: variables by reference, a phase, and steps of any length.
//!
//! The vehicle moves in whole periods of its simulator. A step of the tool advances it by every period that ends
//! within the step; in between, outputs and states are held. Inputs act from the communication point at which they
//! were set.

use whirlstand_vehicle::{Simulator, Vehicle};

use crate::contents::Settings;
use crate::variables::{Variable, Variables};

/// Relative distance, as a share of the period, by which a period may end after a step and still end with it:
/// tools add up times in floating point.
const TIME_TOLERANCE: f64 = 1e-6;

/// Most periods in a step: a minute of computation on any machine, without overflow of the step counter.
const MOST_PERIODS: f64 = 1e9;

/// Phase of the instance, with the names of the standard's states.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Phase {
    Instantiated,
    Initialization,
    Step,
    Terminated,
}

/// The reason why a call is refused.
#[derive(Debug, thiserror::Error)]
pub(crate) enum CallError {
    #[error("{call} is not allowed while the FMU is in phase {phase:?}")]
    Phase { call: &'static str, phase: Phase },
    #[error("there is no variable with value reference {0} of this type")]
    Reference(u32),
    #[error("variable {0} cannot be set: inputs can, and parameters and states before the simulation starts")]
    NotSettable(u32),
    #[error("variable {reference} cannot be {value}: a finite number is expected")]
    NotFinite { reference: u32, value: f64 },
    #[error("a step from {from} s by {step} s is not possible: the FMU is at {at} s, and time must go on")]
    Time { from: f64, step: f64, at: f64 },
    #[error("state {state} is {value} at {time_s} s, beyond the bound {bound} up to which the model holds")]
    Diverged { state: String, value: f64, bound: f64, time_s: f64 },
    #[error("the vehicle cannot be simulated: {0}")]
    Simulator(#[from] whirlstand_vehicle::SimulatorError),
}

/// An instance of the FMU; a clone is a saved FMU state.
#[derive(Debug, Clone)]
pub(crate) struct Instance {
    vehicle: Vehicle,
    settings: Settings,
    variables: Variables,
    seed: u64,
    noise: bool,
    initial: Vec<f64>,
    inputs: Vec<f64>,
    outputs: Vec<f64>,
    phase: Phase,
    start_s: f64,
    time_s: f64,
    bounds: Vec<f64>,
    /// The simulator of the vehicle, from the end of initialization on.
    simulator: Option<Simulator>,
}

impl Instance {
    pub(crate) fn new(vehicle: Vehicle, settings: Settings) -> Result<Self, CallError> {
        let mut instance = Self {
            variables: Variables::of(&vehicle),
            seed: settings.seed,
            noise: true,
            initial: vec![0.0; vehicle.states.len()],
            inputs: vehicle.inputs.iter().map(whirlstand_vehicle::Input::neutral).collect(),
            outputs: vec![0.0; vehicle.outputs.len()],
            phase: Phase::Instantiated,
            start_s: 0.0,
            time_s: 0.0,
            bounds: Vec::new(),
            simulator: None,
            vehicle,
            settings,
        };
        // A vehicle that cannot be simulated is refused at once.
        instance.measured_at_start()?;
        Ok(instance)
    }

    /// Restores the initial state of the instance; the resources are not read again.
    pub(crate) fn reset(&mut self) -> Result<(), CallError> {
        *self = Self::new(self.vehicle.clone(), self.settings)?;
        Ok(())
    }

    pub(crate) fn enter_initialization(&mut self, start_s: f64) -> Result<(), CallError> {
        self.expect("fmi3EnterInitializationMode", &[Phase::Instantiated])?;
        if !start_s.is_finite() {
            return Err(CallError::Time { from: start_s, step: 0.0, at: self.time_s });
        }
        (self.start_s, self.time_s) = (start_s, start_s);
        self.phase = Phase::Initialization;
        Ok(())
    }

    pub(crate) fn exit_initialization(&mut self) -> Result<(), CallError> {
        self.expect("fmi3ExitInitializationMode", &[Phase::Initialization])?;
        self.simulator = Some(self.measured_at_start()?);
        self.bounds = self.vehicle.state_bounds(&self.initial);
        self.phase = Phase::Step;
        Ok(())
    }

    pub(crate) fn terminate(&mut self) -> Result<(), CallError> {
        self.expect("fmi3Terminate", &[Phase::Step])?;
        self.phase = Phase::Terminated;
        Ok(())
    }

    /// Time that the instance has reached, s.
    pub(crate) fn time_s(&self) -> f64 {
        self.time_s
    }

    /// Advances to `from` + `step`.
    pub(crate) fn do_step(&mut self, from: f64, step: f64) -> Result<(), CallError> {
        self.expect("fmi3DoStep", &[Phase::Step])?;
        let period_s = self.settings.period_s;
        let impossible = CallError::Time { from, step, at: self.time_s };
        let off = (from - self.time_s).abs();
        let periods = (from + step - self.start_s) / period_s;
        if !(step > 0.0 && off <= TIME_TOLERANCE * period_s && periods < MOST_PERIODS) {
            return Err(impossible);
        }
        let target = (periods + TIME_TOLERANCE).floor() as u64;
        let Some(simulator) = &mut self.simulator else { return Err(impossible) };
        while simulator.step_index() < target {
            simulator.step(&self.inputs);
            self.outputs.copy_from_slice(simulator.measure());
            if let Some((i, value)) = simulator.beyond(&self.bounds) {
                return Err(CallError::Diverged {
                    state: self.vehicle.states[i].name.clone(),
                    value,
                    bound: self.bounds[i],
                    time_s: self.start_s + simulator.time_s(),
                });
            }
        }
        self.time_s = from + step;
        Ok(())
    }

    /// Values of variables that are floating-point numbers.
    pub(crate) fn floats(&mut self, references: &[u32], values: &mut [f64]) -> Result<(), CallError> {
        if self.phase == Phase::Initialization {
            // Values set since the start appear in the first measurement.
            self.measured_at_start()?;
        }
        for (&reference, value) in references.iter().zip(values) {
            *value = match self.variables.variable(reference) {
                Some(Variable::Time) => self.time_s,
                Some(Variable::Input(i)) => self.inputs[i],
                Some(Variable::Output(i)) => self.outputs[i],
                Some(Variable::State(i)) => {
                    self.simulator.as_ref().map_or(self.initial[i], |simulator| simulator.state()[i])
                }
                _ => return Err(CallError::Reference(reference)),
            };
        }
        Ok(())
    }

    pub(crate) fn set_float(&mut self, reference: u32, value: f64) -> Result<(), CallError> {
        if !value.is_finite() {
            return Err(CallError::NotFinite { reference, value });
        }
        match self.variables.variable(reference) {
            Some(Variable::Input(i)) => self.inputs[i] = value,
            Some(Variable::State(i)) if self.is_settable() => self.initial[i] = value,
            Some(Variable::Time | Variable::Output(_) | Variable::State(_)) => {
                return Err(CallError::NotSettable(reference));
            }
            _ => return Err(CallError::Reference(reference)),
        }
        Ok(())
    }

    pub(crate) fn seed(&self, reference: u32) -> Result<u64, CallError> {
        self.of(Variable::Seed, reference).map(|()| self.seed)
    }

    pub(crate) fn set_seed(&mut self, reference: u32, seed: u64) -> Result<(), CallError> {
        self.of(Variable::Seed, reference)?;
        self.check_settable(reference)?;
        self.seed = seed;
        Ok(())
    }

    pub(crate) fn noise(&self, reference: u32) -> Result<bool, CallError> {
        self.of(Variable::Noise, reference).map(|()| self.noise)
    }

    pub(crate) fn set_noise(&mut self, reference: u32, noise: bool) -> Result<(), CallError> {
        self.of(Variable::Noise, reference)?;
        self.check_settable(reference)?;
        self.noise = noise;
        Ok(())
    }

    /// A simulator at the start, with its first measurement.
    fn measured_at_start(&mut self) -> Result<Simulator, CallError> {
        let period_s = self.settings.period_s;
        let mut simulator = match self.noise {
            true => Simulator::new(&self.vehicle, period_s, self.seed),
            false => Simulator::expected(&self.vehicle, period_s),
        }?;
        simulator.set_state(&self.initial);
        self.outputs.copy_from_slice(simulator.measure());
        Ok(simulator)
    }

    fn of(&self, variable: Variable, reference: u32) -> Result<(), CallError> {
        if self.variables.variable(reference) == Some(variable) {
            return Ok(());
        }
        Err(CallError::Reference(reference))
    }

    fn is_settable(&self) -> bool {
        matches!(self.phase, Phase::Instantiated | Phase::Initialization)
    }

    fn check_settable(&self, reference: u32) -> Result<(), CallError> {
        if self.is_settable() { Ok(()) } else { Err(CallError::NotSettable(reference)) }
    }

    fn expect(&self, call: &'static str, phases: &[Phase]) -> Result<(), CallError> {
        if phases.contains(&self.phase) {
            return Ok(());
        }
        Err(CallError::Phase { call, phase: self.phase })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_S: f64 = 0.005;

    fn started(vehicle: &Vehicle) -> Instance {
        let mut instance = Instance::new(vehicle.clone(), Settings { period_s: PERIOD_S, seed: 3 }).unwrap();
        instance.enter_initialization(0.0).unwrap();
        instance.exit_initialization().unwrap();
        instance
    }

    fn outputs(instance: &mut Instance) -> Vec<f64> {
        let count = instance.outputs.len();
        let references: Vec<u32> =
            (0..count).map(|i| instance.variables.reference(Variable::Output(i)) as u32).collect();
        let mut values = vec![0.0; count];
        instance.floats(&references, &mut values).unwrap();
        values
    }

    #[test]
    fn it_flies_as_the_simulator_does_whatever_the_length_of_a_step() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let mut simulator = Simulator::new(&vehicle, PERIOD_S, 3).unwrap();
        let mut instance = started(&vehicle);
        let u = instance.variables.reference(Variable::Input(0)) as u32;
        assert_eq!(outputs(&mut instance), simulator.measure());
        let mut at = 0.0;
        for (k, periods) in [1u32, 1, 4, 2, 7].into_iter().enumerate() {
            instance.set_float(u, k as f64).unwrap();
            let step = f64::from(periods) * PERIOD_S;
            instance.do_step(at, step).unwrap();
            at += step;
            for _ in 0..periods {
                simulator.step(&[k as f64, 0.0]);
                simulator.measure();
            }
            assert_eq!(outputs(&mut instance), simulator.measure(), "after {at} s");
        }
    }

    #[test]
    fn a_step_shorter_than_the_period_moves_nothing_until_the_period_ends() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let mut instance = started(&vehicle);
        let before = outputs(&mut instance);
        instance.do_step(0.0, PERIOD_S / 2.0).unwrap();
        assert_eq!(outputs(&mut instance), before);
        instance.do_step(PERIOD_S / 2.0, PERIOD_S / 2.0).unwrap();
        assert_ne!(outputs(&mut instance), before);
    }

    #[test]
    fn what_makes_no_sense_is_refused_with_a_reason() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let mut instance = started(&vehicle);
        let state = instance.variables.reference(Variable::State(0)) as u32;
        let input = instance.variables.reference(Variable::Input(0)) as u32;
        for (error, word) in [
            (instance.do_step(1.0, PERIOD_S), "the FMU is at 0 s"),
            (instance.do_step(0.0, -1.0), "time must go on"),
            (instance.do_step(0.0, f64::NAN), "time must go on"),
            (instance.do_step(0.0, 1e300), "is not possible"),
            (instance.set_float(state, 0.1), "before the simulation starts"),
            (instance.set_float(input, f64::NAN), "finite number"),
            (instance.set_float(1, 1.0), "no variable"),
            (instance.set_seed(1, 1), "before the simulation starts"),
            (instance.enter_initialization(0.0), "phase Step"),
        ] {
            let text = error.unwrap_err().to_string();
            assert!(text.contains(word), "{text}");
        }
    }

    #[test]
    fn a_vehicle_beyond_its_bound_ends_the_simulation() {
        let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
        vehicle.states[0].bound = Some(1e-9);
        let mut instance = started(&vehicle);
        let input = instance.variables.reference(Variable::Input(0)) as u32;
        instance.set_float(input, 5.0).unwrap();
        let error = instance.do_step(0.0, 1.0).unwrap_err().to_string();
        assert!(error.contains("beyond the bound"), "{error}");
    }
}
