//! A test flight as data: its options, its signals, its expected accuracy, and errors of the design.

use std::collections::BTreeMap;
use whirlstand_logs::shown::ShownUnit;

use serde::{Deserialize, Serialize};
use whirlstand_vehicle::SimulatorError;

use super::closed_loop::ClosedLoop;
use super::signals::{Kind, Shape};

/// Schema identifier of [`Flight`].
pub const EXCITATION_SCHEMA: &str = "whirlstand.excitation.v1";

/// Options of a test flight.
#[derive(Debug, Clone)]
pub struct Options {
    /// Shape of the inputs.
    pub shape: Shape,
    /// Largest input, as a share of its limits where it has some, else in its unit; largest setpoint, as a share of
    /// the limit of the output that shows it.
    pub amplitude: f64,
    /// Largest allowed predicted outputs: name and value, SI; angles that are not named have `angle_limit`.
    pub limits: Vec<(String, f64)>,
    /// Largest allowed predicted angle, rad.
    pub angle_limit: f64,
    /// Controller in the loop, if any.
    pub closed: Option<ClosedLoop>,
}

/// A test flight and the expected accuracy of a fit to its record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Flight {
    /// Schema identifier, always [`EXCITATION_SCHEMA`].
    pub schema: String,
    /// Name of the vehicle.
    pub vehicle: String,
    /// Kind of test input.
    pub kind: Kind,
    /// Time between two steps, s.
    pub period_s: f64,
    /// Length of the flight, s.
    pub duration_s: f64,
    /// Name of the control law in the loop; `None` for an open loop.
    pub controller: Option<String>,
    /// Point at which the test signals enter: `stick` (as inputs, or added to the controller's command) or
    /// `setpoint`.
    pub through: String,
    /// Largest value of each test signal: name and value, SI.
    pub amplitudes: Vec<(String, f64)>,
    /// Largest value of each applied input: name and value, SI.
    pub commands: Vec<(String, f64)>,
    /// SI units of the test signals and of the inputs, by name; empty for a dimensionless number.
    #[serde(default)]
    pub units: BTreeMap<String, ShownUnit>,
    /// Largest predicted value of each output: name, unit and value, SI.
    pub peaks: Vec<(String, ShownUnit, f64)>,
    /// Expected accuracy of each free parameter.
    pub parameters: Vec<ExpectedParameter>,
    /// Detectability of each effect.
    pub effects: Vec<ExpectedEffect>,
    /// Remarks on the design.
    pub remarks: Vec<String>,
    /// Test signals, one vector each, SI.
    #[serde(skip)]
    pub signals: Vec<Vec<f64>>,
}

/// Expected accuracy of a parameter, in the units of the vehicle file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ExpectedParameter {
    /// Name of the parameter.
    pub name: String,
    /// Value in the vehicle file.
    pub value: f64,
    /// Unit of the value and its error; empty for a dimensionless number.
    #[serde(default)]
    pub unit: String,
    /// Smallest standard error of any unbiased estimate (Cramer-Rao bound) under the declared sensor noise;
    /// `None` when the flight does not determine the parameter.
    pub standard_error: Option<f64>,
}

/// Expected detectability of an effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ExpectedEffect {
    /// Name of the effect.
    pub effect: String,
    /// Place of the effect: a signal, a state or a matrix entry.
    pub place: String,
    /// The parameter of the effect that is varied.
    pub parameter: String,
    /// Value of the parameter at which `detectability` is computed, SI.
    pub size: f64,
    /// SI unit of `size` and `least_size`; empty for a dimensionless number.
    #[serde(default)]
    pub unit: ShownUnit,
    /// Detectability: squared norm, relative to the noise, of the effect's change of the outputs, without the
    /// part that the free parameters and the initial state could imitate. About 12 is needed, 30 is safe.
    pub detectability: f64,
    /// Smallest value of the parameter with a detectability of 12, SI, if the change is proportional to it.
    pub least_size: f64,
}

/// Reason why a flight cannot be designed.
#[derive(Debug, thiserror::Error)]
pub enum ExciteError {
    /// A limit names an output that the vehicle does not have.
    #[error("'{vehicle}' has no output '{name}' to limit; it has {}", known.join(", "))]
    NoOutput {
        /// Name of the vehicle.
        vehicle: String,
        /// Name in the limit.
        name: String,
        /// Outputs of the vehicle.
        known: Vec<String>,
    },
    /// The frequencies do not fit the period and the length of the flight.
    #[error(
        "the frequencies {lowest_hz} to {highest_hz} Hz do not fit a flight of {duration_s} s at a period of {period_s} s: at least one period of the lowest and at most a tenth of the sampling rate are needed"
    )]
    Frequencies {
        /// Lowest frequency, Hz.
        lowest_hz: f64,
        /// Highest frequency, Hz.
        highest_hz: f64,
        /// Length of the flight, s.
        duration_s: f64,
        /// Sampling period, s.
        period_s: f64,
    },
    /// Even a thousandth of the amplitude exceeds a limit.
    #[error(
        "the model exceeds the limit of {name} even with inputs a thousand times smaller than requested: it is unstable; fly with a controller in the loop (--controller lqr), or for a shorter time"
    )]
    Unstable {
        /// Name of the output.
        name: String,
    },
    /// An integral of the input exceeds a limit.
    #[error(
        "the model integrates its inputs, and {name} exceeds its limit even with inputs a thousand times smaller than requested: allow more with --limit, fly with a controller in the loop (--controller lqr), or for a shorter time"
    )]
    Integrates {
        /// Name of the output.
        name: String,
    },
    /// The range of a setpoint is unknown.
    #[error(
        "the range of the setpoint of {name} is unknown: give the largest value of the output that measures it, as in --limit '{name}=2 {unit}'"
    )]
    NoRange {
        /// Name of the state.
        name: String,
        /// Unit of the state.
        unit: String,
    },
    /// The vehicle cannot be simulated.
    #[error(transparent)]
    Simulator(#[from] SimulatorError),
}
