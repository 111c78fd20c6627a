//! Axes of one input and one output each, put together to one vehicle.

use nalgebra::DMatrix;
use whirlstand_vehicle::{Effect, Free, Kind, Matrix, Output, SignalUnit, State, Target, Vehicle};

use super::blocks::Pair;
use super::error::DraftError;
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
    /// The fitted vehicle of the axis, about the zero of its signals: with the constant of the input that holds the
    /// output at its level.
    ///
    /// # Errors
    /// When an effect does not fit, which means a mistake in this file.
    pub fn vehicle(&self) -> Result<Vehicle, DraftError> {
        let fit = &self.tried.fit;
        let mut vehicle = fit.problem.vehicle_at(&fit.theta);
        // What disturbs the motion is no part of the vehicle.
        let n = self.tried.structure.order;
        vehicle.states.truncate(n);
        vehicle.a = vehicle.a.resize(n, n, 0.0);
        vehicle.b = vehicle.b.resize(n, 1, 0.0);
        vehicle.c = vehicle.c.resize(1, n, 0.0);
        // The row of A and B that is a model and no definition; the output is the first state.
        let last = n - 1;
        let (a, b) = (vehicle.a[(last, 0)], vehicle.b[(last, 0)]);
        let trim = -a * self.pair.output_level / b - self.pair.input_level;
        if trim.is_finite() && trim.abs() > LEAST_TRIM * self.pair.input_spread {
            let place = vehicle.inputs[0].name.clone();
            let shown: f64 = format!("{trim:.3e}").parse().unwrap_or(trim);
            vehicle.effects.push(Effect::new(Kind::InputBias, &place, &[("offset", shown)])?);
        }
        Ok(vehicle)
    }
}

/// Puts axes side by side, decoupled, and angles behind them as the integrals of their rates.
///
/// # Errors
/// When an effect does not fit, which means a mistake in this file.
pub fn compose(name: &str, axes: &[Axis], angles: &[Angle]) -> Result<Vehicle, DraftError> {
    let parts = axes.iter().map(Axis::vehicle).collect::<Result<Vec<_>, _>>()?;
    let n = parts.iter().map(|v| v.states.len()).sum::<usize>() + angles.len();
    let (m, p) = (parts.len(), parts.len() + angles.len());
    let mut whole = Vehicle {
        name: name.into(),
        description: String::new(),
        states: Vec::new(),
        inputs: Vec::new(),
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
    for part in &parts {
        append(&mut whole, part);
    }
    for angle in angles {
        append_angle(&mut whole, angle);
    }
    Ok(whole)
}

/// Puts the vehicle of one axis behind those that are there.
fn append(whole: &mut Vehicle, part: &Vehicle) {
    let (row, column, output) = (whole.states.len(), whole.inputs.len(), whole.outputs.len());
    let effects = whole.effects.len();
    let n = part.states.len();
    whole.a.view_mut((row, row), (n, n)).copy_from(&part.a);
    whole.b.view_mut((row, column), (n, 1)).copy_from(&part.b);
    whole.c.view_mut((output, row), (1, n)).copy_from(&part.c);
    whole.states.extend_from_slice(&part.states);
    whole.inputs.extend_from_slice(&part.inputs);
    whole.outputs.extend_from_slice(&part.outputs);
    whole.effects.extend_from_slice(&part.effects);
    let moved = |free: &Free| {
        let target = match free.target {
            Target::Entry(Matrix::B, i, j) => Target::Entry(Matrix::B, row + i, column + j),
            Target::Entry(matrix, i, j) => Target::Entry(matrix, row + i, row + j),
            Target::Effect(index, parameter) => Target::Effect(effects + index, parameter),
        };
        Free { target, ..free.clone() }
    };
    whole.free.extend(part.free.iter().map(moved));
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
