//! Composition of axes with one input and one output each into a vehicle. An input may be a combination of
//! rotors.

use nalgebra::DMatrix;
use whirlstand_vehicle::{Effect, Free, Input, Kind, Matrix, Output, SignalUnit, State, Target, Vehicle};

use super::blocks::Pair;
use super::error::DraftError;
use super::mixer::Mixer;
use super::select::Tried;
use super::structure::Structure;

/// Trim constants below this share of the input's spread are left out.
const LEAST_TRIM: f64 = 0.05;

/// One axis of the vehicle.
#[derive(Debug, Clone)]
pub struct Axis {
    /// Data of input and output.
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
    /// The fitted vehicle of the axis, with signals that include their means.
    pub fn vehicle(&self) -> Vehicle {
        let fit = &self.tried.fit;
        fit.problem.vehicle_at(&fit.theta)
    }

    /// Input that holds the output at its mean (trim); 0 where it is negligible.
    fn trim(&self, vehicle: &Vehicle) -> f64 {
        // The row of A and B with the dynamics, not a definition; the output is the first state.
        let last = vehicle.states.len() - 1;
        let (a, b) = (vehicle.a[(last, 0)], vehicle.b[(last, 0)]);
        let trim = -a * self.pair.output_level / b - self.pair.input_level;
        let matters = trim.is_finite() && trim.abs() > LEAST_TRIM * self.pair.input_spread;
        if matters { trim } else { 0.0 }
    }
}

/// A vehicle of several axes, with the origin of its parameters.
#[derive(Debug, Clone)]
pub struct Composed {
    /// The vehicle.
    pub vehicle: Vehicle,
    /// Origin of each free parameter: index of the axis, and index among the axis' parameters.
    pub origins: Vec<(usize, usize)>,
}

/// Combines axes side by side, decoupled, followed by angles as the integrals of their rates. Where rotors
/// act together, every axis may be driven by all of them.
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

/// Inputs of all axes: one each, or the rotors.
fn inputs(parts: &[Vehicle], mixer: Option<&Mixer>) -> Vec<Input> {
    let own = parts.iter().map(|part| part.inputs[0].clone());
    let Some(mixer) = mixer else { return own.collect() };
    let rotor = |name: &String| parts.first().map(|p| Input { name: name.clone(), ..p.inputs[0].clone() });
    mixer.rotors.iter().filter_map(|r| rotor(&r.name)).collect()
}

/// Trim constants of all inputs, which hold the outputs at their means.
fn trims(axes: &[Axis], parts: &[Vehicle], mixer: Option<&Mixer>) -> Vec<f64> {
    let own: Vec<(&str, f64)> =
        axes.iter().zip(parts).map(|(axis, part)| (part.inputs[0].name.as_str(), axis.trim(part))).collect();
    let rotors = mixer.and_then(|mixer| mixer.constants(&own));
    rotors.unwrap_or_else(|| own.into_iter().map(|(_, trim)| trim).collect())
}

/// Appends the vehicle of one axis. `drives` are the inputs of the whole vehicle whose sum is the axis'
/// input, each with its sign.
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
    // New index of each effect of the axis; an effect that an earlier axis has for the same rotors is reused.
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

/// Appends an angle after the existing states and outputs; the caller leaves out angles without their rate.
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
