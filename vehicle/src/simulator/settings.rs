//! Settings of a vehicle for every combination of switched effects: discretisations, delays and output rows,
//! all computed in advance, so that a step only has to select them.
//!
//! No state jumps where an effect begins or ends: the state of an inactive filter follows its signal.

use super::combinations::{Combination, Combinations};
use super::compile::Rest;
use super::inputs::split;
use super::schedule::{Schedule, Within};
use super::sensors::Sensors;
use super::switch::Switch;
use crate::effects::{Effect, Kind, Place};
use crate::error::SimulatorError;

/// Settings of one combination.
#[derive(Debug, Clone)]
pub struct Setting {
    /// Discretisations of a period.
    pub schedule: Schedule,
    /// Steady states of filters.
    pub rests: Vec<Rest>,
    /// Delay of each input: whole periods and a remainder in s.
    pub delays: Vec<(u64, f64)>,
}

/// All settings, and the index of the current one.
#[derive(Debug, Clone)]
pub struct Settings {
    period_s: f64,
    switches: Vec<Switch>,
    all: Vec<Setting>,
    now: usize,
}

impl Settings {
    /// Computes all settings.
    ///
    /// # Errors
    /// When a model overflows in one period.
    pub fn new(
        combinations: &Combinations,
        effects: &[(Effect, Place)],
        period_s: f64,
        sensors: &Sensors,
        (events, levels): (&[super::schedule::Moment], usize),
        inputs: usize,
    ) -> Result<Self, SimulatorError> {
        let delays = |i: usize| combinations.delays_s(effects, Kind::InputDelay, Place::Input(i));
        let delays: Vec<Vec<f64>> = (0..inputs).map(delays).collect();
        let samples_s: Vec<f64> = sensors.cuts_s().collect();
        let setting = |(index, one): (usize, &Combination)| {
            let delays: Vec<(u64, f64)> = delays.iter().map(|d| split(d[index], period_s)).collect();
            let changes_s: Vec<f64> = delays.iter().map(|d| d.1).collect();
            let within = Within { changes_s: &changes_s, samples_s: &samples_s };
            let schedule = Schedule::new(&one.system, period_s, within, events, levels)?;
            Ok(Setting { schedule, rests: one.system.rests.clone(), delays })
        };
        Ok(Self {
            period_s,
            switches: combinations.switches.clone(),
            all: combinations.all.iter().enumerate().map(setting).collect::<Result<_, SimulatorError>>()?,
            now: 0,
        })
    }

    /// True when there is only one setting.
    pub fn is_one(&self) -> bool {
        self.switches.is_empty()
    }

    /// Index of the current setting.
    pub fn index(&self) -> usize {
        self.now
    }

    /// The current setting.
    pub fn now(&self) -> &Setting {
        &self.all[self.now]
    }

    /// Current discretisations of a step; steps must be requested in ascending order.
    pub fn schedule(&mut self) -> &mut Schedule {
        &mut self.all[self.now].schedule
    }

    /// Selects the setting of a step; true if it changed. An effect begins and ends at the nearest step
    /// boundary.
    pub fn choose(&mut self, step: u64) -> bool {
        let t = (step as f64 + 0.5) * self.period_s;
        let on = self.switches.iter().enumerate().map(|(bit, switch)| usize::from(switch.is_on(t)) << bit);
        let before = std::mem::replace(&mut self.now, on.sum());
        self.now != before
    }

    /// Switches an effect; true if it is one of these.
    pub fn switch(&mut self, effect: usize, on: bool) -> bool {
        self.switches.iter_mut().any(|switch| switch.set(effect, on))
    }
}
