//! A test flight as data: its options, its signals, the accuracy to expect, and errors of the design.

use std::collections::BTreeMap;
use whirlstand_logs::shown::ShownUnit;

use serde::{Deserialize, Serialize};
use whirlstand_vehicle::SimulatorError;

use super::closed_loop::ClosedLoop;
use super::signals::{Kind, Shape};

/// Schema of [`Flight`].
pub const EXCITATION_SCHEMA: &str = "whirlstand.excitation.v1";

/// Options of a test flight.
#[derive(Debug, Clone)]
pub struct Options {
    /// Shape of the inputs.
    pub shape: Shape,
    /// Largest input, as a share of its limits where it has some, else in its unit; largest setpoint, as a share of
    /// the limit of the output that shows it.
    pub amplitude: f64,
    /// Greatest allowed predicted outputs: name and value, SI; angles that are not named have `angle_limit`.
    pub limits: Vec<(String, f64)>,
    /// Greatest allowed predicted angle, rad.
    pub angle_limit: f64,
    /// The controller that stays on, if one does.
    pub closed: Option<ClosedLoop>,
}

/// A test flight and the accuracy to expect of a fit to its record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Flight {
    /// Always [`EXCITATION_SCHEMA`].
    pub schema: String,
    /// Name of the vehicle.
    pub vehicle: String,
    /// Kind of test input.
    pub kind: Kind,
    /// Time between two steps, s.
    pub period_s: f64,
    /// Length of the flight, s.
    pub duration_s: f64,
    /// Law of the controller that stays on; `None` for an open loop.
    pub controller: Option<String>,
    /// Where the test signals enter: `stick` (as inputs, or added to the controller's command) or `setpoint`.
    pub through: String,
    /// Greatest value of each test signal: name and value, SI.
    pub amplitudes: Vec<(String, f64)>,
    /// Greatest value of each input in force: name and value, SI.
    pub commands: Vec<(String, f64)>,
    /// SI units of the test signals and of the inputs, by name; empty for a pure number.
    #[serde(default)]
    pub units: BTreeMap<String, ShownUnit>,
    /// Greatest predicted output: name, unit and value, SI.
    pub peaks: Vec<(String, ShownUnit, f64)>,
    /// Accuracy to expect of each free parameter.
    pub parameters: Vec<ExpectedParameter>,
    /// Detectability to expect of each effect.
    pub effects: Vec<ExpectedEffect>,
    /// Remarks on the design.
    pub remarks: Vec<String>,
    /// Test signals, one vector each, SI.
    #[serde(skip)]
    pub signals: Vec<Vec<f64>>,
}

/// The accuracy to expect of a parameter, in the units of the vehicle file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ExpectedParameter {
    /// Name of the parameter.
    pub name: String,
    /// Value in the vehicle file.
    pub value: f64,
    /// Unit of the value and its error; empty for a pure number.
    #[serde(default)]
    pub unit: String,
    /// Least standard error that any estimate can have (Cramer and Rao) under the declared sensor noise; `None` when
    /// the flight does not determine it.
    pub standard_error: Option<f64>,
}

/// The detectability to expect of an effect.
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
    /// SI unit of `size` and `least_size`; empty for a pure number.
    #[serde(default)]
    pub unit: ShownUnit,
    /// Detectability: squared ratio to the noise of the change that the effect makes in the outputs, without the part
    /// that the free parameters and the initial state could imitate. About 12 is needed, 30 is safe.
    pub detectability: f64,
    /// Least value of the parameter with a detectability of 12, SI, if the change grows in proportion to it.
    pub least_size: f64,
}

/// Why a flight cannot be designed.
#[derive(Debug, thiserror::Error)]
pub enum ExciteError {
    /// A limit names an output that the vehicle does not have.
    #[error("'{vehicle}' has no output '{name}' to limit; it has {}", known.join(", "))]
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
        "the model exceeds the limit of {name} even with inputs a thousand times smaller than requested: it is unstable; fly with a controller in the loop (--controller lqr), or for a shorter time"
    )]
    Unstable {
        /// The output.
        name: String,
    },
    /// An integral of the input grows too far.
    #[error(
        "the model integrates its inputs, and {name} exceeds its limit even with inputs a thousand times smaller than requested: allow more with --limit, fly with a controller in the loop (--controller lqr), or for a shorter time"
    )]
    Integrates {
        /// The output.
        name: String,
    },
    /// Nothing says how far a setpoint may move.
    #[error(
        "the range of the setpoint of {name} is unknown: give the largest value of the output that measures it, as in --limit '{name}=2 {unit}'"
    )]
    NoRange {
        /// The state.
        name: String,
        /// Its unit.
        unit: String,
    },
    /// The vehicle cannot be simulated.
    #[error(transparent)]
    Simulator(#[from] SimulatorError),
}
