//! Makes a bench that can be started from a launch file: looks up names, converts units to SI and checks
//! everything.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;
use whirlstand_bus::ZenohConfig;
use whirlstand_control::{Selector, Weights};
use whirlstand_live::{Address, AddressError};
use whirlstand_msgs::units::Unit;
use whirlstand_nodes::config::{
    NodeConfig, PlantConfig, RealtimeOptions, RecorderConfig, Role, SignalChange, VehicleSource,
};
use whirlstand_vehicle::{Effect, SignalUnit, Vehicle, check_attitude};

use super::amount::{Amount, Seconds};
use super::document::{Document, LaunchError, Step, at};
use super::expect;
use super::schema::{LaunchFile, NodeSection, RecorderSection};
use super::security::Security;
use super::wording::unknown;

/// Highest rate of the loop, Hz.
const FASTEST_HZ: f64 = 100_000.0;

/// Smallest limit on the size of a log file, bytes: each file contains the launch file and the vehicle.
const LEAST_LOG_BYTES: u64 = 50_000;

/// A bench, ready to be started.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    /// Name of the bench.
    pub name: String,
    /// The vehicle, including the launch file's effects.
    pub vehicle: Vehicle,
    /// Configuration of all nodes; the bench's name and the log's path are filled in when the bench is started.
    pub config: NodeConfig,
    /// The nodes, in the order in which they are started.
    pub nodes: Vec<PlannedNode>,
    /// Protection of the bench: who may join.
    pub security: Security,
    /// Address of the live page, if it is served.
    pub live: Option<Address>,
    /// Expectations that are checked at the end.
    pub expect: Vec<whirlstand_evaluate::Expectation>,
}

/// One node of a planned bench.
#[derive(Debug, Clone)]
pub(crate) struct PlannedNode {
    /// Name of the node.
    pub name: String,
    /// Role of the node in the loop; `None` for a further program.
    pub role: Option<Role>,
    /// Options of the node.
    pub section: NodeSection,
}

/// Checks a launch file and makes a bench of it.
///
/// # Errors
/// For keys that [`LaunchFile`] does not know, names that the vehicle does not have, and units that do not fit.
pub(crate) fn plan(document: &Document, name: &str, folder: &Path) -> Result<Plan, LaunchError> {
    let file: LaunchFile = document.read()?;
    let vehicle = Vehicle::find_from(&file.vehicle, Some(folder))
        .map_err(|e| document.error_at(at!["vehicle"], e.to_string()))?;
    let planner = Planner { document, vehicle: &vehicle };
    planner.check_numbers(&file)?;
    planner.check_names(&file)?;
    let (effects, extended) = planner.effects(file.effects.len(), file.duration_s.0)?;
    let nodes = planner.nodes(&file)?;
    let native = |role: Role| {
        let node = nodes.iter().find(|n| n.role == Some(role));
        node.is_some_and(|n| n.section.exec.is_none() && !n.section.external)
    };
    let recorded = file.recorder.enabled;
    let zenoh = planner.zenoh(&file, folder);
    let security = planner.security(&file, &zenoh, folder)?;
    let config = NodeConfig {
        bench: String::new(),
        transport: file.transport,
        zenoh,
        vehicle: VehicleSource { origin: file.vehicle.clone(), text: vehicle.source_text.clone() },
        model: planner.model(&file, folder)?,
        effects,
        mode: file.mode,
        period_ns: (1e9 / file.rate_hz).round() as u64,
        steps: (file.duration_s.0 * file.rate_hz).round() as u64,
        seed: file.seed,
        peers: Role::ALL.into_iter().filter(|r| *r != Role::Plant && native(*r)).collect(),
        start_timeout_s: start_timeout_s(&file),
        // The sensors of an autopilot are computed from the truth.
        telemetry: recorded || file.has_autopilot(),
        plant: planner.plant(&file)?,
        estimator: planner.estimator(&file)?,
        controller: file.controller.clone(),
        recorder: recorded.then(|| RecorderConfig {
            path: String::new(),
            most_runs: starts_of_the_plant(&nodes),
            launch_text: with_overrides(document),
            version: env!("CARGO_PKG_VERSION").into(),
            max_bytes: file.recorder.max_size.map(|size| size.0),
            max_duration_ns: file.recorder.max_duration.map(|length| (1e9 * length.0).round() as u64),
            segments: file.recorder.segments,
        }),
        mirror: planner.mirror(&file)?,
        setpoint: planner.changes("setpoint", &file.setpoint, true)?,
        stick: planner.changes("stick", &file.stick, false)?,
        realtime: realtime(&nodes),
        bridge: planner.bridge(&file)?,
    };
    let expect = expect::read(
        document,
        &vehicle,
        file.mode,
        config.bridge.is_some(),
        &file.expect.keys().collect::<Vec<_>>(),
    )?;
    let live = file.live.as_ref().map(|live| live.address.parse()).transpose();
    let live = live.map_err(|e: AddressError| document.error_at(at!["live", "address"], e.to_string()))?;
    let name = file.name.unwrap_or_else(|| name.into());
    Ok(Plan { name, vehicle: extended, config, nodes, security, live, expect })
}

/// An initial state of `vehicle` in SI, from the value in the launch file; `None` where that is refused.
pub(crate) fn initial_state(vehicle: &Vehicle, name: &str, written: toml::Value) -> Option<f64> {
    let document = Document::parse("", "").ok()?;
    let amount = Amount::deserialize(written).ok()?;
    Planner { document: &document, vehicle }.state_value(at![name], name, &amount).ok()
}

/// The text for the log: the file as it was read, and the overrides.
fn with_overrides(document: &Document) -> String {
    let mut text = document.text().to_string();
    for change in document.overrides() {
        text.push_str(&format!("\n# overridden: {}", change.replace('\n', " ")));
    }
    text
}

/// Most starts of the plant in a run.
fn starts_of_the_plant(nodes: &[PlannedNode]) -> u32 {
    let plant = nodes.iter().find(|n| n.role == Some(Role::Plant)).map(|n| &n.section);
    plant.map_or(1, NodeSection::starts)
}

/// Time for which the plant waits for the other nodes, s.
fn start_timeout_s(file: &LaunchFile) -> f64 {
    let usual = if file.has_autopilot() { 120.0 } else { 10.0 };
    file.plant.start_timeout_s.map_or(usual, |s| s.0)
}

fn realtime(nodes: &[PlannedNode]) -> BTreeMap<Role, RealtimeOptions> {
    let own = nodes.iter().filter(|n| n.section.exec.is_none());
    own.filter_map(|n| Some((n.role?, n.section.realtime())))
        .filter(|(_, options)| *options != RealtimeOptions::default())
        .collect()
}

/// A launch file and its vehicle, while the file is being checked.
pub(super) struct Planner<'a> {
    pub(super) document: &'a Document,
    pub(super) vehicle: &'a Vehicle,
}

impl Planner<'_> {
    fn check_numbers(&self, file: &LaunchFile) -> Result<(), LaunchError> {
        let fail = |key: &str, message: String| Err(self.document.error_at(at![key], message));
        if !(file.rate_hz > 0.0 && file.rate_hz <= FASTEST_HZ) {
            return fail(
                "rate_hz",
                format!("a rate above 0 and up to {FASTEST_HZ} Hz is expected, not {}", file.rate_hz),
            );
        }
        let steps = file.duration_s.0 * file.rate_hz;
        if !(1.0..1e15).contains(&steps) {
            return fail("duration_s", format!("the run would have {steps} steps; at least one is expected"));
        }
        if let Err(error) = whirlstand_nodes::signals::check_room(self.vehicle) {
            return fail("vehicle", error.to_string());
        }
        for (section, key, value) in [
            ("plant", "answer_timeout_s", file.plant.answer_timeout_s),
            ("plant", "start_timeout_s", Some(Seconds(start_timeout_s(file)))),
        ] {
            let Some(value) = value else { continue };
            self.check_time(at![section, key], value.0)?;
        }
        self.check_recorder(&file.recorder)?;
        if file.plant.misses_to_failsafe == 0 {
            let here = at!["plant", "misses_to_failsafe"];
            return Err(self.document.error_at(here, "at least 1 is required"));
        }
        for (i, endpoint) in file.zenoh.listen.iter().enumerate() {
            if !endpoint.ends_with(":0") {
                let message = format!(
                    "every node listens here, but only one can use the port of '{endpoint}': end it with :0, or \
                     set `listen` of one node under [nodes.NAME]"
                );
                return Err(self.document.error_at(at!["zenoh", "listen", i], message));
            }
        }
        Ok(())
    }

    /// Checks the limits of the log files.
    fn check_recorder(&self, recorder: &RecorderSection) -> Result<(), LaunchError> {
        let fail = |key: &str, message: String| Err(self.document.error_at(at!["recorder", key], message));
        if let Some(size) = recorder.max_size.filter(|size| size.0 < LEAST_LOG_BYTES) {
            return fail(
                "max_size",
                format!("at least {LEAST_LOG_BYTES} bytes are expected, not {}", size.0),
            );
        }
        if let Some(length) = recorder.max_duration {
            self.check_time(at!["recorder", "max_duration"], length.0)?;
        }
        match recorder.segments {
            Some(0) => fail("segments", "at least 1 file must be kept".into()),
            Some(_) if recorder.max_size.is_none() && recorder.max_duration.is_none() => fail(
                "segments",
                "files are never full without max_size or max_duration: set one of them".into(),
            ),
            _ => Ok(()),
        }
    }

    pub(super) fn check_time(&self, here: &[Step<'_>], value: f64) -> Result<(), LaunchError> {
        if value > 0.0 && value <= 86_400.0 {
            return Ok(());
        }
        Err(self
            .document
            .error_at(here, format!("a time above 0 and up to a day is expected, not {value} s")))
    }

    fn states(&self) -> impl Iterator<Item = &str> {
        self.vehicle.states.iter().map(|s| s.name.as_str())
    }

    fn inputs(&self) -> impl Iterator<Item = &str> {
        self.vehicle.inputs.iter().map(|s| s.name.as_str())
    }

    fn check_names(&self, file: &LaunchFile) -> Result<(), LaunchError> {
        let check = |here: &[Step<'_>], what: &str, name: &str, known: &[&str]| {
            if known.contains(&name) {
                return Ok(());
            }
            let message =
                format!("{} of the vehicle {}", unknown(what, name, known.iter().copied()), file.vehicle);
            Err(self.document.error_at(here, message))
        };
        let (law, filter) = (&file.controller, &file.estimator);
        let (states, inputs): (Vec<&str>, Vec<&str>) = (self.states().collect(), self.inputs().collect());
        let outputs: Vec<&str> = self.vehicle.outputs.iter().map(|o| o.name.as_str()).collect();
        for (table, key, weights, what, known) in [
            ("controller", "q", &law.q, "state", &states),
            ("controller", "r", &law.r, "input", &inputs),
            ("controller", "switching_gain", &law.switching_gain, "input", &inputs),
            ("controller", "boundary_layer", &law.boundary_layer, "input", &inputs),
            ("estimator", "process_noise", &filter.process_noise, "state", &states),
        ] {
            let Some(Weights::ByName(weights)) = weights else { continue };
            for name in weights.keys() {
                check(at![table, key, name], what, name, known)?;
            }
        }
        for (table, key, selectors, what, known) in [
            ("controller", "integral", Some(&law.integral), "state", &states),
            ("estimator", "bias", filter.bias.as_ref(), "output", &outputs),
            ("estimator", "outputs", filter.outputs.as_ref(), "output", &outputs),
            ("estimator", "input_bias", Some(&filter.input_bias), "input", &inputs),
        ] {
            for (i, selector) in selectors.into_iter().flatten().enumerate() {
                if let Selector::Name(name) = selector {
                    check(at![table, key, i], what, name, known)?;
                }
            }
        }
        Ok(())
    }

    fn plant(&self, file: &LaunchFile) -> Result<PlantConfig, LaunchError> {
        let section = &file.plant;
        let mut initial = BTreeMap::new();
        for (name, amount) in &section.initial {
            let value = self.state_value(at!["plant", "initial", name], name, amount)?;
            initial.insert(name.clone(), value);
        }
        Ok(PlantConfig {
            engine: section.engine,
            initial,
            misses_to_failsafe: section.misses_to_failsafe,
            answer_timeout_s: section.answer_timeout_s.map(|s| s.0),
            inject: section.inject,
        })
    }

    fn state_value(&self, here: &[Step<'_>], name: &str, amount: &Amount) -> Result<f64, LaunchError> {
        let Some(i) = self.vehicle.state_index(name) else {
            return Err(self.document.error_at(here, unknown("state", name, self.states())));
        };
        let state = &self.vehicle.states[i];
        let value = self.signal(here, name, amount, &state.unit)?;
        check_attitude(state, value)
            .map_or(Ok(value), |why| Err(self.document.error_at(here, format!("{name} {why}"))))
    }

    fn input_value(&self, here: &[Step<'_>], name: &str, amount: &Amount) -> Result<f64, LaunchError> {
        let Some(i) = self.vehicle.input_index(name) else {
            return Err(self.document.error_at(here, unknown("input", name, self.inputs())));
        };
        self.signal(here, name, amount, &self.vehicle.inputs[i].unit)
    }

    /// A value of a signal in SI. A plain number is accepted only where its unit is unambiguous.
    pub(super) fn signal(
        &self,
        here: &[Step<'_>],
        name: &str,
        amount: &Amount,
        unit: &SignalUnit,
    ) -> Result<f64, LaunchError> {
        if let Amount::Si(value) = amount
            && let Some(why) = unit.two_readings(*value)
        {
            return Err(self.document.error_at(here, format!("{name} {why}")));
        }
        self.si(here, amount, unit.unit())
    }

    fn si(&self, here: &[Step<'_>], amount: &Amount, unit: &Unit) -> Result<f64, LaunchError> {
        amount.si(unit).map_err(|e| self.document.error_at(here, e.to_string()))
    }

    /// Steps of the setpoint (by state) or of the stick (by input), which must come in time order.
    fn changes(
        &self,
        key: &str,
        entries: &[BTreeMap<String, Amount>],
        of_states: bool,
    ) -> Result<Vec<SignalChange>, LaunchError> {
        let mut changes: Vec<SignalChange> = Vec::new();
        for (i, entry) in entries.iter().enumerate() {
            let Some(at) = entry.get("at_s") else {
                return Err(self.document.error_at(at![key, i], "the key 'at_s' is missing here: add it"));
            };
            let at_s = self.si(at![key, i, "at_s"], at, &Unit::SECOND)?;
            if at_s < changes.last().map_or(0.0, |c| c.at_s) {
                let message =
                    format!("steps must be in time order, from 0 on; {at_s} s is out of order here");
                return Err(self.document.error_at(at![key, i, "at_s"], message));
            }
            let mut values = BTreeMap::new();
            for (name, amount) in entry.iter().filter(|(name, _)| *name != "at_s") {
                let here = at![key, i, name];
                let value = if of_states {
                    self.state_value(here, name, amount)?
                } else {
                    self.input_value(here, name, amount)?
                };
                values.insert(name.clone(), value);
            }
            changes.push(SignalChange { at_s, values });
        }
        Ok(changes)
    }

    /// The launch file's effects, and the vehicle with these effects.
    fn effects(&self, count: usize, duration_s: f64) -> Result<(Vec<Effect>, Vehicle), LaunchError> {
        let mut extended = self.vehicle.clone();
        let own = extended.effects.len();
        for i in 0..count {
            let here: &[_] = at!["effects", i];
            let Some(effect) = self.document.read_at::<Effect>(here)? else { continue };
            extended.add_written_effect(effect).map_err(|e| {
                let field = e.field.clone().unwrap_or_else(|| "where".into());
                self.document.error_at(at!["effects", i, &field], e.to_string())
            })?;
        }
        for (i, effect) in extended.effects.iter().enumerate() {
            effect.check_delay(duration_s, "the run").map_err(|e| match i.checked_sub(own) {
                Some(i) => self.document.error_at(at!["effects", i, "delay_s"], e.to_string()),
                None => self.document.error_at(at!["vehicle"], e.to_string()),
            })?;
        }
        Ok((extended.effects[own..].to_vec(), extended))
    }

    fn zenoh(&self, file: &LaunchFile, folder: &Path) -> ZenohConfig {
        ZenohConfig {
            listen: file.zenoh.listen.clone(),
            connect: file.zenoh.connect.clone(),
            config: file.zenoh.config.as_ref().map(|path| folder.join(path)),
            protection: None,
        }
    }
}
