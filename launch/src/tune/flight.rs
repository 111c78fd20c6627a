//! One flight of one law, in this process and without a bus: the loop of the bench, step by step.

use whirlstand_control::{Controller, Design, Estimator, EstimatorError};
use whirlstand_evaluate::Flight;
use whirlstand_nodes::config::{LawKind, NodeConfig};
use whirlstand_nodes::controller::controller_of;
use whirlstand_nodes::estimator::filter_of;
use whirlstand_nodes::setup::Setup;
use whirlstand_vehicle::{Simulator, SimulatorError, Vehicle};

use crate::error::Failure;

/// A law with its filter, designed for a model of the vehicle.
pub(super) struct Pilot {
    /// What it was designed as; none for the stick alone.
    pub design: Option<Design>,
    controller: Option<Controller>,
    estimator: Estimator,
}

impl Pilot {
    /// Designs law and filter for `model` as the bench does.
    pub fn new(config: &NodeConfig, model: &Vehicle, law: LawKind) -> Result<Self, Failure> {
        let plant = Setup::plant_of(model, Setup::period_s(config)).map_err(Failure::mend)?;
        let mut controller = config.controller.clone();
        controller.law = law;
        let design = match controller.options() {
            None => None,
            Some(options) => Some(Design::new(&plant, &options).map_err(|e| {
                Failure::Mend(format!("{} cannot be designed for {}: {e}", options.name(), model.name))
            })?),
        };
        let refuse = |e: EstimatorError| Failure::Mend(format!("no filter for {}: {e}", model.name));
        let estimator =
            filter_of(model, &plant, &config.estimator, config.plant.engine.into()).map_err(refuse)?;
        let controller = design.as_ref().map(|design| {
            controller_of(design, &controller, model)
                .map_err(|e| Failure::Mend(format!("{}: {e}", model.name)))
        });
        Ok(Self { controller: controller.transpose()?, design, estimator })
    }

    /// The filter.
    pub fn estimator(&self) -> &Estimator {
        &self.estimator
    }
}

/// What a flight came to.
pub(super) struct Flown {
    /// Its signals, until a state left the model.
    pub flight: Flight,
    /// A state left the model.
    pub lost: bool,
}

/// Flies `truth` as the launch file says: its start, setpoints and stick.
pub(super) fn fly(
    pilot: &Pilot,
    truth: &Vehicle,
    config: &NodeConfig,
    seed: u64,
) -> Result<Flown, SimulatorError> {
    let period_s = Setup::period_s(config);
    let (n, m) = (truth.states.len(), truth.inputs.len());
    let mut simulator = Simulator::new(truth, period_s, seed)?;
    simulator.set_engine(config.plant.engine.into());
    let initial = |name: &str| config.plant.initial.get(name).copied().unwrap_or(0.0);
    let start: Vec<f64> = truth.states.iter().map(|s| initial(&s.name)).collect();
    simulator.set_state(&start);
    let bounds = truth.state_bounds(&start);
    let (mut controller, mut estimator) = (pilot.controller.clone(), pilot.estimator.clone());
    let mut flight = Flight { period_s, ..Flight::default() };
    let mut profile = Profile::new(config, truth);
    let mut command: Vec<f64> = truth.inputs.iter().map(whirlstand_vehicle::Input::neutral).collect();
    let mut before = command.clone();
    for k in 0..config.steps {
        simulator.apply(&command);
        flight.states.extend_from_slice(simulator.state());
        flight.inputs.extend_from_slice(simulator.applied());
        flight.disturbance.extend_from_slice(simulator.disturbance());
        let y = simulator.measure().to_vec();
        let fresh = simulator.fresh().iter().enumerate().fold(0u64, |bits, (i, f)| bits | u64::from(*f) << i);
        estimator.step(&y, fresh, &before, &command);
        before.copy_from_slice(&command);
        profile.advance(k);
        flight.wanted.extend(profile.wanted());
        match &mut controller {
            None => command.copy_from_slice(&profile.stick),
            Some(controller) => {
                if config.controller.add_stick {
                    controller.set_test_input(&profile.stick);
                }
                controller.step(estimator.x(), &profile.reference[..n], profile.tracked, &mut command[..m]);
            }
        }
        simulator.advance();
        if simulator.beyond(&bounds).is_some() {
            return Ok(Flown { flight, lost: true });
        }
    }
    Ok(Flown { flight, lost: false })
}

/// The launch file's setpoints and stick, forwards in time.
struct Profile {
    /// Step, whether of a state, index and value; in the order of time.
    changes: Vec<(u64, bool, usize, f64)>,
    next: usize,
    reference: Vec<f64>,
    tracked: u64,
    stick: Vec<f64>,
}

impl Profile {
    fn new(config: &NodeConfig, vehicle: &Vehicle) -> Self {
        let step = |at_s: f64| (at_s * 1e9 / config.period_ns as f64 - 1e-9).ceil().max(0.0) as u64;
        let mut changes = Vec::new();
        for change in &config.setpoint {
            for (name, value) in &change.values {
                changes.extend(vehicle.state_index(name).map(|i| (step(change.at_s), true, i, *value)));
            }
        }
        let tracked = changes.iter().fold(0, |bits, c: &(u64, bool, usize, f64)| bits | 1 << c.2);
        for change in &config.stick {
            for (name, value) in &change.values {
                changes.extend(vehicle.input_index(name).map(|i| (step(change.at_s), false, i, *value)));
            }
        }
        changes.sort_by_key(|c| c.0);
        let (reference, stick) = (vec![0.0; vehicle.states.len()], vec![0.0; vehicle.inputs.len()]);
        Self { changes, next: 0, reference, tracked, stick }
    }

    fn advance(&mut self, k: u64) {
        while let Some(&(_, of_state, i, value)) = self.changes.get(self.next).filter(|c| c.0 <= k) {
            if of_state {
                self.reference[i] = value;
            } else {
                self.stick[i] = value;
            }
            self.next += 1;
        }
    }

    fn wanted(&self) -> impl Iterator<Item = f64> {
        let tracked = self.tracked;
        self.reference.iter().enumerate().map(move |(i, v)| if tracked >> i & 1 == 1 { *v } else { f64::NAN })
    }
}
