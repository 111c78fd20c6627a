//! What a vehicle is with some of its effects switched off: the matrices of a step, delays and rows of outputs for every
//! combination of those that change them, all made beforehand, so that a step only has to choose.
//!
//! No state jumps where an effect begins or ends: the state of a filter that is off follows the signal that passes it.

use super::combinations::{Combination, Combinations};
use super::compile::Rest;
use super::inputs::split;
use super::schedule::Schedule;
use super::sensors::Sensors;
use super::switch::Switch;
use crate::effects::{Effect, Kind, Place};
use crate::error::SimulatorError;

/// What a step needs of a combination.
#[derive(Debug, Clone)]
pub struct Setting {
    /// Matrices of a period.
    pub schedule: Schedule,
    /// What filters settle to.
    pub rests: Vec<Rest>,
    /// Delay of each input: whole periods and a rest in s.
    pub delays: Vec<(u64, f64)>,
}

/// All of them, and which one is in force.
#[derive(Debug, Clone)]
pub struct Settings {
    period_s: f64,
    switches: Vec<Switch>,
    all: Vec<Setting>,
    now: usize,
}

impl Settings {
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
        let setting = |(index, one): (usize, &Combination)| {
            let delays: Vec<(u64, f64)> = delays.iter().map(|d| split(d[index], period_s)).collect();
            let fractions = delays.iter().map(|d| d.1).filter(|f| *f > 0.0);
            let cuts: Vec<f64> = fractions.chain(sensors.cuts_s()).collect();
            let schedule = Schedule::new(&one.system, period_s, &cuts, events, levels)?;
            Ok(Setting { schedule, rests: one.system.rests.clone(), delays })
        };
        Ok(Self {
            period_s,
            switches: combinations.switches.clone(),
            all: combinations.all.iter().enumerate().map(setting).collect::<Result<_, SimulatorError>>()?,
            now: 0,
        })
    }

    /// Whether there is nothing to choose.
    pub fn is_one(&self) -> bool {
        self.switches.is_empty()
    }

    /// Which one is in force.
    pub fn index(&self) -> usize {
        self.now
    }

    /// The one in force.
    pub fn now(&self) -> &Setting {
        &self.all[self.now]
    }

    /// The matrices of a step in force; steps must be asked for in ascending order.
    pub fn schedule(&mut self) -> &mut Schedule {
        &mut self.all[self.now].schedule
    }

    /// Chooses the one for a step; whether it is another. An effect begins and ends at the boundary of steps next to its moment.
    pub fn choose(&mut self, step: u64) -> bool {
        let t = (step as f64 + 0.5) * self.period_s;
        let on = self.switches.iter().enumerate().map(|(bit, switch)| usize::from(switch.is_on(t)) << bit);
        let before = std::mem::replace(&mut self.now, on.sum());
        self.now != before
    }

    /// Switches an effect, if it is one of these; whether it is.
    pub fn switch(&mut self, effect: usize, on: bool) -> bool {
        self.switches.iter_mut().any(|switch| switch.set(effect, on))
    }
}
