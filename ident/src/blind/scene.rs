//! The stage of a trial: vehicle, excitation, noise, start; and the records that come of it.

use whirlstand_vehicle::{Effect, Kind, Vehicle};

use super::BlindError;
use super::excitation::Excitation;
use super::linear::model;
use super::motion::fly;
use super::noise::Colour;
use super::outside::Outside;
use super::plan::{Case, Plan};
use super::plant::{Commands, Hidden, Plant};
use super::random::Dice;
use super::sense::{Noise, sense};
use super::vehicles::{self, Nominal};

/// Least commands that a drawn flight has, as a share of their limits: the motion stands out of the noise.
const LEAST_SHARE: f64 = 0.03;

/// What the user gives of his own.
#[derive(Debug, Clone)]
pub struct Setting {
    /// His vehicle, instead of drawn ones.
    pub vehicle: Option<Vehicle>,
    /// His excitation, one vector for each input of the vehicle.
    pub commands: Option<Commands>,
    /// Shortest and longest drawn record, s.
    pub lengths_s: (f64, f64),
    /// Sampling rates that are drawn from, Hz; at least one.
    pub rates_hz: Vec<f64>,
}

impl Default for Setting {
    fn default() -> Self {
        Self { vehicle: None, commands: None, lengths_s: (30.0, 120.0), rates_hz: vec![50.0, 100.0, 200.0] }
    }
}

/// Everything of a trial but its effects.
#[derive(Debug, Clone)]
pub(crate) struct Scene {
    pub number: u64,
    pub nominal: Nominal,
    pub excitation: Excitation,
    pub commands: Commands,
    /// Greatest command as a share of its limits; `None` when the user gave the excitation.
    pub share: Option<f64>,
    pub noise: Noise,
    /// Initial state in units of each state's motion.
    start: Vec<f64>,
    pub x0: Vec<f64>,
}

impl Scene {
    /// Draws one.
    pub fn draw(plan: &Plan, setting: &Setting, dice: &mut Dice) -> Result<Self, BlindError> {
        // What a change of free parameters could imitate shall not be hidden among them.
        let confounded = [
            Kind::ParameterChange,
            Kind::InputGain,
            Kind::InputCoupling,
            Kind::SensorScale,
            Kind::Misalignment,
            Kind::ModeTransition,
        ];
        let free = dice.chance(0.25) && !plan.effects.iter().any(|k| confounded.contains(k));
        let helicopter = plan.effects.contains(&Kind::ModeTransition);
        let nominal = match &setting.vehicle {
            Some(vehicle) => Nominal::new(vehicle)?,
            None => vehicles::draw(helicopter, free, dice)?,
        };
        let period_s = 1.0 / setting.rates_hz[dice.below(setting.rates_hz.len())];
        let samples = (dice.between(setting.lengths_s.0, setting.lengths_s.1) / period_s) as usize;
        let excitation = Excitation::draw(dice);
        let share = dice.scaled(0.05, 0.5);
        let m = nominal.vehicle.inputs.len();
        let (excitation, commands, share) = match &setting.commands {
            Some(given) => (Excitation::Given, given.clone(), None),
            None => {
                let mut inputs = excitation.commands(m, samples, period_s, nominal.highest_hz, dice);
                for (u, limits) in inputs.iter_mut().zip(&nominal.vehicle.inputs) {
                    let limit = limits.upper.min(-limits.lower);
                    let limit = if limit.is_finite() && limit > 0.0 { limit } else { 1.0 };
                    let own = limit * share * dice.between(0.7, 1.0);
                    u.iter_mut().for_each(|u| *u *= own);
                }
                (excitation, Commands { period_s, inputs }, Some(share))
            }
        };
        let noise = draw_noise(plan, &nominal.vehicle, commands.period_s, dice);
        let moving = setting.vehicle.is_none() && dice.chance(0.4);
        let start = (0..nominal.vehicle.states.len())
            .map(|_| if moving { 0.5 * dice.normal() } else { 0.0 })
            .collect();
        let mut scene =
            Self { number: plan.number, nominal, excitation, commands, share, noise, start, x0: Vec::new() };
        scene.place_start();
        Ok(scene)
    }

    /// The initial state follows the size of the motion.
    fn place_start(&mut self) {
        let n = self.start.len();
        self.x0 = vec![0.0; n];
        if self.start.iter().all(|s| *s == 0.0) {
            return;
        }
        let vehicle = &self.nominal.vehicle;
        let mut states = vehicle.clone();
        states.c = nalgebra::DMatrix::identity(n, n);
        states.d = nalgebra::DMatrix::zeros(n, vehicle.inputs.len());
        let x = model(&states, &self.x0, &self.commands);
        let samples = self.commands.samples().max(1) as f64;
        for (i, (x0, start)) in self.x0.iter_mut().zip(&self.start).enumerate() {
            let rms = (x.iter().skip(i).step_by(n).map(|x| x * x).sum::<f64>() / samples).sqrt();
            *x0 = start * rms;
        }
    }

    /// The same with larger or smaller commands; false when they may not change that far.
    pub fn rescale(&mut self, factor: f64) -> bool {
        let Some(share) = self.share else { return false };
        let wanted = (share * factor).clamp(LEAST_SHARE, 0.7);
        let factor = wanted / share;
        if (0.85..1.18).contains(&factor) {
            return false;
        }
        self.share = Some(wanted);
        self.commands.inputs.iter_mut().flatten().for_each(|u| *u *= factor);
        self.place_start();
        true
    }

    /// The record with these effects: samples x outputs.
    pub fn record(&self, effects: &[Effect], outside: Option<&Outside>) -> Result<Vec<f64>, BlindError> {
        let hidden = Hidden { effects, outside, expected: false, trial: self.number };
        let noise = self.noise.draw(self.commands.samples(), self.commands.period_s, self.number);
        self.sensed(hidden, Some(&noise))
    }

    /// The record without anything random or rounded.
    pub fn expected(&self, effects: &[Effect], outside: Option<&Outside>) -> Result<Vec<f64>, BlindError> {
        self.sensed(Hidden { effects, outside, expected: true, trial: self.number }, None)
    }

    fn sensed(&self, hidden: Hidden<'_>, noise: Option<&[f64]>) -> Result<Vec<f64>, BlindError> {
        let vehicle = &self.nominal.vehicle;
        let plant = Plant::new(vehicle, &self.commands, hidden)?;
        let motion = fly(&plant, &self.x0, self.commands.period_s, self.commands.samples())?;
        sense(vehicle, &motion, noise, self.commands.period_s, hidden)
    }
}

/// Noise around the declared size, in one of three colours; those of clean records take turns.
fn draw_noise(plan: &Plan, vehicle: &Vehicle, period_s: f64, dice: &mut Dice) -> Noise {
    let drawn = dice.below(3) as u64;
    let turn = if plan.case == Case::Clean { plan.ordinal % 3 } else { drawn };
    let frequency_hz = dice.between(0.06, 0.35) / period_s;
    let radius = dice.between(0.88, 0.95);
    let colour = match turn {
        0 => Colour::White,
        1 => Colour::Ar1,
        _ => Colour::Resonant { frequency_hz, radius },
    };
    let level = dice.between(0.7, 1.2);
    let std = vehicle.outputs.iter().map(|o| o.noise * level * dice.between(0.9, 1.1)).collect();
    Noise { colour, std }
}
