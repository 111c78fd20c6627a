//! A flight without a bus: plant, filter and law call each other.
//!
//! The numbers are bit-identical to those of the same bench in lockstep over any transport: at step j command
//! j-1 is in force, the filter receives measurement j and the input that was in force before it, and the law
//! answers with command j. Messages, health, waiting and logs of the nodes are left out.

mod lanes;

use whirlstand_control::Estimator;
use whirlstand_msgs::{Command, Head, MAX_OUTPUTS, Message, Setpoint, flags};
use whirlstand_vehicle::{Simulator, Vehicle};

use crate::config::{ControllerConfig, Engine, EstimatorConfig, NodeConfig, VehicleSource};
use crate::controller::{Law, Profile};
use crate::error::NodeError;
use crate::estimator::Filter;
use crate::gate::Gate;
pub use crate::onset::Onset;
use crate::onset::airframe;
use crate::plant::simulation::diverged;
use crate::setup::Setup;

pub use lanes::{LANES, StepLanes};

/// Law and filter, designed once for all flights with the same model: flights may differ in noise,
/// disturbances, effects, initial states, setpoints.
pub struct Pilot {
    known: Known,
    setup: Setup,
    estimator: Estimator,
    law: Law,
}

/// Configuration from which law and filter are designed.
#[derive(Debug, Clone, PartialEq)]
struct Known {
    vehicle: VehicleSource,
    model: Option<VehicleSource>,
    controller: ControllerConfig,
    estimator: EstimatorConfig,
    engine: Engine,
    period_ns: u64,
}

impl Known {
    fn of(config: &NodeConfig) -> Self {
        Self {
            vehicle: config.vehicle.clone(),
            model: config.model.clone(),
            controller: config.controller.clone(),
            estimator: config.estimator.clone(),
            engine: config.plant.engine,
            period_ns: config.period_ns,
        }
    }

    fn is_of(&self, config: &NodeConfig) -> bool {
        self.period_ns == config.period_ns
            && self.engine == config.plant.engine
            && self.controller == config.controller
            && self.estimator == config.estimator
            && self.model == config.model
            && self.vehicle == config.vehicle
    }
}

/// One step of a flight, for an observer; SI.
pub struct Step<'a> {
    /// Bench time, ns.
    pub stamp_ns: u64,
    /// The true states.
    pub x: &'a [f64],
    /// Inputs in force.
    pub u: &'a [f64],
    /// `HELD` and `FAILSAFE` of [`flags`].
    pub flags: u32,
    /// Disturbance of the derivative of each state.
    pub disturbance: &'a [f64],
    /// Measured outputs.
    pub y: &'a [f64],
    /// Bit i: output i is fresh and usable.
    pub fresh: u64,
    /// Reference of the law.
    pub setpoint: &'a Setpoint,
    /// The filter after the measurement of this step.
    pub filter: &'a Estimator,
}

/// Counters as those of a bench's nodes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Number of steps done.
    pub steps: u64,
    /// Number of steps without a usable command.
    pub misses: u64,
    /// Number of commands that the plant refused or changed.
    pub rejected: u64,
    /// Number of measurements unusable for the filter, and of estimates unusable for the law.
    pub refused: [u64; 2],
}

impl Pilot {
    /// Reads the vehicle and designs law and filter.
    ///
    /// # Errors
    /// [`NodeError`] for a vehicle or configuration that cannot fly.
    pub fn new(config: &NodeConfig) -> Result<Self, NodeError> {
        let setup = Setup::new(config)?;
        let estimator = Filter::new(config, &setup)?.into_estimator();
        let law = Law::new(config, &setup)?;
        Ok(Self { known: Known::of(config), setup, estimator, law })
    }

    /// The same law and filter for a bench with another vehicle, but the same `model` for which they were
    /// designed.
    ///
    /// # Errors
    /// [`NodeError`] for a bench that would design others, and a vehicle that cannot fly.
    pub fn before(&self, config: &NodeConfig) -> Result<Self, NodeError> {
        let (setup, known) = (Setup::new(config)?, Known::of(config));
        let of_ours = Known { vehicle: self.known.vehicle.clone(), ..known.clone() };
        if config.model.is_none() || of_ours != self.known {
            return Err(setup.refuse("the same law and filter", &"the bench has others"));
        }
        Ok(Self { known, setup, estimator: self.estimator.clone(), law: self.law.clone() })
    }

    /// The same filter with the law that this bench would design for another model.
    ///
    /// # Errors
    /// [`NodeError`] for a law that cannot be designed for it.
    pub(crate) fn under_the_law_for(&self, config: &NodeConfig, model: &Vehicle) -> Result<Self, NodeError> {
        let setup = Setup { model: model.clone(), ..self.setup.clone() };
        let law = Law::new(config, &setup)?;
        Ok(Self {
            known: self.known.clone(),
            setup: self.setup.clone(),
            estimator: self.estimator.clone(),
            law,
        })
    }

    /// True when the design equals that of this bench.
    pub fn is_of(&self, config: &NodeConfig) -> bool {
        self.known.is_of(config)
    }

    /// The vehicle, without the effects of the launch file.
    pub fn vehicle(&self) -> &Vehicle {
        &self.setup.vehicle
    }

    /// Flies the bench, for which law and filter must have been designed; `each` is called for every step.
    ///
    /// # Errors
    /// [`NodeError`] for an effect or initial state that the vehicle does not have, and for a state that left the model.
    pub fn fly(&self, config: &NodeConfig, each: impl FnMut(&Step<'_>)) -> Result<Counts, NodeError> {
        self.fly_changed(config, None, each)
    }

    /// Flies as [`Self::fly`], with an effect that begins in flight.
    ///
    /// # Errors
    /// As [`Self::fly`].
    pub fn fly_changed(
        &self,
        config: &NodeConfig,
        onset: Option<&Onset>,
        mut each: impl FnMut(&Step<'_>),
    ) -> Result<Counts, NodeError> {
        self.flown(config, onset, &mut each)
    }

    /// Not generic, so that it is compiled in this optimised crate, not in the caller's.
    fn flown(
        &self,
        config: &NodeConfig,
        onset: Option<&Onset>,
        each: &mut dyn FnMut(&Step<'_>),
    ) -> Result<Counts, NodeError> {
        let setup = &self.setup;
        let (n, m) = (setup.vehicle.states.len(), setup.limits.count);
        let (mut y, outputs) = ([0.0; MAX_OUTPUTS], setup.vehicle.outputs.len());
        let (mut airframe, bounds) = airframe(config, setup, onset)?;
        let mut profile = Profile::new(config, &setup.vehicle)?;
        let (mut estimator, mut law) = (self.estimator.clone(), self.law.clone());
        let mut gate = Gate::new(setup.limits, config.plant.misses_to_failsafe);
        // An input with feed-through must be applied before the measurement.
        let shows = setup.vehicle.d.iter().any(|v| *v != 0.0);
        let believed = setup.model.d.iter().any(|v| *v != 0.0);
        let mut before = gate.applied().u;
        let mut counts = Counts::default();
        for step in 0..config.steps {
            let applied = if step == 0 { gate.applied() } else { gate.close(true) };
            airframe.apply(&applied.u[..m]);
            let (fresh, clean) = measured(&mut airframe);
            counts.refused[0] += u64::from(!clean);
            let now = if believed { applied.u } else { before };
            y[..outputs].copy_from_slice(airframe.measure());
            estimator.step(&y[..outputs], fresh, &before[..m], &now[..m]);
            let head = Head { seq: 0, step, stamp_ns: step * config.period_ns };
            let setpoint = profile.at(head);
            let mut command = Command { head, count: m as u32, ..Command::zeroed() };
            if estimator.x().iter().all(|x| x.is_finite()) {
                command.flags = law.step(step, estimator.x(), setpoint, &mut command.u);
            } else {
                counts.refused[1] += 1;
                (command.count, command.flags) = (0, flags::WITHHELD);
            }
            each(&Step {
                stamp_ns: head.stamp_ns,
                x: &airframe.state()[..n],
                u: airframe.applied(),
                flags: applied.flags,
                disturbance: airframe.disturbance(),
                y: &y[..outputs],
                fresh,
                setpoint,
                filter: &estimator,
            });
            // Faults are counted by the gate.
            let _ = gate.offer(&command, step);
            before = applied.u;
            airframe.advance();
            if !shows {
                airframe.measure();
            }
            // Step 0 is over before a bench begins to check.
            if step > 0
                && let Some(error) = diverged(&airframe, &bounds, &setup.vehicle)
            {
                return Err(error);
            }
        }
        Ok(Counts { steps: config.steps, misses: gate.misses(), rejected: gate.rejected(), ..counts })
    }
}

/// Measures; returns which outputs are fresh and usable, and whether all fresh ones are usable.
fn measured(airframe: &mut Simulator) -> (u64, bool) {
    let finite =
        airframe.measure().iter().enumerate().fold(0, |bits, (i, y)| bits | u64::from(y.is_finite()) << i);
    let fresh = airframe.fresh().iter().enumerate().fold(0, |bits, (i, f)| bits | u64::from(*f) << i);
    (fresh & finite, fresh & !finite == 0)
}
