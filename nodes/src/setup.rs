//! Data that every node derives from the configuration before it opens a port.

use std::collections::BTreeMap;
use std::path::Path;

use whirlstand_bus::{BusConfig, WaitStrategy};
use whirlstand_control::SampledPlant;
use whirlstand_vehicle::{LinearModel, Vehicle};

use crate::config::{Mode, NodeConfig, RealtimeOptions, Role, SignalChange, VehicleSource};
use crate::error::NodeError;
use crate::gate::InputLimits;
use crate::signals::{OutputMap, input_limits};

/// The vehicle of a bench, with its model and signal map.
#[derive(Debug, Clone)]
pub struct Setup {
    /// Vehicle of the vehicle file, without the effects of the launch file.
    pub vehicle: Vehicle,
    /// Model of the vehicle for law and filter.
    pub model: Vehicle,
    /// Message fields of its outputs.
    pub map: OutputMap,
    /// Limits of its inputs.
    pub limits: InputLimits,
}

impl Setup {
    /// Reads and checks the vehicle and the numbers of the configuration.
    ///
    /// # Errors
    /// [`NodeError::Vehicle`], [`NodeError::NotOnBus`] or [`NodeError::Config`].
    pub fn new(config: &NodeConfig) -> Result<Self, NodeError> {
        let origin = &config.vehicle.origin;
        let mut vehicle = Vehicle::parse(&config.vehicle.text, origin)
            .map_err(|e| NodeError::Vehicle { origin: origin.clone(), reason: e.to_string() })?;
        vehicle.folder = Path::new(origin).parent().map(Into::into);
        check(config)?;
        let map = OutputMap::new(&vehicle)?;
        let limits = input_limits(&vehicle)?;
        let model = match &config.model {
            None => vehicle.clone(),
            Some(source) => Self::model_of(source, &vehicle)?,
        };
        Ok(Self { vehicle, model, map, limits })
    }

    /// The model of law and filter, which must have the signals of the vehicle.
    fn model_of(source: &VehicleSource, vehicle: &Vehicle) -> Result<Vehicle, NodeError> {
        let origin = source.origin.clone();
        let refuse = |reason: String| NodeError::Vehicle { origin: origin.clone(), reason };
        let mut model = Vehicle::parse(&source.text, &origin).map_err(|e| refuse(e.to_string()))?;
        model.folder = Path::new(&origin).parent().map(Into::into);
        if let Some(what) = model.signals_differ(vehicle) {
            return Err(refuse(format!("its {what} are not those of {}, which flies", vehicle.name)));
        }
        Ok(model)
    }

    /// The plant for laws and filters.
    ///
    /// # Errors
    /// [`NodeError::Design`] for a vehicle that cannot be controlled at this period.
    pub fn control_plant(&self, config: &NodeConfig) -> Result<SampledPlant, NodeError> {
        Self::plant_of(&self.model, Self::period_s(config))
    }

    /// The plant of any vehicle for laws and filters, whether or not the bus has its outputs.
    ///
    /// # Errors
    /// [`NodeError::Design`] for a vehicle that cannot be controlled at this period.
    pub fn plant_of(v: &Vehicle, period_s: f64) -> Result<SampledPlant, NodeError> {
        let limits = v
            .inputs
            .iter()
            .map(|i| whirlstand_control::InputLimits { lower: i.lower, upper: i.upper, rate: i.rate_limit })
            .collect();
        let states = v.states.iter().map(|s| s.name.clone()).collect();
        let inputs = v.inputs.iter().map(|i| i.name.clone()).collect();
        let refuse = |reason: String| NodeError::Design {
            what: "a control loop".into(),
            vehicle: v.name.clone(),
            reason,
        };
        let linear = LinearModel::new(v).map_err(|e| refuse(e.to_string()))?;
        SampledPlant::of(&linear, period_s)
            .and_then(|p| p.with_limits(limits))
            .and_then(|p| p.with_names(states, inputs))
            .map_err(|e| refuse(e.to_string()))
    }

    /// Error of a failed design.
    pub(crate) fn refuse(&self, what: &str, reason: &dyn std::fmt::Display) -> NodeError {
        let vehicle = self.vehicle.name.clone();
        NodeError::Design { what: what.into(), vehicle, reason: reason.to_string() }
    }

    /// Period of the loop, s.
    pub fn period_s(config: &NodeConfig) -> f64 {
        config.period_ns as f64 * 1e-9
    }

    /// Configuration with which a node of this bench joins the bus.
    pub fn bus_config(config: &NodeConfig, role: Role) -> BusConfig {
        BusConfig {
            bench: config.bench.clone(),
            node: role.name().into(),
            transport: config.transport,
            zenoh: config.zenoh.clone(),
            wait: match config.mode {
                Mode::Lockstep => WaitStrategy::lockstep(),
                Mode::Realtime if shares_cpu(&config.realtime, role) => WaitStrategy::taking_turns(),
                Mode::Realtime => WaitStrategy::realtime(),
            },
        }
    }
}

/// True when the node runs on one CPU, which another node has too: while it polls there, the other cannot answer.
fn shares_cpu(realtime: &BTreeMap<Role, RealtimeOptions>, role: Role) -> bool {
    let cpu = |options: &RealtimeOptions| match options.cpus[..] {
        [cpu] => Some(cpu),
        _ => None,
    };
    let Some(own) = realtime.get(&role).and_then(cpu) else { return false };
    realtime.iter().any(|(other, options)| *other != role && cpu(options) == Some(own))
}

/// First step at which something that begins at `at_s` is in force: the first whose time is not before it. A
/// time within a billionth of a period of a step belongs to that step.
pub(crate) fn step_at(at_s: f64, period_ns: u64) -> u64 {
    (at_s * 1e9 / period_ns as f64 - 1e-9).ceil().max(0.0) as u64
}

fn check(config: &NodeConfig) -> Result<(), NodeError> {
    let wrong = |field: &str, value: String, reason: &str| {
        Err(NodeError::Config { field: field.into(), value, reason: reason.into() })
    };
    if config.period_ns == 0 {
        return wrong("period_ns", "0".into(), "a step must take time");
    }
    if config.steps == 0 {
        return wrong("steps", "0".into(), "a run has at least one step");
    }
    let answer = config.plant.answer_timeout_s.map(|value| ("plant.answer_timeout_s", value));
    for (field, value) in [("start_timeout_s", config.start_timeout_s)].into_iter().chain(answer) {
        if !(value > 0.0 && value <= 86_400.0) {
            return wrong(field, value.to_string(), "a time limit lies between 0 and 86400 s");
        }
    }
    if config.plant.misses_to_failsafe == 0 {
        return wrong("plant.misses_to_failsafe", "0".into(), "the failsafe needs at least one miss");
    }
    for (field, changes) in [("setpoint", &config.setpoint), ("stick", &config.stick)] {
        check_changes(field, changes)?;
    }
    Ok(())
}

fn check_changes(field: &str, changes: &[SignalChange]) -> Result<(), NodeError> {
    let wrong = |value: String, reason: &str| {
        Err(NodeError::Config { field: field.into(), value, reason: reason.into() })
    };
    let mut before = 0.0;
    for change in changes {
        if !change.at_s.is_finite() || change.at_s < before {
            return wrong(format!("at_s {}", change.at_s), "times are at least 0 and do not go back");
        }
        before = change.at_s;
        if let Some((name, value)) = change.values.iter().find(|(_, v)| !v.is_finite()) {
            return wrong(format!("{name} {value}"), "values are finite");
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_fall_on_the_step_that_a_reader_expects() {
        assert_eq!(step_at(0.0, 5_000_000), 0);
        assert_eq!(step_at(6.0, 5_000_000), 1200);
        assert_eq!(step_at(0.1 + 0.2, 100_000_000), 3, "rounding does not cost a step");
        assert_eq!(step_at(0.0051, 5_000_000), 2);
    }

    #[test]
    fn turns_are_taken_on_a_cpu_that_two_nodes_have_alone() {
        let on = |cpus: &[usize]| RealtimeOptions { cpus: cpus.to_vec(), ..RealtimeOptions::default() };
        let nodes = |cpus: [&[usize]; 3]| -> BTreeMap<Role, RealtimeOptions> {
            [Role::Plant, Role::Estimator, Role::Controller].into_iter().zip(cpus.map(on)).collect()
        };
        let shared = nodes([&[1], &[1], &[0]]);
        assert!(shares_cpu(&shared, Role::Plant) && shares_cpu(&shared, Role::Estimator));
        assert!(!shares_cpu(&shared, Role::Controller) && !shares_cpu(&shared, Role::Recorder));
        let free = nodes([&[0, 1], &[0, 1], &[]]);
        assert!(!shares_cpu(&free, Role::Plant) && !shares_cpu(&free, Role::Controller));
    }
}
