//! Options of the calls that work on files: design, simulate, logs, vehicles, launch files.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::JsonArg;
use super::quantity::{hertz, moment, seconds};

/// Design a control law: gains, closed-loop poles and margins.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    whirlstand design quadrotor --law smc\n  \
    whirlstand design mine.toml --law ppc --json")]
pub(crate) struct DesignArgs {
    /// Built-in vehicle or path of a vehicle file.
    pub vehicle: String,
    /// Control law: lqr, ppc (pole placement) or smc (sliding mode).
    #[arg(long)]
    pub law: String,
    /// Rate of the control loop, in Hz or with a unit.
    #[arg(long, value_name = "FREQUENCY", value_parser = hertz, default_value_t = 200.0)]
    pub rate: f64,
    /// Set an option of [controller] as in a launch file, for example --set boundary_layer=0.2
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    #[command(flatten)]
    pub json: JsonArg,
    /// Folder for report.html: steps, Bode plots and poles.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// Simulate a vehicle's open-loop response to recorded inputs.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  \
    whirlstand simulate helicopter-hover --input sticks.csv --map u_roll=in_lat --map u_pitch=in_lon --output response.csv")]
pub(crate) struct SimulateArgs {
    /// Built-in vehicle or path of a vehicle file.
    pub vehicle: String,
    /// Record with the inputs: CSV (first column t in s, headers `name` or `name[unit]`), MCAP, PX4 ULog, ArduPilot
    /// DataFlash or Betaflight blackbox.
    #[arg(long, value_name = "FILE")]
    pub input: PathBuf,
    /// CSV to write: time, inputs and outputs, in SI units.
    #[arg(long, value_name = "FILE")]
    pub output: PathBuf,
    /// Take a signal from another column, for example u_roll=in_lat or roll=phi[deg]; may be repeated.
    #[arg(long = "map", value_name = "SIGNAL=NAME[UNIT]")]
    pub map: Vec<String>,
    /// Rate of the simulation, in Hz or with a unit [default: that of the record]
    #[arg(long, value_name = "FREQUENCY", value_parser = hertz)]
    pub rate: Option<f64>,
    /// Include random effects: sensor noise, quantization, dropouts, turbulence.
    #[arg(long)]
    pub noise: bool,
    /// Seed of the sensor noise.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
}

#[derive(Debug, Subcommand)]
pub(crate) enum LogCommand {
    /// Show what a log contains: signals, units, rates, length, and the files inside it.
    Info {
        /// MCAP, CSV, PX4 ULog, ArduPilot DataFlash or Betaflight blackbox.
        log: PathBuf,
        #[command(flatten)]
        json: JsonArg,
    },
    /// Export a log as CSV, with a unit in every column header.
    Export {
        /// MCAP, CSV, PX4 ULog, ArduPilot DataFlash or Betaflight blackbox.
        log: PathBuf,
        /// CSV to write; - for standard output.
        #[arg(long, short, value_name = "FILE", default_value = "-")]
        output: PathBuf,
        /// Take a signal from another column, for example roll=phi[deg]; may be repeated.
        #[arg(long = "map", value_name = "SIGNAL=NAME[UNIT]")]
        map: Vec<String>,
    },
    /// Find the first message and field that differ between two logs (ignoring Health and wall-clock times).
    Diff {
        /// First log.
        a: PathBuf,
        /// Second log.
        b: PathBuf,
        #[command(flatten)]
        json: JsonArg,
    },
}

/// Draft a vehicle file from a record: inputs and outputs by name and unit, structure by prediction of held-out data.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    whirlstand vehicle new flight.ulg --output mine.toml\n  \
    whirlstand vehicle new log.csv --input in_lat --measure 'roll_rate=wx[deg/s]'\n  \
    whirlstand vehicle new roll_1.csv roll_2.csv roll_3.csv --output mine.toml\n  \
    whirlstand identify flight.ulg --vehicle mine.toml\n\n\
    --output names the file; outputs of the vehicle are chosen with --measure. The file contains the log's signal \
    names, so no --map is needed.")]
pub(crate) struct VehicleNewArgs {
    /// MCAP, CSV, PX4 ULog, ArduPilot DataFlash or Betaflight blackbox; several flights of one vehicle count together.
    #[arg(required = true, value_name = "LOG")]
    pub logs: Vec<PathBuf>,
    /// Vehicle file to write; without it, the file is printed.
    #[arg(long, value_name = "V.toml")]
    pub output: Option<PathBuf>,
    /// An input of the vehicle, as SIGNAL[unit] or NAME=SIGNAL[unit]; may be repeated [default: those known by name]
    #[arg(long, value_name = "SIGNAL")]
    pub input: Vec<String>,
    /// An output of the vehicle, as SIGNAL[unit] or NAME=SIGNAL[unit]; may be repeated [default: those known by name,
    /// else rates by their unit]
    #[arg(long, value_name = "SIGNAL")]
    pub measure: Vec<String>,
    /// The time column of a CSV whose first column is not t, as COLUMN[unit].
    #[arg(long, value_name = "COLUMN")]
    pub time: Option<String>,
    /// Time between two rows of a CSV that counts them (t[samples], or --time '#[samples]' where it has no such column), in
    /// seconds or with a unit.
    #[arg(long, value_name = "TIME", value_parser = seconds)]
    pub period: Option<f64>,
    /// Start of the part to use, by the record's clock, in seconds or with a unit.
    #[arg(long, value_name = "TIME", value_parser = moment, allow_negative_numbers = true)]
    pub from: Option<f64>,
    /// End of the part to use, by the record's clock, in seconds or with a unit.
    #[arg(long, value_name = "TIME", value_parser = moment, allow_negative_numbers = true)]
    pub to: Option<f64>,
    #[command(flatten)]
    pub json: JsonArg,
}

#[derive(Debug, Subcommand)]
pub(crate) enum VehicleCommand {
    New(VehicleNewArgs),
    /// List the built-in vehicles.
    List {
        #[command(flatten)]
        json: JsonArg,
    },
    /// Print a vehicle file.
    Show {
        /// Built-in vehicle or path.
        vehicle: String,
    },
    /// Check a vehicle file and summarize it: states, inputs, outputs, effects, poles.
    Check {
        /// Built-in vehicle or path.
        vehicle: String,
        #[command(flatten)]
        json: JsonArg,
    },
    Fmu(VehicleFmuArgs),
}

/// Export a vehicle as an FMI 3.0 functional mock-up unit (FMU) for co-simulation in Simulink, Dymola, OpenModelica
/// or FMPy.
///
/// It simulates all effects and sensors, as the plant does. It contains the vehicle file and a library for this kind
/// of machine; using it requires neither Whirlstand nor a compiler.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  whirlstand vehicle fmu mine.toml --out mine.fmu")]
pub(crate) struct VehicleFmuArgs {
    /// Built-in vehicle or path of a vehicle file.
    pub vehicle: String,
    /// The FMU to write.
    #[arg(long, value_name = "FILE.fmu")]
    pub out: PathBuf,
    /// Rate at which sensors measure and inputs act, in Hz or with a unit.
    #[arg(long, value_name = "FREQUENCY", value_parser = hertz, default_value_t = 200.0)]
    pub rate: f64,
    /// Seed of the sensor noise, unless the tool sets another.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
}

#[derive(Debug, Subcommand)]
pub(crate) enum LaunchCommand {
    /// List the built-in launch files.
    List {
        #[command(flatten)]
        json: JsonArg,
    },
    /// Print a launch file.
    Show {
        /// Built-in launch file or path.
        launch: String,
    },
}
