//! The experiment of a trial (vehicle, excitation, noise and initial state), and its simulated records.

use whirlstand_vehicle::{Effect, Kind, Vehicle};

use super::closed_loop;
use super::commands::Commands;
use super::error::BlindError;
use super::excitation::Excitation;
use super::hidden::Hidden;
use super::law::{Law, Weights};
use super::linear::model;
use super::manoeuvres::{CommandFormat, commands};
use super::motion::fly;
use super::noise::Colour;
use super::out_of_library::OutOfLibraryEffect;
use super::plan::{Case, Plan};
use super::random::RandomStream;
use super::ranges::{ColourRange, Ranges};
use super::sense::{Noise, sense};
use super::truth_model::TruthModel;
use super::turbulence::Spectrum;
use super::vehicles::{self, Nominal, without_noise};

/// The parts of an experiment that the user supplies.
#[derive(Debug, Clone, Default)]
pub struct Setting {
    /// The user's vehicle, used instead of drawn ones.
    pub vehicle: Option<Vehicle>,
    /// The user's excitation, one vector for each input of the vehicle.
    pub commands: Option<Commands>,
    /// Shortest and longest drawn record, s, replacing the generator's range.
    pub lengths_s: Option<(f64, f64)>,
    /// Sampling rates to draw from, Hz, replacing the generator's; at least one.
    pub rates_hz: Option<Vec<f64>>,
}

/// The control law of a closed loop, and its reference.
#[derive(Debug, Clone)]
pub(crate) struct Control {
    /// The law in its initial state.
    pub law: Law,
    /// The reference: the commands of the loop without feedback.
    pub reference: Commands,
    /// Whether the vehicle file states the sensor noise.
    noise_declared: bool,
}

/// A trial without its effects.
#[derive(Debug, Clone)]
pub(crate) struct Experiment {
    pub number: u64,
    pub ranges: &'static Ranges,
    pub nominal: Nominal,
    pub excitation: Excitation,
    pub commands: Commands,
    /// Greatest command as a share of its limits; `None` when the user gave the excitation.
    pub share: Option<f64>,
    pub noise: Noise,
    pub spectrum: Spectrum,
    /// The control law of a closed-loop experiment; `None` in open loop.
    pub control: Option<Control>,
    /// Initial states, each relative to the rms of its state's motion.
    start: Vec<f64>,
    pub x0: Vec<f64>,
}

impl Experiment {
    /// Draws an experiment.
    pub fn draw(plan: &Plan, setting: &Setting, stream: &mut RandomStream) -> Result<Self, BlindError> {
        // Effects that a change of free parameters could imitate are not combined with free parameters.
        let confounded = [
            Kind::ParameterChange,
            Kind::InputGain,
            Kind::InputCoupling,
            Kind::SensorScale,
            Kind::Misalignment,
            Kind::ModeTransition,
        ];
        let ranges = plan.generator.ranges();
        let free =
            stream.chance(ranges.vehicles.free) && !plan.effects.iter().any(|k| confounded.contains(k));
        let helicopter = plan.effects.contains(&Kind::ModeTransition);
        let nominal = match &setting.vehicle {
            Some(vehicle) => Nominal::new(vehicle)?,
            None => vehicles::draw(helicopter, free, ranges, stream)?,
        };
        let rates_hz = setting.rates_hz.as_deref().unwrap_or(ranges.rates_hz);
        let period_s = 1.0 / rates_hz[stream.below(rates_hz.len())];
        let samples = (stream.within(setting.lengths_s.unwrap_or(ranges.lengths_s)) / period_s) as usize;
        let excitation = ranges.excitation.draw(stream);
        let share = stream.scaled_within(ranges.excitation.share);
        let m = nominal.vehicle.inputs.len();
        let (excitation, commands, share) = match &setting.commands {
            Some(given) => (Excitation::Given, given.clone(), None),
            None => {
                let format = CommandFormat { inputs: m, samples, period_s, highest_hz: nominal.highest_hz };
                let mut inputs = commands(excitation, &ranges.excitation, format, stream);
                for (u, limits) in inputs.iter_mut().zip(&nominal.vehicle.inputs) {
                    let limit = limits.upper.min(-limits.lower);
                    let limit = if limit.is_finite() && limit > 0.0 { limit } else { 1.0 };
                    let own = limit * share * stream.within(ranges.excitation.input_share);
                    u.iter_mut().for_each(|u| *u *= own);
                }
                (excitation, Commands { period_s, inputs }, Some(share))
            }
        };
        let noise = draw_noise(plan, &nominal.vehicle, commands.period_s, stream);
        let moving = setting.vehicle.is_none() && stream.chance(ranges.vehicles.moving_start);
        let start = (0..nominal.vehicle.states.len())
            .map(|_| if moving { ranges.vehicles.start_spread * stream.normal() } else { 0.0 })
            .collect();
        // No number is drawn where there is no choice, so that the reference generator's trials stay the
        // same.
        let dryden = ranges.effects.dryden > 0.0 && stream.chance(ranges.effects.dryden);
        let spectrum = if dryden { Spectrum::Dryden } else { Spectrum::FirstOrder };
        let mut experiment = Self {
            number: plan.number,
            ranges,
            nominal,
            excitation,
            commands,
            share,
            noise,
            spectrum,
            control: None,
            start,
            x0: Vec::new(),
        };
        experiment.place_start();
        if plan.closed_loop && setting.commands.is_none() {
            experiment.close_loop(plan)?;
        }
        Ok(experiment)
    }

    /// Closes the loop: the drawn commands become the reference of a control law. In half of the trials the
    /// vehicle file does not state the sensor noise: the law's reaction to noise must not be attributed to
    /// the vehicle.
    fn close_loop(&mut self, plan: &Plan) -> Result<(), BlindError> {
        let vehicle = &self.nominal.vehicle;
        let rms = |values: &mut dyn Iterator<Item = f64>| {
            let (sum, count) = values.fold((0.0, 0u32), |(sum, count), v| (sum + v * v, count + 1));
            (sum / f64::from(count.max(1))).sqrt()
        };
        let response = model(vehicle, &self.x0, &self.commands);
        let p = vehicle.outputs.len();
        let outputs: Vec<f64> =
            (0..p).map(|i| rms(&mut response.iter().skip(i).step_by(p).copied())).collect();
        let inputs: Vec<f64> = self.commands.inputs.iter().map(|u| rms(&mut u.iter().copied())).collect();
        let largest = inputs.iter().copied().fold(0.0, f64::max);
        let inputs: Vec<f64> = inputs.iter().map(|u| u.max(0.1 * largest)).collect();
        let weights = Weights { outputs: &outputs, inputs: &inputs, noise: &self.noise.std };
        let law = Law::new(vehicle, self.commands.period_s, &weights).ok_or_else(|| {
            BlindError::Effect(format!(
                "no regulator with finite gains was found for the vehicle '{}'",
                vehicle.name
            ))
        })?;
        // Noise as an effect is noise beyond the declared level, so it requires a declared level.
        let noise_declared =
            plan.effects.contains(&Kind::Noise) || RandomStream::new(plan.number, "declared").chance(0.5);
        if !noise_declared {
            self.nominal.toml = without_noise(vehicle);
        }
        self.control = Some(Control { law, reference: self.commands.clone(), noise_declared });
        self.commands = self.commanded(&[], None)?;
        Ok(())
    }

    /// The commands of a flight with these effects: the drawn ones, or in closed loop those of the control
    /// law.
    pub fn commanded(
        &self,
        effects: &[Effect],
        outside: Option<&OutOfLibraryEffect>,
    ) -> Result<Commands, BlindError> {
        let Some(Control { law, reference, .. }) = &self.control else { return Ok(self.commands.clone()) };
        let hidden =
            Hidden { effects, outside, expected: false, spectrum: self.spectrum, trial: self.number };
        let noise = self.noise.draw(reference.samples(), reference.period_s, self.number);
        closed_loop::commands(&self.nominal.vehicle, law.clone(), reference, &self.x0, &noise, hidden)
    }

    /// Whether the vehicle file states the sensor noise.
    pub fn declares_noise(&self) -> bool {
        self.control.as_ref().is_none_or(|control| control.noise_declared)
    }

    /// Scales the initial state to the root mean square of each state's motion.
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

    /// Scales the commands by `factor` within their limits; false when the scaling would hardly change them.
    pub fn rescale(&mut self, factor: f64) -> bool {
        let Some(share) = self.share else { return false };
        let (least, most) = self.ranges.excitation.share_limits;
        let wanted = (share * factor).clamp(least, most);
        let factor = wanted / share;
        if (0.85..1.18).contains(&factor) {
            return false;
        }
        self.share = Some(wanted);
        let reference = self.control.as_mut().map(|control| &mut control.reference);
        for commands in std::iter::once(&mut self.commands).chain(reference) {
            commands.inputs.iter_mut().flatten().for_each(|u| *u *= factor);
        }
        self.place_start();
        true
    }

    /// The simulated record with these effects (samples x outputs).
    pub fn record(
        &self,
        effects: &[Effect],
        outside: Option<&OutOfLibraryEffect>,
    ) -> Result<Vec<f64>, BlindError> {
        let hidden =
            Hidden { effects, outside, expected: false, spectrum: self.spectrum, trial: self.number };
        let noise = self.noise.draw(self.commands.samples(), self.commands.period_s, self.number);
        self.sensed(hidden, Some(&noise))
    }

    /// The record with these effects, without random parts and rounding.
    pub fn expected(
        &self,
        effects: &[Effect],
        outside: Option<&OutOfLibraryEffect>,
    ) -> Result<Vec<f64>, BlindError> {
        self.sensed(
            Hidden { effects, outside, expected: true, spectrum: self.spectrum, trial: self.number },
            None,
        )
    }

    fn sensed(&self, hidden: Hidden<'_>, noise: Option<&[f64]>) -> Result<Vec<f64>, BlindError> {
        let vehicle = &self.nominal.vehicle;
        let model = TruthModel::new(vehicle, &self.commands, hidden)?;
        let motion = fly(&model, &self.x0, self.commands.period_s, self.commands.samples())?;
        sense(vehicle, &motion, noise, self.commands.period_s, hidden)
    }
}

/// Draws sensor noise around the declared level. All colours are drawn and one is selected, so that the
/// selection does not affect the rest of the trial; clean records use the colours in turn.
fn draw_noise(plan: &Plan, vehicle: &Vehicle, period_s: f64, stream: &mut RandomStream) -> Noise {
    let ranges = &plan.generator.ranges().noise;
    let drawn = stream.below(ranges.colours.len());
    let turn = match plan.case {
        Case::Clean => (plan.ordinal % ranges.colours.len() as u64) as usize,
        _ => drawn,
    };
    let colours: Vec<Colour> = ranges.colours.iter().map(|range| colour(range, period_s, stream)).collect();
    let level = stream.within(ranges.level);
    let std = vehicle.outputs.iter().map(|o| o.noise * level * stream.within(ranges.spread)).collect();
    Noise { colour: colours[turn], std }
}

fn colour(range: &ColourRange, period_s: f64, stream: &mut RandomStream) -> Colour {
    match *range {
        ColourRange::White => Colour::White,
        ColourRange::Ar1(coefficient) => Colour::Ar1 { coefficient },
        ColourRange::Resonant { rate_share, radius } => Colour::Resonant {
            frequency_hz: stream.within(rate_share) / period_s,
            radius: stream.within(radius),
        },
        ColourRange::SlowResonant { frequency_hz, radius } => {
            Colour::Resonant { frequency_hz: stream.within(frequency_hz), radius: stream.within(radius) }
        }
        ColourRange::Ar4 { rate_shares, radius } => Colour::Ar4 {
            frequencies_hz: rate_shares.map(|share| stream.within(share) / period_s),
            radii: [radius; 2].map(|radius| stream.within(radius)),
        },
        ColourRange::Wandering { time_constant_s, white_share } => Colour::Wandering {
            time_constant_s: stream.scaled_within(time_constant_s),
            white_share: stream.within(white_share),
        },
        ColourRange::StudentT { degrees: (from, to) } => {
            Colour::StudentT { degrees: from + stream.below((to - from) as usize) as u32 }
        }
    }
}
