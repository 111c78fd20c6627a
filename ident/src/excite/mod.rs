//! Test flights: inputs that tell parameters apart, within limits, and what they will tell.

mod judge;
pub mod signals;
mod words;

use serde::{Deserialize, Serialize};
use whirlstand_vehicle::{Simulator, SimulatorError, Vehicle};

pub use signals::{Kind, Shape};

/// Schema of [`Flight`].
pub const EXCITATION_SCHEMA: &str = "whirlstand.excitation.v1";

/// What is asked of a test flight.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Shape of the inputs.
    pub shape: Shape,
    /// Largest input, as a share of its limits where it has some, else in its unit.
    pub amplitude: f64,
    /// Largest predicted outputs: name and value, SI; for outputs that are angles and not named, `angle_limit`.
    pub limits: Vec<(String, f64)>,
    /// Largest predicted angle, rad.
    pub angle_limit: f64,
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
    /// Greatest value of each input: name and value, SI.
    pub amplitudes: Vec<(String, f64)>,
    /// Greatest predicted output: name, unit and value, SI.
    pub peaks: Vec<(String, String, f64)>,
    /// Free parameters: what a record of this flight will tell of each.
    pub parameters: Vec<ExpectedParameter>,
    /// Effects: what a record will show of each.
    pub effects: Vec<ExpectedEffect>,
    /// Remarks.
    pub remarks: Vec<String>,
    /// Inputs, one vector each, SI.
    #[serde(skip)]
    pub inputs: Vec<Vec<f64>>,
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
        "the model leaves the limit of {name} under inputs a thousand times smaller than asked for: it is unstable; fly with a controller in the loop, or for a shorter time"
    )]
    Unstable {
        /// The output.
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
    let unit = signals::signals(shape, vehicle.inputs.len());
    let mut inputs: Vec<Vec<f64>> = unit
        .iter()
        .zip(&vehicle.inputs)
        .map(|(signal, input)| {
            let room = input.upper.min(-input.lower);
            let top = options.amplitude * if room.is_finite() && room > 0.0 { room } else { 1.0 };
            signal.iter().map(|v| top * v).collect()
        })
        .collect();
    let limits = limits(vehicle, options);
    let mut peaks = peaks(vehicle, &inputs, shape)?;
    let mut shrunk = 1.0;
    // A linear vehicle needs one step, one with thresholds a few.
    for _ in 0..40 {
        let worst = peaks.iter().zip(&limits).map(|(p, l)| p / l).fold(0.0, f64::max);
        if worst <= 1.0 {
            break;
        }
        let factor = if worst.is_finite() { (0.99 / worst).max(0.1) } else { 0.1 };
        shrunk *= factor;
        inputs.iter_mut().flatten().for_each(|v| *v *= factor);
        peaks = self::peaks(vehicle, &inputs, shape)?;
        if shrunk < 1e-3 {
            let name = peaks.iter().zip(&limits).position(|(p, l)| p > l).unwrap_or(0);
            return Err(ExciteError::Unstable { name: vehicle.outputs[name].name.clone() });
        }
    }
    let greatest = |v: &Vec<f64>| v.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let mut flight = Flight {
        schema: EXCITATION_SCHEMA.into(),
        vehicle: vehicle.name.clone(),
        kind: shape.kind,
        period_s: shape.period_s,
        duration_s,
        amplitudes: vehicle.inputs.iter().zip(&inputs).map(|(i, v)| (i.name.clone(), greatest(v))).collect(),
        peaks: vehicle
            .outputs
            .iter()
            .zip(&peaks)
            .map(|(o, p)| (o.name.clone(), o.unit.si_symbol(), *p))
            .collect(),
        parameters: Vec::new(),
        effects: Vec::new(),
        remarks: Vec::new(),
        inputs,
    };
    if shrunk < 1.0 {
        flight.remarks.push(format!(
            "The inputs were made smaller by a factor of {:.2}, so that the predicted outputs stay within their limits.",
            1.0 / shrunk
        ));
    }
    judge::judge(vehicle, &mut flight)?;
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

/// Greatest predicted values of the outputs.
fn peaks(vehicle: &Vehicle, inputs: &[Vec<f64>], shape: &Shape) -> Result<Vec<f64>, SimulatorError> {
    let mut simulator = Simulator::expected(vehicle, shape.period_s)?;
    let mut peaks = vec![0.0f64; vehicle.outputs.len()];
    let mut u = vec![0.0; inputs.len()];
    for k in 0..shape.steps {
        u.iter_mut().zip(inputs).for_each(|(u, v)| *u = v[k]);
        simulator.apply(&u);
        peaks.iter_mut().zip(simulator.measure()).for_each(|(p, y)| *p = p.max(y.abs()));
        simulator.advance();
    }
    Ok(if simulator.diverged() { vec![f64::INFINITY; peaks.len()] } else { peaks })
}
