//! Test flights: inputs that tell parameters apart, within limits, and what they will tell.

mod closed_loop;
mod judge;
pub mod signals;
mod words;

use serde::{Deserialize, Serialize};
use whirlstand_vehicle::{SimulatorError, Vehicle};

pub use closed_loop::{ClosedLoop, Flown, Through, fly};
pub use signals::{Kind, Shape};

/// Schema of [`Flight`].
pub const EXCITATION_SCHEMA: &str = "whirlstand.excitation.v1";

/// What is asked of a test flight.
#[derive(Debug, Clone)]
pub struct Options {
    /// Shape of the inputs.
    pub shape: Shape,
    /// Largest input, as a share of its limits where it has some, else in its unit; largest setpoint, as a share of
    /// the limit of the output that shows it.
    pub amplitude: f64,
    /// Largest predicted outputs: name and value, SI; for outputs that are angles and not named, `angle_limit`.
    pub limits: Vec<(String, f64)>,
    /// Largest predicted angle, rad.
    pub angle_limit: f64,
    /// The controller that stays on, if one does.
    pub closed: Option<ClosedLoop>,
}

/// A test flight and what it is expected to tell.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Flight {
    /// [`EXCITATION_SCHEMA`].
    pub schema: String,
    /// Vehicle.
    pub vehicle: String,
    /// Kind of input.
    pub kind: Kind,
    /// Period, s.
    pub period_s: f64,
    /// Length, s.
    pub duration_s: f64,
    /// Law of the controller that stays on; `None` for an open loop.
    pub controller: Option<String>,
    /// Where the test signals enter: `stick` (as inputs, or added to the controller's command) or `setpoint`.
    pub through: String,
    /// Greatest value of each test signal: name and value, SI.
    pub amplitudes: Vec<(String, f64)>,
    /// Greatest value of each input in force: name and value, SI.
    pub commands: Vec<(String, f64)>,
    /// Greatest predicted output: name, unit and value, SI.
    pub peaks: Vec<(String, String, f64)>,
    /// Free parameters: what a record of this flight will tell of each.
    pub parameters: Vec<ExpectedParameter>,
    /// Effects: what a record will show of each.
    pub effects: Vec<ExpectedEffect>,
    /// Remarks.
    pub remarks: Vec<String>,
    /// Test signals, one vector each, SI.
    #[serde(skip)]
    pub signals: Vec<Vec<f64>>,
}

/// What is expected of a parameter, in the units of the vehicle file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ExpectedParameter {
    /// Name.
    pub name: String,
    /// Value in the vehicle file.
    pub value: f64,
    /// Least standard error that any estimate can have (Cramer and Rao) under the declared sensor noise; `None` when
    /// the flight does not determine it.
    pub standard_error: Option<f64>,
}

/// What is expected of an effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ExpectedEffect {
    /// Effect.
    pub effect: String,
    /// Place.
    pub place: String,
    /// Parameter.
    pub parameter: String,
    /// Size for which the figure below holds, SI.
    pub size: f64,
    /// Detectability: squared ratio of what it changes in the outputs, beyond what a change of the free parameters and
    /// of the initial state could imitate, to the noise. About 12 is needed, 30 is safe.
    pub detectability: f64,
    /// Least size that reaches 12, SI, if it grew in proportion.
    pub least_size: f64,
}

/// Why a flight cannot be designed.
#[derive(Debug, thiserror::Error)]
pub enum ExciteError {
    /// A limit for an output that there is not.
    #[error("'{vehicle}' has no output '{name}' to be limited; it has {}", known.join(", "))]
    NoOutput {
        /// The vehicle.
        vehicle: String,
        /// The name.
        name: String,
        /// Its outputs.
        known: Vec<String>,
    },
    /// The frequencies do not fit period and length.
    #[error(
        "the frequencies {lowest_hz} to {highest_hz} Hz do not fit a flight of {duration_s} s at a period of {period_s} s: at least one period of the lowest and at most a tenth of the sampling rate are needed"
    )]
    Frequencies {
        /// Lowest, Hz.
        lowest_hz: f64,
        /// Highest, Hz.
        highest_hz: f64,
        /// Length, s.
        duration_s: f64,
        /// Period, s.
        period_s: f64,
    },
    /// Even a thousandth of the amplitude breaks a limit.
    #[error(
        "the model leaves the limit of {name} under inputs a thousand times smaller than asked for: it is unstable; fly with a controller in the loop (--controller lqr), or for a shorter time"
    )]
    Unstable {
        /// The output.
        name: String,
    },
    /// Nothing says how far a setpoint may move.
    #[error(
        "nothing says how far the setpoint of {name} may move: give the greatest value of the output that shows it, as in --limit {name}=2"
    )]
    NoRange {
        /// The state.
        name: String,
    },
    /// The vehicle cannot be simulated.
    #[error(transparent)]
    Simulator(#[from] SimulatorError),
}

/// Designs a flight for `vehicle` as its file describes it, effects included.
///
/// # Errors
/// [`ExciteError`].
pub fn design(vehicle: &Vehicle, options: &Options) -> Result<Flight, ExciteError> {
    let shape = &options.shape;
    let duration_s = shape.steps as f64 * shape.period_s;
    let fits = shape.lowest_hz * duration_s >= 1.0
        && shape.highest_hz > shape.lowest_hz
        && shape.highest_hz * shape.period_s <= 0.1;
    if !fits {
        return Err(ExciteError::Frequencies {
            lowest_hz: shape.lowest_hz,
            highest_hz: shape.highest_hz,
            duration_s,
            period_s: shape.period_s,
        });
    }
    if let Some((name, _)) = options.limits.iter().find(|(n, _)| vehicle.output_index(n).is_none()) {
        return Err(ExciteError::NoOutput {
            vehicle: vehicle.name.clone(),
            name: name.clone(),
            known: vehicle.outputs.iter().map(|o| o.name.clone()).collect(),
        });
    }
    let limits = limits(vehicle, options);
    let tops = tops(vehicle, options, &limits)?;
    let unit = signals::signals(shape, tops.len());
    let mut signals: Vec<Vec<f64>> =
        unit.iter().zip(&tops).map(|(signal, (_, top))| signal.iter().map(|v| top * v).collect()).collect();
    let closed = options.closed.as_ref();
    let mut flown = fly(vehicle, shape.period_s, &signals, closed)?;
    let mut shrunk = 1.0;
    // A linear vehicle needs one step, one with thresholds a few.
    for _ in 0..40 {
        let peaks = peaks(&flown, vehicle.outputs.len());
        let worst = peaks.iter().zip(&limits).map(|(p, l)| p / l).fold(0.0, f64::max);
        if worst <= 1.0 {
            break;
        }
        let factor = if worst.is_finite() { (0.99 / worst).max(0.1) } else { 0.1 };
        shrunk *= factor;
        if shrunk < 1e-3 {
            let name = peaks.iter().zip(&limits).position(|(p, l)| p > l).unwrap_or(0);
            return Err(ExciteError::Unstable { name: vehicle.outputs[name].name.clone() });
        }
        signals.iter_mut().flatten().for_each(|v| *v *= factor);
        flown = fly(vehicle, shape.period_s, &signals, closed)?;
    }
    let greatest = |v: &Vec<f64>| v.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let mut flight = Flight {
        schema: EXCITATION_SCHEMA.into(),
        vehicle: vehicle.name.clone(),
        kind: shape.kind,
        period_s: shape.period_s,
        duration_s,
        controller: closed.map(|c| c.law.clone()),
        through: match closed.map(|c| &c.through) {
            Some(Through::Setpoint(_)) => "setpoint".into(),
            _ => "stick".into(),
        },
        amplitudes: tops.iter().zip(&signals).map(|((name, _), v)| (name.clone(), greatest(v))).collect(),
        commands: vehicle
            .inputs
            .iter()
            .zip(greatest_of(&flown.inputs, vehicle.inputs.len()))
            .map(|(i, v)| (i.name.clone(), v))
            .collect(),
        peaks: vehicle
            .outputs
            .iter()
            .zip(peaks(&flown, vehicle.outputs.len()))
            .map(|(o, p)| (o.name.clone(), o.unit.si_symbol(), p))
            .collect(),
        parameters: Vec::new(),
        effects: Vec::new(),
        remarks: Vec::new(),
        signals,
    };
    if shrunk < 1.0 {
        flight.remarks.push(format!(
            "The test signals were made smaller by a factor of {:.2}, so that the predicted outputs stay within their limits.",
            1.0 / shrunk
        ));
    }
    judge::judge(vehicle, &mut flight, closed)?;
    Ok(flight)
}

fn limits(vehicle: &Vehicle, options: &Options) -> Vec<f64> {
    vehicle
        .outputs
        .iter()
        .map(|o| match options.limits.iter().find(|(n, _)| *n == o.name) {
            Some((_, limit)) => *limit,
            None if o.unit.si_symbol() == "rad" => options.angle_limit,
            None => f64::INFINITY,
        })
        .collect()
}

/// Name and greatest value of each test signal.
fn tops(vehicle: &Vehicle, options: &Options, limits: &[f64]) -> Result<Vec<(String, f64)>, ExciteError> {
    if let Some(ClosedLoop { through: Through::Setpoint(states), .. }) = &options.closed {
        return states
            .iter()
            .map(|&j| {
                let name = vehicle.states[j].name.clone();
                let shown = (0..limits.len()).find(|i| {
                    vehicle.c[(*i, j)] != 0.0 && vehicle.c.row(*i).iter().filter(|c| **c != 0.0).count() == 1
                });
                match shown.map(|i| limits[i] / vehicle.c[(i, j)].abs()) {
                    Some(range) if range.is_finite() => Ok((name, options.amplitude * range)),
                    _ => Err(ExciteError::NoRange { name }),
                }
            })
            .collect();
    }
    Ok(vehicle
        .inputs
        .iter()
        .map(|input| {
            let room = input.upper.min(-input.lower);
            let room = if room.is_finite() && room > 0.0 { room } else { 1.0 };
            (input.name.clone(), options.amplitude * room)
        })
        .collect())
}

/// Greatest predicted values of the outputs.
fn peaks(flown: &Flown, outputs: usize) -> Vec<f64> {
    if flown.diverged { vec![f64::INFINITY; outputs] } else { greatest_of(&flown.outputs, outputs) }
}

/// Greatest absolute value of each column.
fn greatest_of(rows: &[f64], columns: usize) -> Vec<f64> {
    let mut greatest = vec![0.0f64; columns];
    for row in rows.chunks_exact(columns.max(1)) {
        greatest.iter_mut().zip(row).for_each(|(g, v)| *g = g.max(v.abs()));
    }
    greatest
}
