//! The vehicle: signals, matrices and effects, in SI.

use std::path::PathBuf;

use nalgebra::{Complex, DMatrix};
use whirlstand_linalg::{DecompositionError, eigenvalues};
use whirlstand_msgs::units::ShownSignals;

use crate::effects::Effect;
use crate::signal_unit::SignalUnit;

/// Default bound of a state relative to the vehicle's largest scale, where the file gives none.
const DEFAULT_BOUND_SCALES: f64 = 1e3;

/// A state.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// Name, unique among states.
    pub name: String,
    /// Unit declared in the file; values in memory are in SI.
    pub unit: SignalUnit,
    /// Largest magnitude for which the model is valid, SI; `None` where the file gives none
    /// ([`Vehicle::state_bounds`]).
    pub bound: Option<f64>,
}

/// An input, with the limits of the vehicle's own actuators.
#[derive(Debug, Clone, PartialEq)]
pub struct Input {
    /// Name, unique among inputs.
    pub name: String,
    /// Unit declared in the file; values in memory are in SI.
    pub unit: SignalUnit,
    /// Lower limit, SI; minus infinity for none.
    pub lower: f64,
    /// Upper limit, SI; infinity for none.
    pub upper: f64,
    /// Largest change per second, SI; infinity for none.
    pub rate_limit: f64,
    /// What the input did between the samples of a record; in a simulation it is held.
    pub intersample: Intersample,
}

/// Behaviour of a recorded input between its samples (Ljung, System Identification, 2nd ed., section 13.3).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Intersample {
    /// Held, as a command of a digital controller: zero-order hold.
    #[default]
    Held,
    /// Straight from one sample to the next, as a measured position of an actuator: first-order hold.
    Interpolated,
}

impl Intersample {
    /// The name in a vehicle file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Held => "zoh",
            Self::Interpolated => "foh",
        }
    }
}

impl Input {
    /// True when the samples of a record are points of a straight line, not the values that were held.
    pub fn is_straight(&self) -> bool {
        self.intersample == Intersample::Interpolated
    }

    /// Neutral value, also used in a failsafe: zero, or the limit nearest to it.
    pub fn neutral(&self) -> f64 {
        0f64.max(self.lower).min(self.upper)
    }
}

/// State of the engine, which determines the vibration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Engine {
    /// Standing still.
    Off,
    /// Running, on the ground.
    On,
    /// Running, in flight.
    #[default]
    Flying,
}

/// Vibration of a sensor: a tone and its harmonics, with an amplitude that depends on the engine's state.
///
/// The output gets the sum over h of `amplitude * harmonics[h-1] * sin(h (2 pi frequency_hz t + phase_rad))`.
#[derive(Debug, Clone, PartialEq)]
pub struct Vibration {
    /// Frequency of the first harmonic, Hz.
    pub frequency_hz: f64,
    /// Phase of the first harmonic at the record's start, rad.
    pub phase_rad: f64,
    /// Amplitudes of the harmonics, the first one first, relative to the engine's amplitude.
    pub harmonics: Vec<f64>,
    /// Amplitude with the engine off, SI.
    pub off: f64,
    /// Amplitude with the engine on, on the ground, SI.
    pub on: f64,
    /// Amplitude in flight, SI.
    pub flying: f64,
}

impl Vibration {
    /// Amplitude for the engine's state, SI.
    pub fn amplitude(&self, engine: Engine) -> f64 {
        match engine {
            Engine::Off => self.off,
            Engine::On => self.on,
            Engine::Flying => self.flying,
        }
    }

    /// Frequency in Hz and amplitude in SI of every harmonic with a non-zero amplitude.
    pub fn tones(&self, engine: Engine) -> impl Iterator<Item = (f64, f64)> {
        let (first, amplitude) = (self.frequency_hz, self.amplitude(engine));
        let tones = self.harmonics.iter().zip(1u32..);
        tones.map(move |(h, k)| (f64::from(k) * first, (amplitude * h).abs())).filter(|(_, a)| *a > 0.0)
    }
}

/// An output with its sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct Output {
    /// Name, unique among outputs.
    pub name: String,
    /// Unit declared in the file; values in memory are in SI.
    pub unit: SignalUnit,
    /// Standard deviation of the sensor's white noise, SI.
    pub noise: f64,
    /// Constant error of the sensor, SI.
    pub bias: f64,
    /// Rounding step of the sensor, SI; 0 for none.
    pub quantization: f64,
    /// Number of steps between two new values of the sensor.
    pub every: u32,
    /// Vibration of the sensor.
    pub vibration: Option<Vibration>,
}

impl Output {
    /// Standard deviation of the sensor's total error, SI: declared noise, rounding (its step over the square
    /// root of 12), the root mean square of the vibration, and the variance `added` by effects.
    pub fn sensor_std(&self, engine: Engine, added: f64) -> f64 {
        let vibration = self.vibration.as_ref().map_or(0.0, |v| {
            let power = v.harmonics.iter().map(|h| h * h).sum::<f64>() / 2.0;
            v.amplitude(engine).powi(2) * power
        });
        (self.noise.powi(2) + self.quantization.powi(2) / 12.0 + vibration + added).sqrt()
    }
}

/// A vehicle: dx/dt = A x + B u, y = C x + D u, its sensors, and effects on all of these. In memory everything is
/// in SI.
#[derive(Debug, Clone, PartialEq)]
pub struct Vehicle {
    /// Name; the file's stem when the file gives none.
    pub name: String,
    /// One-line description for lists.
    pub description: String,
    /// States, in the order of `a`.
    pub states: Vec<State>,
    /// Inputs, in the order of the columns of `b`.
    pub inputs: Vec<Input>,
    /// Outputs, in the order of the rows of `c`.
    pub outputs: Vec<Output>,
    /// System matrix A, states x states.
    pub a: DMatrix<f64>,
    /// Input matrix B, states x inputs.
    pub b: DMatrix<f64>,
    /// Output matrix C, outputs x states.
    pub c: DMatrix<f64>,
    /// Feed-through matrix D, outputs x inputs.
    pub d: DMatrix<f64>,
    /// Effects on the model; [`Vehicle::add_effect`] adds one.
    pub effects: Vec<Effect>,
    /// Free parameters for identification.
    pub free: Vec<crate::free::Free>,
    /// Outputs that identification fits, with their weights; all with weight 1 when empty.
    pub fit: Vec<(String, f64)>,
    /// Names of signals in logs, where they differ from the vehicle's: signal, and `NAME` or `NAME[unit]` of
    /// the log.
    pub map: Vec<(String, String)>,
    /// Provenance of a fitted vehicle.
    pub provenance: crate::free::Provenance,
    /// Text of the file as it was read; empty for a vehicle that was not read from a file.
    pub source_text: String,
    /// Folder against which paths in the file are resolved; `None` for built-in vehicles and texts.
    pub folder: Option<PathBuf>,
}

impl Vehicle {
    /// Poles of the model without its effects, 1/s, by decreasing real part; the positive imaginary part of a
    /// pair first.
    ///
    /// # Errors
    /// [`DecompositionError`] when A is scaled so badly that they cannot be computed.
    pub fn poles(&self) -> Result<Vec<Complex<f64>>, DecompositionError> {
        eigenvalues(&self.a)
    }

    /// Time constants of the poles, one over the magnitudes of their real parts, s; without those of integrators. Empty
    /// where the poles cannot be computed.
    pub fn time_constants_s(&self) -> Vec<f64> {
        self.poles().iter().flatten().map(|p| 1.0 / p.re.abs()).filter(|t| t.is_finite()).collect()
    }

    /// True when the outputs' noise was estimated from a record in which the vehicle moved. It then describes
    /// sample-to-sample changes and is no upper bound of the sensor's error, unlike that of a data sheet or
    /// of a record at rest.
    pub fn sensor_noise_is_estimated(&self) -> bool {
        self.provenance
            .iter()
            .any(|(key, value)| key == crate::free::SENSOR_NOISE && value == crate::free::ESTIMATED_IN_MOTION)
    }

    /// Steps to which the record was averaged before this vehicle was fitted to it, s: what happens within one of them
    /// the fit has not seen, and the outputs' noise is that of the averages.
    pub fn fit_period(&self) -> Option<f64> {
        let value = self.provenance.iter().find(|(key, _)| key == crate::free::FIT_PERIOD)?;
        value.1.parse().ok().filter(|period: &f64| *period > 0.0 && period.is_finite())
    }

    /// Index of the state with the given name.
    pub fn state_index(&self, name: &str) -> Option<usize> {
        self.states.iter().position(|s| s.name == name)
    }

    /// Index of the input with the given name.
    pub fn input_index(&self, name: &str) -> Option<usize> {
        self.inputs.iter().position(|s| s.name == name)
    }

    /// Index of the output with the given name.
    pub fn output_index(&self, name: &str) -> Option<usize> {
        self.outputs.iter().position(|s| s.name == name)
    }

    /// The pairs of outputs that mix when the sensor of two is turned (`misalignment`): these, and their rates where the
    /// vehicle has both, as outputs of the same names with `_rate`.
    pub fn turned_outputs(&self, i: usize, j: usize) -> [Option<(usize, usize)>; 2] {
        let rate = |i: usize| self.output_index(&format!("{}_rate", self.outputs[i].name));
        [Some((i, j)), rate(i).zip(rate(j))]
    }

    /// Units in which the values of each state, input and output are shown to a reader.
    pub fn shown_units(&self) -> ShownSignals {
        ShownSignals::new(
            self.states.iter().map(|s| (s.name.clone(), s.unit.shown())),
            self.inputs.iter().map(|s| (s.name.clone(), s.unit.shown())),
            self.outputs.iter().map(|s| (s.name.clone(), s.unit.shown())),
        )
    }

    /// The group of signals that differs in name or number from that of another vehicle: `states`, `inputs`
    /// or `outputs`.
    pub fn signals_differ(&self, other: &Self) -> Option<&'static str> {
        let same = |a: &mut dyn Iterator<Item = &String>, b: &mut dyn Iterator<Item = &String>| a.eq(b);
        let pairs: [(&'static str, bool); 3] = [
            (
                "states",
                same(&mut self.states.iter().map(|s| &s.name), &mut other.states.iter().map(|s| &s.name)),
            ),
            (
                "inputs",
                same(&mut self.inputs.iter().map(|s| &s.name), &mut other.inputs.iter().map(|s| &s.name)),
            ),
            (
                "outputs",
                same(&mut self.outputs.iter().map(|s| &s.name), &mut other.outputs.iter().map(|s| &s.name)),
            ),
        ];
        pairs.into_iter().find(|(_, same)| !same).map(|(what, _)| what)
    }

    /// Largest magnitude of every state for which the model is valid, SI: that of the file, or a thousand
    /// times the largest scale of the vehicle. The latter is the largest of: the response of any state to
    /// inputs at their limits within a second, an initial state, and one.
    pub fn state_bounds(&self, initial: &[f64]) -> Vec<f64> {
        let reach = |input: &Input| match input.lower.abs().max(input.upper.abs()) {
            most if most.is_finite() => most,
            _ => 1.0,
        };
        let pushed = |i: usize| -> f64 {
            self.inputs.iter().enumerate().map(|(j, input)| self.b[(i, j)].abs() * reach(input)).sum()
        };
        let scales = (0..self.states.len()).map(pushed).chain(initial.iter().map(|x| x.abs()));
        let default = DEFAULT_BOUND_SCALES * scales.fold(1.0, f64::max);
        self.states.iter().map(|s| s.bound.unwrap_or(default)).collect()
    }
}
