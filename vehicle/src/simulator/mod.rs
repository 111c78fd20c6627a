//! The simulator: motion of a vehicle, one step per period.
//!
//! Effects act in the following order, whatever their order in the file (those of one kind in the file's
//! order):
//!
//! 1. Command: a value that is not a number is replaced by the last one; then the vehicle's own limits and rate limit.
//! 2. Input, sample by sample: `input_gain`, `gain_drift`, `input_bias`, `dead_zone`, `input_saturation`,
//!    `rate_limit`, `backlash`; then `input_delay`, which may be any fraction of a period.
//! 3. Linear dynamics, solved exactly by the matrix exponential: `input_coupling`, `actuator_lag`,
//!    `unmodelled_mode`, then dx/dt = A x + B u with `parameter_change` and `mode_transition`; disturbances
//!    are added to dx/dt, their edges inside a step where they lie; the `sensor_lag`.
//! 4. Nonlinear dynamics around them: `quadratic_drag`, `cubic_stiffness`, `coulomb_friction`.
//! 5. Sensor: `sensor_lag`, `sensor_delay` (on the motion: C x + D u), `misalignment`, `sensor_scale`, bias
//!    (declared and `sensor_bias`), `sensor_drift`, vibration (declared and effect), noise (declared and effect),
//!    rounding (declared, then `quantization`), `output_saturation`, `dropouts`, `outliers`.
//!
//! An effect with a window acts only within it; a drift then grows from the window's beginning. No state
//! jumps there: a delay always runs and its output is used from then on, a lag or mode follows its input
//! until it acts, and matrices change at step boundaries.
//! Time t counts from the simulator's start. Before it, commands were neutral and filters at rest.
//! A `parameter_change` applies to the vehicle itself, not to the target of a `mode_transition`.

mod beyond_linear;
mod combinations;
mod compile;
mod disturbances;
mod divergence;
mod extended;
mod hammerstein;
mod inputs;
mod kernel;
mod known_steps;
mod lanes;
mod lawson;
mod limit;
mod linear_model;
mod motion;
mod nonlinear;
mod record;
mod rows;
mod schedule;
mod sensor;
mod sensors;
mod settings;
mod steady;
mod switch;
mod tap;
#[cfg(test)]
mod tests;
mod windows;

use nalgebra::DMatrix;

pub use self::beyond_linear::{Friction, InputEffects};
pub use self::hammerstein::{HammersteinModel, InputPaths};
pub use self::inputs::split as split_time;
pub use self::inputs::{Backlash, RateLimit, dead_zone};
pub use self::lanes::SimulatorLanes;
pub use self::linear_model::LinearModel;
pub use self::rows::Rows;

use self::combinations::Combinations;
use self::disturbances::Disturbances;
use self::divergence::LARGEST;
use self::extended::Extended;
use self::kernel::{Kernel, Work};
use self::limit::Limit;
use self::sensors::Sensors;
use crate::effects::{Effect, Kind, Place};
use crate::error::SimulatorError;
use crate::model::{Engine, Input, Vehicle};

/// Simulation of a vehicle: deterministic, and without allocation after construction.
///
/// At step k, [`apply`](Self::apply) the command, [`measure`](Self::measure), then
/// [`advance`](Self::advance) to step k + 1; [`step`](Self::step) is `apply` and `advance` in one.
#[derive(Debug, Clone)]
pub struct Simulator {
    n: usize,
    m: usize,
    period_s: f64,
    step: u64,
    /// The vehicle's states, those of filters and oscillators, and padding.
    z: Vec<f64>,
    work: Work<Vec<f64>>,
    /// Inputs of the linear model, then the disturbance of each state's derivative.
    drive: Vec<f64>,
    applied: Vec<f64>,
    limits: Vec<Limit>,
    /// Number of entries of `drive` that the plain dynamics use: only the inputs without disturbance.
    driven: usize,
    dynamics: Dynamics,
    disturbances: Disturbances,
    sensors: Sensors,
    engine: Engine,
    /// Index of the first state, or filter state, that diverged.
    lost: Option<usize>,
}

/// True when an effect changes the motion, not only the measurements. A lag of a sensor is integrated with
/// the states.
fn acts_on_motion((effect, place): &(Effect, Place)) -> bool {
    !matches!(place, Place::Output(_) | Place::OutputPair(..)) || effect.kind() == Kind::SensorLag
}

#[derive(Debug, Clone)]
enum Dynamics {
    /// No effect on the motion: one matrix product per step.
    Plain(Kernel),
    Extended(Box<Extended>),
}

/// The dynamics without effects: inputs, then a disturbance of every state. `None` when they overflow in one
/// period.
fn plain(vehicle: &Vehicle, period_s: f64) -> Option<Dynamics> {
    let (n, m) = vehicle.b.shape();
    let mut inputs = DMatrix::zeros(n, m + n);
    inputs.view_mut((0, 0), (n, m)).copy_from(&vehicle.b);
    inputs.view_mut((0, m), (n, n)).fill_with_identity();
    Some(Dynamics::Plain(known_steps::kernels(&vehicle.a, &inputs, period_s, 1).ok()?[0].clone()))
}

impl Simulator {
    /// A simulator of `vehicle` with the given sample period; `seed` determines all that is random.
    ///
    /// # Errors
    /// When the period is not positive, an effect does not fit the vehicle, or the model overflows in one period.
    pub fn new(vehicle: &Vehicle, period_s: f64, seed: u64) -> Result<Self, SimulatorError> {
        Self::build(vehicle, period_s, Some(seed))
    }

    /// A simulator of expected values: without noise, dropouts, outliers and turbulence, without rounding,
    /// and with every output fresh at every step. Biases, scales, lags, delays and vibration effects stay.
    /// The engine is off, so that declared vibration, whose phase is unknown in a record, is left out.
    ///
    /// # Errors
    /// As [`Simulator::new`].
    pub fn expected(vehicle: &Vehicle, period_s: f64) -> Result<Self, SimulatorError> {
        Self::build(vehicle, period_s, None)
    }

    /// A simulator as [`Simulator::expected`], for a record that begins during a motion: the commands are
    /// assumed to have been `commands`, one per input, so that delays hold them and filters are in steady
    /// state. A value that is not finite stands for the input's neutral value.
    ///
    /// # Errors
    /// As [`Simulator::new`].
    pub fn expected_from(vehicle: &Vehicle, period_s: f64, commands: &[f64]) -> Result<Self, SimulatorError> {
        let mut simulator = Self::build(vehicle, period_s, None)?;
        simulator.rest_at(commands);
        Ok(simulator)
    }

    /// Begins as [`Simulator::expected_from`] after other commands. To be called before the first step.
    pub fn rest_at(&mut self, commands: &[f64]) {
        for (i, (applied, limit)) in self.applied.iter_mut().zip(&mut self.limits).enumerate() {
            *applied = limit.rest_at(commands.get(i));
        }
        if let Dynamics::Extended(extended) = &mut self.dynamics {
            extended.rest_at(&self.applied);
        }
        self.rest();
    }

    fn build(vehicle: &Vehicle, period_s: f64, seed: Option<u64>) -> Result<Self, SimulatorError> {
        if !(period_s.is_finite() && period_s > 0.0) {
            return Err(SimulatorError::Period(period_s));
        }
        let effects = vehicle
            .effects
            .iter()
            .map(|e| Ok((e.clone(), e.resolve(vehicle)?)))
            .collect::<Result<Vec<(Effect, Place)>, SimulatorError>>()?;
        let not_finite = || SimulatorError::NotFinite { vehicle: vehicle.name.clone(), period_s };
        let combinations = Combinations::new(vehicle, &effects)?;
        let (n, m) = vehicle.b.shape();
        let system = &combinations.all[0].system;
        let padded = Kernel::padded(system.size());
        let sensors = Sensors::new(vehicle, &combinations, &effects, period_s, seed);
        let disturbances = Disturbances::new(&effects, system.oscillators.clone(), n, period_s, seed);

        let resting: Vec<f64> = vehicle.inputs.iter().map(Input::neutral).collect();
        let dynamics = if effects.iter().any(acts_on_motion) || sensors.has_delay() {
            let extended =
                Extended::new(&effects, &combinations, &resting, period_s, &sensors, &disturbances);
            Dynamics::Extended(Box::new(extended.map_err(|e| match e {
                SimulatorError::NotFinite { .. } => not_finite(),
                other => other,
            })?))
        } else {
            plain(vehicle, period_s).ok_or_else(not_finite)?
        };
        let limits = vehicle.inputs.iter().zip(&resting);
        let limits = limits.map(|(input, resting)| Limit::new(input, period_s, *resting)).collect();
        let mut simulator = Self {
            n,
            m,
            period_s,
            step: 0,
            work: Work::like(&vec![0.0; padded]),
            z: vec![0.0; padded],
            drive: vec![0.0; m + n],
            applied: resting,
            limits,
            driven: m,
            dynamics,
            disturbances,
            sensors,
            engine: if seed.is_some() { Engine::default() } else { Engine::Off },
            lost: None,
        };
        simulator.choose();
        simulator.rest();
        Ok(simulator)
    }

    /// Sets inputs to their resting values and filters to their steady state.
    fn rest(&mut self) {
        match &mut self.dynamics {
            Dynamics::Plain(_) => self.drive[..self.m].copy_from_slice(&self.applied),
            Dynamics::Extended(extended) => {
                extended.rest(&mut self.z, &mut self.drive);
                self.disturbances.set_oscillators(self.step, &mut self.z);
            }
        }
        self.sensors.fill_past(&self.z, &self.drive);
    }

    /// The vehicle's states, in its order, SI.
    pub fn state(&self) -> &[f64] {
        &self.z[..self.n]
    }

    /// Sets the vehicle's state; sensors with lag or delay are set to it as well.
    ///
    /// # Panics
    /// When `state` is not as long as the vehicle has states.
    pub fn set_state(&mut self, state: &[f64]) {
        self.z[..self.n].copy_from_slice(state);
        self.lost = None;
        if let Dynamics::Extended(extended) = &self.dynamics {
            extended.settle_sensors(&mut self.z, &self.drive);
        }
        self.sensors.fill_past(&self.z, &self.drive);
    }

    /// Begins at a later step than 0, with all time-dependent effects at that time. To be called before the
    /// first step.
    pub fn begin_at(&mut self, step: u64) {
        self.step = step;
        self.disturbances.begin_at(step);
        self.choose();
    }

    /// Changes the state by `change`, as the correction of an observer; filters and sensors keep their
    /// states.
    ///
    /// # Panics
    /// When `change` is not as long as the vehicle has states.
    pub fn correct(&mut self, change: &[f64]) {
        assert_eq!(change.len(), self.n, "one value for each state");
        self.z[..self.n].iter_mut().zip(change).for_each(|(z, c)| *z += c);
    }

    /// Sets the command of this step; to be called at most once per step. NaN is replaced by the previous
    /// value, an infinite value by the limit.
    ///
    /// # Panics
    /// When `u` is not as long as the vehicle has inputs.
    #[inline(always)]
    pub fn apply(&mut self, u: &[f64]) {
        assert_eq!(u.len(), self.m, "one value for each input");
        for ((applied, limit), &u) in self.applied.iter_mut().zip(&mut self.limits).zip(u) {
            *applied = limit.next(u, *applied);
        }
        match &mut self.dynamics {
            Dynamics::Plain(_) => self.drive[..self.m].copy_from_slice(&self.applied),
            Dynamics::Extended(extended) => {
                // The middle of the period, so that a drift has the correct mean over it.
                let t = (self.step as f64 + 0.5) * self.period_s;
                extended.command(&self.applied, t, &mut self.drive);
            }
        }
    }

    /// [`apply`](Self::apply), then [`advance`](Self::advance).
    ///
    /// # Panics
    /// When `u` is not as long as the vehicle has inputs.
    #[inline]
    pub fn step(&mut self, u: &[f64]) {
        self.apply(u);
        self.advance();
    }

    /// Measures at the current step: SI values in the order of the outputs. A stale output repeats its last
    /// value; see [`fresh`](Self::fresh). A second call at the same step returns the same values.
    pub fn measure(&mut self) -> &[f64] {
        self.sensors.measure(self.step, self.engine, &self.z, &self.drive)
    }

    /// True for each output that was new in the last [`measure`](Self::measure).
    pub fn fresh(&self) -> &[bool] {
        self.sensors.fresh()
    }

    /// Writes C x + D u, without sensors, into `out`.
    pub fn ideal_outputs(&self, out: &mut [f64]) {
        self.sensors.ideal(&self.z, &self.drive, out);
    }

    /// The command in force, within the vehicle's own limits and before any effect.
    pub fn applied(&self) -> &[f64] {
        &self.applied
    }

    /// True when a command in force is at one of the vehicle's limits.
    pub fn saturated(&self) -> bool {
        self.applied.iter().zip(&self.limits).any(|(u, limit)| *u <= limit.lower || *u >= limit.upper)
    }

    /// Sets the external disturbance of each state's derivative, in addition to the vehicle's own
    /// disturbances.
    ///
    /// # Panics
    /// When `derivative` is not as long as the vehicle has states.
    pub fn disturb(&mut self, derivative: &[f64]) {
        self.disturbances.set_external(self.step, derivative);
        self.drive[self.m..].copy_from_slice(derivative);
        self.driven = if derivative.iter().all(|d| *d == 0.0) { self.m } else { self.m + self.n };
    }

    /// Disturbance of each state's derivative at the current step, from effects and external.
    pub fn disturbance(&self) -> &[f64] {
        self.disturbances.acting()
    }

    /// State of the engine.
    pub fn engine(&self) -> Engine {
        self.engine
    }

    /// Sets the state of the engine, which determines the declared vibrations.
    pub fn set_engine(&mut self, engine: Engine) {
        self.engine = engine;
    }

    /// Index of the current step, from 0.
    pub fn step_index(&self) -> u64 {
        self.step
    }

    /// Time since the start, s.
    pub fn time_s(&self) -> f64 {
        self.step as f64 * self.period_s
    }

    /// True when a state has diverged.
    pub fn diverged(&self) -> bool {
        self.lost.is_some() || self.state().iter().any(|x| x.is_nan() || x.abs() >= LARGEST)
    }

    /// Index and value of the first state that is NaN or beyond its bound. A diverged filter state of an
    /// effect counts as the first state.
    pub fn beyond(&self, bounds: &[f64]) -> Option<(usize, f64)> {
        if let Some(lost) = self.lost {
            return Some((if lost < self.n { lost } else { 0 }, f64::NAN));
        }
        let mut states = self.state().iter().copied().zip(bounds).enumerate();
        states.find(|(_, (x, bound))| x.is_nan() || x.abs() > **bound).map(|(i, (x, _))| (i, x))
    }
}
