//! Axes of one input and one output each, put together to one vehicle. The input may be rotors that act together.

use nalgebra::DMatrix;
use whirlstand_vehicle::{Effect, Free, Input, Kind, Matrix, Output, SignalUnit, State, Target, Vehicle};

use super::blocks::Pair;
use super::error::DraftError;
use super::mixer::Mixer;
use super::select::Tried;
use super::structure::Structure;

/// A constant of the input that matters less than this share of the input's spread is left out.
const LEAST_TRIM: f64 = 0.05;

/// One axis of the vehicle.
#[derive(Debug, Clone)]
pub struct Axis {
    /// Data of the axis.
    pub pair: Pair,
    /// The chosen structure and its fit.
    pub tried: Tried,
    /// All structures that were fitted, with their root mean square errors on held-out data, SI.
    pub all: Vec<(Structure, f64)>,
}

/// An angle that is the integral of a rate.
#[derive(Debug, Clone, PartialEq)]
pub struct Angle {
    /// Name of the angle.
    pub name: String,
    /// SI unit of the angle.
    pub unit: SignalUnit,
    /// Name of the rate.
    pub rate: String,
}

impl Axis {
    /// The fitted vehicle of the axis, about the zero of its signals.
    pub fn vehicle(&self) -> Vehicle {
        let fit = &self.tried.fit;
        let mut vehicle = fit.problem.vehicle_at(&fit.theta);
        // What disturbs the motion is no part of the vehicle.
        let n = self.tried.structure.order;
        vehicle.states.truncate(n);
        vehicle.a = vehicle.a.resize(n, n, 0.0);
        vehicle.b = vehicle.b.resize(n, 1, 0.0);
        vehicle.c = vehicle.c.resize(1, n, 0.0);
        vehicle
    }

    /// The constant of the input that holds the output at its level; 0 where it hardly matters.
    fn trim(&self, vehicle: &Vehicle) -> f64 {
        // The row of A and B that is a model and no definition; the output is the first state.
        let last = vehicle.states.len() - 1;
        let (a, b) = (vehicle.a[(last, 0)], vehicle.b[(last, 0)]);
        let trim = -a * self.pair.output_level / b - self.pair.input_level;
        let matters = trim.is_finite() && trim.abs() > LEAST_TRIM * self.pair.input_spread;
        if matters { trim } else { 0.0 }
    }
}

/// A vehicle of several axes.
#[derive(Debug, Clone)]
pub struct Composed {
    /// The vehicle.
    pub vehicle: Vehicle,
    /// The axis that each of its free values comes from, and which of the axis' own it is.
    pub origins: Vec<(usize, usize)>,
}

/// Puts axes side by side, decoupled, and angles behind them as the integrals of their rates. Where rotors act together,
/// every axis may be driven by all of them.
///
/// # Errors
/// When an effect does not fit, which means a mistake in this file.
pub fn compose(
    name: &str,
    axes: &[Axis],
    angles: &[Angle],
    mixer: Option<&Mixer>,
) -> Result<Composed, DraftError> {
    let parts: Vec<Vehicle> = axes.iter().map(Axis::vehicle).collect();
    let inputs = inputs(&parts, mixer);
    let n = parts.iter().map(|v| v.states.len()).sum::<usize>() + angles.len();
    let (m, p) = (inputs.len(), parts.len() + angles.len());
    let vehicle = Vehicle {
        name: name.into(),
        description: String::new(),
        states: Vec::new(),
        inputs,
        outputs: Vec::new(),
        a: DMatrix::zeros(n, n),
        b: DMatrix::zeros(n, m),
        c: DMatrix::zeros(p, n),
        d: DMatrix::zeros(p, m),
        effects: Vec::new(),
        free: Vec::new(),
        fit: Vec::new(),
        map: Vec::new(),
        provenance: Vec::new(),
        source_text: String::new(),
        folder: None,
    };
    let mut whole = Composed { vehicle, origins: Vec::new() };
    for (axis, part) in parts.iter().enumerate() {
        let signs = mixer.and_then(|m| m.signs(&part.inputs[0].name));
        let drives: Vec<(usize, f64)> = match signs {
            Some(signs) => signs.iter().copied().enumerate().filter(|(_, sign)| *sign != 0.0).collect(),
            None => vec![(axis, 1.0)],
        };
        append(&mut whole, axis, part, &drives)?;
    }
    for (input, offset) in whole.vehicle.inputs.clone().iter().zip(trims(axes, &parts, mixer)) {
        let shown: f64 = format!("{offset:.3e}").parse().unwrap_or(offset);
        if shown != 0.0 {
            let bias = Effect::new(Kind::InputBias, &input.name, &[("offset", shown)])?;
            whole.vehicle.effects.push(bias);
        }
    }
    for angle in angles {
        append_angle(&mut whole.vehicle, angle);
    }
    Ok(whole)
}

/// The inputs of all axes: one each, or the rotors.
fn inputs(parts: &[Vehicle], mixer: Option<&Mixer>) -> Vec<Input> {
    let own = parts.iter().map(|part| part.inputs[0].clone());
    let Some(mixer) = mixer else { return own.collect() };
    let rotor = |name: &String| parts.first().map(|p| Input { name: name.clone(), ..p.inputs[0].clone() });
    mixer.rotors.iter().filter_map(|r| rotor(&r.name)).collect()
}

/// Constants of all inputs that hold the outputs at their levels.
fn trims(axes: &[Axis], parts: &[Vehicle], mixer: Option<&Mixer>) -> Vec<f64> {
    let own: Vec<(&str, f64)> =
        axes.iter().zip(parts).map(|(axis, part)| (part.inputs[0].name.as_str(), axis.trim(part))).collect();
    let rotors = mixer.and_then(|mixer| mixer.constants(&own));
    rotors.unwrap_or_else(|| own.into_iter().map(|(_, trim)| trim).collect())
}

/// Puts the vehicle of one axis behind those that are there. `drives` are the inputs of the whole that its own one is the
/// sum of, each with its sign.
fn append(
    whole: &mut Composed,
    axis: usize,
    part: &Vehicle,
    drives: &[(usize, f64)],
) -> Result<(), DraftError> {
    let vehicle = &mut whole.vehicle;
    let (row, output, n) = (vehicle.states.len(), vehicle.outputs.len(), part.states.len());
    vehicle.a.view_mut((row, row), (n, n)).copy_from(&part.a);
    for (column, sign) in drives {
        vehicle
            .b
            .view_mut((row, *column), (n, 1))
            .copy_from(&part.b.map(|b| if b == 0.0 { 0.0 } else { sign * b }));
    }
    vehicle.c.view_mut((output, row), (1, n)).copy_from(&part.c);
    vehicle.states.extend_from_slice(&part.states);
    vehicle.outputs.extend_from_slice(&part.outputs);
    // Where each effect of the axis went: what an axis before has shown of the same rotors is there already.
    let mut placed: Vec<Vec<usize>> = Vec::new();
    for effect in &part.effects {
        let parameter = if effect.kind() == Kind::InputDelay { "delay_s" } else { "time_constant_s" };
        let value = effect.parameter(parameter).unwrap_or(0.0);
        let mut places = Vec::new();
        for (column, _) in drives {
            let place = vehicle.inputs[*column].name.clone();
            if !vehicle.effects.iter().any(|e| e.kind() == effect.kind() && e.place() == place) {
                places.push(vehicle.effects.len());
                vehicle.effects.push(Effect::new(effect.kind(), &place, &[(parameter, value)])?);
            }
        }
        placed.push(places);
    }
    for (own, free) in part.free.iter().enumerate() {
        let targets: Vec<Target> = match free.target {
            Target::Entry(Matrix::B, i, _) => {
                drives.iter().map(|(column, _)| Target::Entry(Matrix::B, row + i, *column)).collect()
            }
            Target::Entry(matrix, i, j) => vec![Target::Entry(matrix, row + i, row + j)],
            Target::Effect(index, parameter) => {
                placed[index].iter().map(|e| Target::Effect(*e, parameter)).collect()
            }
        };
        whole.origins.extend(targets.iter().map(|_| (axis, own)));
        vehicle.free.extend(targets.into_iter().map(|target| Free { target, ..free.clone() }));
    }
    Ok(())
}

/// Puts an angle behind the states and outputs that are there; one without its rate is left out by the caller.
fn append_angle(whole: &mut Vehicle, angle: &Angle) {
    let (state, output) = (whole.states.len(), whole.outputs.len());
    if let Some(rate) = whole.state_index(&angle.rate) {
        whole.a[(state, rate)] = 1.0;
    }
    whole.c[(output, state)] = 1.0;
    whole.states.push(State { name: angle.name.clone(), unit: angle.unit.clone(), bound: None });
    whole.outputs.push(Output {
        name: angle.name.clone(),
        unit: angle.unit.clone(),
        noise: 0.0,
        bias: 0.0,
        quantization: 0.0,
        every: 1,
        vibration: None,
    });
}
