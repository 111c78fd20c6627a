//! What is flown: the names, units and limits that every viewer needs once.

use serde::{Deserialize, Serialize};
use whirlstand_logs::shown::{shown_factor, shown_unit};
use whirlstand_vehicle::Vehicle;

/// A signal as it is shown.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Signal {
    pub name: String,
    /// Unit in which it is shown.
    pub unit: String,
    /// How many of it one SI unit is.
    pub factor: f64,
    /// Unit of its derivative.
    pub derivative_unit: String,
    /// Least and greatest value, in the unit that is shown; none where nothing limits it.
    pub limits: Option<(f64, f64)>,
}

impl Signal {
    fn new(name: &str, si: &str, lower: f64, upper: f64) -> Self {
        let factor = shown_factor(si);
        let limited = lower.is_finite() && upper.is_finite();
        let limits = limited.then_some((lower * factor, upper * factor));
        let unit = shown_unit(si);
        Self { name: name.into(), derivative_unit: per_second(&unit), unit, factor, limits }
    }
}

fn per_second(unit: &str) -> String {
    match (unit.is_empty(), unit.strip_suffix("/s")) {
        (true, _) => "1/s".into(),
        (_, Some(before)) => format!("{before}/s^2"),
        (_, None) => format!("{unit}/s"),
    }
}

/// An effect that can be switched.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SwitchedEffect {
    /// Its number, from 1, those of the vehicle file first.
    pub number: u32,
    /// What and where it is.
    pub text: String,
}

impl SwitchedEffect {
    /// Those of a vehicle with all its effects.
    pub fn all(vehicle: &Vehicle) -> Vec<Self> {
        let numbered = (1..).zip(&vehicle.effects).filter(|(_, effect)| !effect.window().is_always());
        let text = |e: &whirlstand_vehicle::Effect| format!("{} at {}", e.kind(), e.place());
        numbered.map(|(number, effect)| Self { number, text: text(effect) }).collect()
    }
}

/// Which controls a viewer has.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Controls {
    /// None: the page only shows.
    Nothing,
    /// Those of a running bench.
    Bench {
        /// Why the plant takes nothing from outside; `None` when it does.
        plant_closed: Option<String>,
        /// Why the controller takes nothing from outside; `None` when it does.
        controller_closed: Option<String>,
    },
    /// Those of a finished log: speed, pause, place.
    Log,
}

/// What is flown.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scene {
    /// What the page is called: the bench or the log.
    pub title: String,
    /// A line below it.
    pub subtitle: String,
    /// Period of the loop, s.
    pub period_s: f64,
    /// Which controls there are.
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
        let si = |unit: &whirlstand_vehicle::SignalUnit| unit.unit().si_symbol();
        let free = (f64::NEG_INFINITY, f64::INFINITY);
        Self {
            title: title.into(),
            subtitle: subtitle.into(),
            period_s: period_ns as f64 * 1e-9,
            controls,
            effects: SwitchedEffect::all(vehicle),
            states: states.map(|(s, bound)| Signal::new(&s.name, &si(&s.unit), -bound, bound)).collect(),
            inputs: vehicle
                .inputs
                .iter()
                .map(|i| Signal::new(&i.name, &si(&i.unit), i.lower, i.upper))
                .collect(),
            outputs: vehicle
                .outputs
                .iter()
                .map(|o| Signal::new(&o.name, &si(&o.unit), free.0, free.1))
                .collect(),
        }
    }
}
