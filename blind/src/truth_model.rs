//! The equation of motion of a trial's vehicle with all effects, as an ordinary differential equation.
//!
//! It is written from the table's definitions alone and shares nothing with the simulator that the diagnosis
//! uses, except the vehicle's matrices, limits and effects as data.

use std::f64::consts::TAU;

use nalgebra::DMatrix;
use whirlstand_vehicle::{Effect, Kind, Matrix, Place, Vehicle};

use super::chain::Chain;
use super::commands::Commands;
use super::error::BlindError;
use super::hidden::{Hidden, value};
use super::out_of_library::{OutOfLibrary, OutOfLibraryEffect};
use super::poles::fastest;
use super::random::RandomStream;
use super::signal::Signal;
use super::turbulence::turbulence;

/// A matrix in sparse form: each row is a list of columns and values.
#[derive(Debug, Clone)]
pub(crate) struct Sparse(Vec<Vec<(usize, f64)>>);

impl Sparse {
    fn new(m: &DMatrix<f64>) -> Self {
        let row = |i: usize| (0..m.ncols()).map(|j| (j, m[(i, j)])).filter(|(_, v)| *v != 0.0).collect();
        Self((0..m.nrows()).map(row).collect())
    }

    #[inline]
    pub fn dot(&self, row: usize, x: &[f64]) -> f64 {
        self.0[row].iter().map(|(j, v)| v * x[*j]).sum()
    }
}

/// A filter between input and vehicle.
#[derive(Debug, Clone)]
pub(crate) enum Filter {
    Lag { input: usize, state: usize, rate: f64 },
    Mode { input: usize, state: usize, w: f64, damping: f64, gain: f64 },
}

/// A term of a state's derivative in addition to A x + B u.
#[derive(Debug, Clone)]
pub(crate) enum Force {
    Drag { state: usize, c: f64 },
    Cubic { from: usize, onto: usize, c: f64 },
    Sine { state: usize, amplitude: f64, w: f64, phase: f64 },
    Product { states: (usize, usize), onto: usize, c: f64 },
    SineSpring { from: usize, onto: usize, size: f64, scale: f64 },
    Swinging { from: usize, onto: usize, size: f64, w: f64 },
    Bilinear { input: usize, from: usize, onto: usize, size: f64 },
    InputProduct { inputs: (usize, usize), onto: usize, size: f64 },
    YieldingSpring { from: usize, onto: usize, size: f64, scale: f64 },
    StiffnessRamp { from: usize, onto: usize, size: f64, length_s: f64 },
    SelfExcitation { state: usize, size: f64, scale: f64 },
}

/// Dry friction on a state: the deceleration in positive and in negative motion.
#[derive(Debug, Clone)]
pub(crate) struct Friction {
    pub state: usize,
    pub against: (f64, f64),
}

/// A relay with hysteresis and dead time on a state.
#[derive(Debug, Clone)]
pub(crate) struct Relay {
    pub from: usize,
    pub onto: usize,
    pub size: f64,
    pub threshold: f64,
    pub dead_time_s: f64,
}

/// The lag or creep of a sensor.
#[derive(Debug, Clone)]
pub(crate) struct SensorFilter {
    pub output: usize,
    pub state: usize,
    pub rate: f64,
    /// `None` for a lag; for creep, the gain of the filter's state in the output.
    pub creep: Option<f64>,
    /// Greatest distance that the filter closes per time constant, where its rate is limited.
    pub slew: Option<f64>,
}

/// The equation of motion of a trial.
#[derive(Debug, Clone)]
pub(crate) struct TruthModel {
    pub n: usize,
    pub size: usize,
    /// Matrices A and B of each stage, with the time from which they hold.
    pub stages: Vec<(f64, Sparse, Sparse)>,
    pub c: Sparse,
    pub d: Sparse,
    /// Inputs as they reach the vehicle, before couplings and filters.
    pub inputs: Vec<Signal>,
    /// Signals added to the derivatives of states: index of the state and signal.
    pub pushes: Vec<(usize, Signal)>,
    /// Couplings of inputs: index of the source, index of the target, and coefficient.
    pub couplings: Vec<(usize, usize, f64)>,
    pub filters: Vec<Filter>,
    pub forces: Vec<Force>,
    pub frictions: Vec<Friction>,
    pub relay: Option<Relay>,
    pub sensor_filters: Vec<SensorFilter>,
    /// Delay of each output's measurement, s.
    pub sensor_delays: Vec<f64>,
    /// Largest step of the integration, s.
    pub step_s: f64,
}

impl TruthModel {
    /// The equation of motion of the vehicle with its own and the hidden effects, under these commands.
    pub fn new(vehicle: &Vehicle, commands: &Commands, hidden: Hidden<'_>) -> Result<Self, BlindError> {
        let all: Vec<&Effect> = vehicle.effects.iter().chain(hidden.effects).collect();
        let mut placed = Vec::with_capacity(all.len());
        for effect in all {
            placed.push((effect, effect.resolve(vehicle).map_err(BlindError::effect)?));
        }
        let (a, b, c, d) = changed(vehicle, &placed);
        let (n, m) = b.shape();
        let mut stages = vec![(0.0, Sparse::new(&a), Sparse::new(&b))];
        for (effect, _) in placed.iter().filter(|(e, _)| e.kind() == Kind::ModeTransition) {
            let (a, b) = successor(vehicle, effect.text().unwrap_or_default())?;
            stages.push((value(effect, "at_s"), Sparse::new(&a), Sparse::new(&b)));
        }
        stages.sort_by(|x, y| x.0.total_cmp(&y.0));
        let mut model = Self {
            n,
            size: n,
            stages,
            c: Sparse::new(&c),
            d: Sparse::new(&d),
            inputs: Vec::new(),
            pushes: Vec::new(),
            couplings: Vec::new(),
            filters: Vec::new(),
            forces: Vec::new(),
            frictions: Vec::new(),
            relay: None,
            sensor_filters: Vec::new(),
            sensor_delays: vec![0.0; vehicle.outputs.len()],
            step_s: 1e-3,
        };
        for i in 0..m {
            let own: Vec<&Effect> =
                placed.iter().filter(|(_, p)| *p == Place::Input(i)).map(|(e, _)| *e).collect();
            let mut chain = Chain::new(vehicle, i, &own, hidden.outside);
            model.inputs.push(chain.pass(&commands.inputs[i], 0.0, commands.period_s));
        }
        model.add_actuators(&placed, m);
        for (index, (effect, place)) in placed.iter().enumerate() {
            model.add_motion(effect, *place, index, commands, &hidden);
        }
        model.add_sensor_filters(&placed);
        if let Some(outside) = hidden.outside {
            model.add_outside(outside, commands.duration_s());
        }
        model.choose_step(&a);
        Ok(model)
    }

    fn grow(&mut self, by: usize) -> usize {
        self.size += by;
        self.size - by
    }

    fn add_actuators(&mut self, placed: &[(&Effect, Place)], m: usize) {
        for (effect, place) in placed {
            if let Place::InputPair(from, onto) = *place {
                self.couplings.push((from, onto, value(effect, "coefficient")));
            }
        }
        for input in 0..m {
            let own = |kind| {
                placed
                    .iter()
                    .filter(move |(e, p)| e.kind() == kind && *p == Place::Input(input))
                    .map(|(e, _)| *e)
            };
            for lag in own(Kind::ActuatorLag).map(|e| value(e, "time_constant_s")).filter(|tau| *tau > 0.0) {
                let state = self.grow(1);
                self.filters.push(Filter::Lag { input, state, rate: 1.0 / lag });
            }
            for mode in own(Kind::UnmodelledMode) {
                let state = self.grow(2);
                self.filters.push(Filter::Mode {
                    input,
                    state,
                    w: TAU * value(mode, "frequency_hz"),
                    damping: value(mode, "damping_ratio"),
                    gain: value(mode, "gain"),
                });
            }
        }
    }

    fn add_motion(
        &mut self,
        effect: &Effect,
        place: Place,
        index: usize,
        commands: &Commands,
        hidden: &Hidden<'_>,
    ) {
        let get = |name| value(effect, name);
        let end = commands.duration_s() + 1.0;
        match (effect.kind(), place) {
            (Kind::QuadraticDrag, Place::State(state)) => {
                self.forces.push(Force::Drag { state, c: get("coefficient") });
            }
            (Kind::CubicStiffness, Place::StatePair(from, onto)) => {
                self.forces.push(Force::Cubic { from, onto, c: get("coefficient") });
            }
            (Kind::CoulombFriction, Place::State(state)) => {
                let (level, asymmetry) = (get("level"), get("asymmetry"));
                let against = (level + asymmetry, level - asymmetry);
                match self.frictions.iter_mut().find(|f| f.state == state) {
                    Some(f) => f.against = (f.against.0 + against.0, f.against.1 + against.1),
                    None => self.frictions.push(Friction { state, against }),
                }
            }
            (Kind::StepDisturbance, Place::State(state)) => {
                let step = Signal::edges(&[(get("at_s"), get("magnitude"))], end);
                self.pushes.push((state, step));
            }
            (Kind::PulseDisturbance, Place::State(state)) => {
                let (at, length) = (get("at_s"), get("duration_s"));
                let pulse = Signal::edges(&[(at, get("magnitude")), (at + length, 0.0)], end);
                self.pushes.push((state, pulse));
            }
            (Kind::PeriodicDisturbance, Place::State(state)) => self.forces.push(Force::Sine {
                state,
                amplitude: get("amplitude"),
                w: TAU * get("frequency_hz"),
                phase: get("phase_rad"),
            }),
            (Kind::Turbulence, Place::State(state)) if !hidden.expected => {
                let mut stream = RandomStream::new(hidden.trial, &format!("turbulence {index}"));
                self.pushes.push((
                    state,
                    turbulence(hidden.spectrum, get("std"), get("bandwidth_hz"), end, &mut stream),
                ));
            }
            _ => {}
        }
    }

    fn add_sensor_filters(&mut self, placed: &[(&Effect, Place)]) {
        for (effect, place) in placed {
            let Place::Output(output) = *place else { continue };
            match effect.kind() {
                Kind::SensorLag if value(effect, "time_constant_s") > 0.0 => {
                    self.filter_sensor(output, value(effect, "time_constant_s"), None, None);
                }
                Kind::SensorDelay => self.sensor_delays[output] += value(effect, "delay_s"),
                _ => {}
            }
        }
    }

    fn add_outside(&mut self, outside: &OutOfLibraryEffect, length_s: f64) {
        let &OutOfLibraryEffect { kind, input, output, states, onto, size, scale, dead_time_s, .. } = outside;
        let from = states.0;
        match kind {
            OutOfLibrary::StateProduct => self.forces.push(Force::Product { states, onto, c: size }),
            OutOfLibrary::SineSpring => self.forces.push(Force::SineSpring { from, onto, size, scale }),
            OutOfLibrary::SwingingStiffness => {
                self.forces.push(Force::Swinging { from, onto, size, w: TAU * scale });
            }
            OutOfLibrary::Bilinear => self.forces.push(Force::Bilinear { input, from, onto, size }),
            OutOfLibrary::InputProduct => {
                let inputs = (input, outside.other_input);
                self.forces.push(Force::InputProduct { inputs, onto, size });
            }
            OutOfLibrary::YieldingSpring => {
                self.forces.push(Force::YieldingSpring { from, onto, size, scale });
            }
            OutOfLibrary::StiffnessRamp => {
                self.forces.push(Force::StiffnessRamp { from, onto, size, length_s });
            }
            OutOfLibrary::SelfExcitation => {
                self.forces.push(Force::SelfExcitation { state: onto, size, scale });
            }
            OutOfLibrary::LimitCycle => {
                self.relay = Some(Relay { from, onto, size, threshold: scale, dead_time_s });
            }
            OutOfLibrary::SensorCreep => self.filter_sensor(output, scale, Some(size), None),
            OutOfLibrary::SlewingSensor => self.filter_sensor(output, size, None, Some(scale)),
            _ => {}
        }
    }

    fn filter_sensor(&mut self, output: usize, time_constant_s: f64, creep: Option<f64>, slew: Option<f64>) {
        let state = self.grow(1);
        self.sensor_filters.push(SensorFilter { output, state, rate: 1.0 / time_constant_s, creep, slew });
    }

    /// Chooses a step that is short compared with every time constant of the model.
    fn choose_step(&mut self, a: &DMatrix<f64>) {
        let own = std::iter::once(fastest(a));
        let filters = self.filters.iter().map(|f| match f {
            Filter::Lag { rate, .. } => *rate,
            Filter::Mode { w, .. } => *w,
        });
        let sensors = self.sensor_filters.iter().map(|f| f.rate);
        let sines = self.forces.iter().map(|f| match f {
            Force::Sine { w, .. } | Force::Swinging { w, .. } => *w,
            _ => 0.0,
        });
        let fastest = own.chain(filters).chain(sensors).chain(sines).fold(0.0, f64::max);
        self.step_s = (0.15 / fastest.max(1e-9)).clamp(2e-5, 1e-3);
    }
}

/// The matrices A, B, C and D of the vehicle with changed entries.
type Matrices = (DMatrix<f64>, DMatrix<f64>, DMatrix<f64>, DMatrix<f64>);

fn changed(vehicle: &Vehicle, placed: &[(&Effect, Place)]) -> Matrices {
    let (mut a, mut b) = (vehicle.a.clone(), vehicle.b.clone());
    let (mut c, mut d) = (vehicle.c.clone(), vehicle.d.clone());
    for (effect, place) in placed {
        let Place::Entry(matrix, i, j) = *place else { continue };
        let entry = match matrix {
            Matrix::A => &mut a[(i, j)],
            Matrix::B => &mut b[(i, j)],
            Matrix::C => &mut c[(i, j)],
            Matrix::D => &mut d[(i, j)],
        };
        let factor = effect.parameter("factor").unwrap_or(1.0);
        *entry = effect.parameter("value").unwrap_or(*entry * factor);
    }
    (a, b, c, d)
}

/// Matrices A and B of another vehicle, in this vehicle's order of states and inputs.
fn successor(vehicle: &Vehicle, to: &str) -> Result<(DMatrix<f64>, DMatrix<f64>), BlindError> {
    let other = Vehicle::find_from(to, vehicle.folder.as_deref()).map_err(BlindError::effect)?;
    let missing = |what: &str, name: &str| {
        BlindError::Effect(format!("the vehicle '{to}' of a mode_transition has no {what} '{name}'"))
    };
    let states: Result<Vec<usize>, _> = vehicle
        .states
        .iter()
        .map(|s| other.state_index(&s.name).ok_or_else(|| missing("state", &s.name)))
        .collect();
    let inputs: Result<Vec<usize>, _> = vehicle
        .inputs
        .iter()
        .map(|u| other.input_index(&u.name).ok_or_else(|| missing("input", &u.name)))
        .collect();
    let (states, inputs) = (states?, inputs?);
    let a = DMatrix::from_fn(states.len(), states.len(), |i, j| other.a[(states[i], states[j])]);
    let b = DMatrix::from_fn(states.len(), inputs.len(), |i, j| other.b[(states[i], inputs[j])]);
    Ok((a, b))
}
