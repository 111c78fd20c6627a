//! The scene: the names, units and limits that every viewer needs once.

use serde::{Deserialize, Serialize};
use whirlstand_logs::{BenchInfo, SignalInfo};
use whirlstand_vehicle::{SignalUnit, Vehicle};

/// A signal with the unit in which it is shown.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Signal {
    pub name: String,
    /// Unit in which it is shown.
    pub unit: String,
    /// Factor from the SI unit to the unit that is shown.
    pub factor: f64,
    /// Unit of its derivative.
    pub derivative_unit: String,
    /// Least and greatest value, in the unit that is shown; `None` without limits.
    pub limits: Option<(f64, f64)>,
}

impl Signal {
    fn new(name: &str, unit: &SignalUnit, lower: f64, upper: f64) -> Self {
        let unit = unit.shown();
        let factor = unit.factor();
        let limited = lower.is_finite() && upper.is_finite();
        let limits = limited.then_some((lower * factor, upper * factor));
        let derivative_unit = unit.per_second().to_string();
        Self { name: name.into(), derivative_unit, unit: unit.to_string(), factor, limits }
    }
}

/// An effect that can be switched.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SwitchedEffect {
    /// Number of the effect, from 1, those of the vehicle file first.
    pub number: u32,
    /// Kind and location of the effect in words.
    pub text: String,
}

impl SwitchedEffect {
    /// The switchable effects of a vehicle that includes all effects.
    pub fn all(vehicle: &Vehicle) -> Vec<Self> {
        let numbered = (1..).zip(&vehicle.effects).filter(|(_, effect)| !effect.window().is_always());
        numbered.map(|(number, effect)| Self { number, text: effect.told() }).collect()
    }
}

/// The controls of a viewer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Controls {
    /// No controls: the page only shows.
    Nothing,
    /// The controls of a running bench.
    Bench {
        /// Reason why the plant accepts no change from outside; `None` when it does.
        plant_closed: Option<String>,
        /// Reason why the controller accepts no change from outside; `None` when it does.
        controller_closed: Option<String>,
    },
    /// The controls of a finished log: speed, pause, position.
    Log,
}

/// Description of the bench or log that is shown.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scene {
    /// Title of the page: the bench or the log.
    pub title: String,
    /// Line below the title.
    pub subtitle: String,
    /// Period of the loop, s.
    pub period_s: f64,
    /// The controls of the viewers.
    pub controls: Controls,
    /// Effects that can be switched.
    pub effects: Vec<SwitchedEffect>,
    pub(crate) states: Vec<Signal>,
    pub(crate) inputs: Vec<Signal>,
    pub(crate) outputs: Vec<Signal>,
}

impl Scene {
    /// The scene of a vehicle.
    pub fn new(title: &str, subtitle: &str, period_ns: u64, vehicle: &Vehicle, controls: Controls) -> Self {
        let bounds = vehicle.state_bounds(&vec![0.0; vehicle.states.len()]);
        let states = vehicle.states.iter().zip(bounds);
        let free = (f64::NEG_INFINITY, f64::INFINITY);
        Self {
            title: title.into(),
            subtitle: subtitle.into(),
            period_s: period_ns as f64 * 1e-9,
            controls,
            effects: SwitchedEffect::all(vehicle),
            states: states.map(|(s, bound)| Signal::new(&s.name, &s.unit, -bound, bound)).collect(),
            inputs: vehicle.inputs.iter().map(|i| Signal::new(&i.name, &i.unit, i.lower, i.upper)).collect(),
            outputs: vehicle.outputs.iter().map(|o| Signal::new(&o.name, &o.unit, free.0, free.1)).collect(),
        }
    }
}

/// The data with which a bench's messages are interpreted: names of the vehicle's signals, and the period.
pub(crate) fn bench_info(vehicle: &Vehicle, period_ns: u64) -> BenchInfo {
    let signal = |name: &str, unit: &SignalUnit| SignalInfo::of(name, &unit.shown());
    BenchInfo {
        vehicle: vehicle.name.clone(),
        period_ns,
        states: vehicle.states.iter().map(|s| signal(&s.name, &s.unit)).collect(),
        inputs: vehicle.inputs.iter().map(|s| signal(&s.name, &s.unit)).collect(),
        outputs: vehicle.outputs.iter().map(|s| signal(&s.name, &s.unit)).collect(),
        ..BenchInfo::default()
    }
}
