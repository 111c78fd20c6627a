//! Options of the calls that compare records with a model: compare, diagnose, identify, and the test flight for them.

use std::path::PathBuf;

use clap::Args;

use super::JsonArg;
use super::quantity::{hertz, interval, moment, seconds};

/// Which part of a record is used, and how.
#[derive(Debug, Default, Args)]
pub(crate) struct RecordArgs {
    /// Take a signal from another column, for example roll=phi[deg]; may be repeated.
    #[arg(long = "map", value_name = "SIGNAL=NAME[UNIT]")]
    pub map: Vec<String>,
    /// Start of the part to use, by the record's clock, in seconds or with a unit.
    #[arg(long, value_name = "TIME", value_parser = moment, allow_negative_numbers = true)]
    pub from: Option<f64>,
    /// End of the part to use, by the record's clock, in seconds or with a unit.
    #[arg(
        long,
        visible_alias = "until",
        value_name = "TIME",
        value_parser = moment,
        allow_negative_numbers = true
    )]
    pub to: Option<f64>,
    /// Period of the simulation, in seconds or with a unit [default: that of the record]
    #[arg(long, value_name = "TIME", value_parser = seconds)]
    pub period: Option<f64>,
}

/// Where a result goes, beside the terminal.
#[derive(Debug, Args)]
pub(crate) struct ResultArgs {
    #[command(flatten)]
    pub json: JsonArg,
    /// Folder for report.html and all files without a path of their own.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// Compare a record with the simulation, or several runs with each other.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    whirlstand compare flight.csv --vehicle helicopter-hover --map roll=phi --map u_roll=in_lat --out out/compare\n  \
    whirlstand compare out/before out/after --out out/both")]
pub(crate) struct CompareArgs {
    /// With --vehicle, a record: MCAP, CSV, PX4 ULog, ArduPilot DataFlash or Betaflight blackbox. Without it, the
    /// logs of two or more bench runs, or their folders.
    #[arg(required = true, value_name = "LOG")]
    pub logs: Vec<PathBuf>,
    /// Built-in vehicle or path of a vehicle file.
    #[arg(long)]
    pub vehicle: Option<String>,
    #[command(flatten)]
    pub part: RecordArgs,
    /// How far the short predictions look ahead, in seconds or with a unit.
    #[arg(long, value_name = "TIME", value_parser = seconds, default_value_t = 2.0)]
    pub horizon: f64,
    #[command(flatten)]
    pub result: ResultArgs,
}

/// Find out what a simulation gets wrong and why: named causes, the extended vehicle file, and the gain.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    whirlstand diagnose out/flight --vehicle quadrotor --out out/diagnosis\n  \
    whirlstand diagnose flight.csv --vehicle mine.toml --map roll=phi[deg] --engine-on ground.csv --engine-off still.csv\n  \
    whirlstand diagnose a.csv b.csv --vehicle mine.toml --json -")]
pub(crate) struct DiagnoseArgs {
    /// MCAP, CSV, PX4 ULog, ArduPilot DataFlash or Betaflight blackbox; several are diagnosed together.
    #[arg(required = true, value_name = "LOG")]
    pub logs: Vec<PathBuf>,
    /// Built-in vehicle or path of a vehicle file.
    #[arg(long)]
    pub vehicle: String,
    #[command(flatten)]
    pub part: RecordArgs,
    /// Refit the vehicle's free parameters together with every cause; always done for a vehicle file that `identify`
    /// wrote.
    #[arg(long)]
    pub refit: bool,
    /// Prediction horizon, in seconds or with a unit [default: from the vehicle's time constants]
    #[arg(long, value_name = "TIME", value_parser = seconds)]
    pub horizon: Option<f64>,
    /// Stop the search after this time and report the results so far, in seconds or with a unit; exit code 3.
    #[arg(long, value_name = "TIME", value_parser = super::seconds)]
    pub budget: Option<f64>,
    /// Vehicle to consider for a change of flight mode, besides the built-in ones; may be repeated.
    #[arg(long, value_name = "VEHICLE")]
    pub mode: Vec<String>,
    /// Record on the ground with the engine on: distinguishes engine tones from airframe tones.
    #[arg(long, value_name = "LOG")]
    pub engine_on: Option<PathBuf>,
    /// Record with the engine off: identifies sensor tones.
    #[arg(long, value_name = "LOG")]
    pub engine_off: Option<PathBuf>,
    /// Extended vehicle file to write [default: vehicle.toml in the folder of --out]
    #[arg(long, value_name = "FILE")]
    pub output: Option<PathBuf>,
    #[command(flatten)]
    pub result: ResultArgs,
}

/// Fit the free parameters of a vehicle to records: identification as in the paper, and beyond it.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    whirlstand identify out/flight --vehicle quadrotor-structure --output mine.toml --out out/identify\n  \
    whirlstand identify flight.csv --vehicle mine.toml --map roll=phi[deg] --from 3 --hold-out 60:84 --offsets\n  \
    whirlstand identify a.csv b.csv --validation c.csv --vehicle mine.toml --method ga+pem --json -")]
pub(crate) struct IdentifyArgs {
    /// Logs to fit: MCAP, CSV, PX4 ULog, ArduPilot DataFlash or Betaflight blackbox.
    #[arg(required = true, value_name = "LOG")]
    pub logs: Vec<PathBuf>,
    /// Built-in vehicle, template (quadrotor-structure, helicopter-structure) or path of a vehicle file with `free`
    /// parameters.
    #[arg(long)]
    pub vehicle: String,
    /// ga: genetic algorithm on the mean square error; pem: output or prediction error; ga+pem: one after the other.
    #[arg(long, value_enum, default_value_t = IdentifyMethod::Pem)]
    pub method: IdentifyMethod,
    /// Model of the residuals [default: kalman for closed loops and models that are not stable, else white]
    #[arg(long, value_enum)]
    pub noise: Option<IdentifyNoise>,
    /// The records were taken with a controller in the loop (Whirlstand's own logs say so).
    #[arg(long)]
    pub closed_loop: bool,
    /// Validation data: further logs, which are not fitted; may be repeated.
    #[arg(long, alias = "control", value_name = "LOG")]
    pub validation: Vec<PathBuf>,
    /// Part of the logs that is not fitted but held out as validation data, for example 60:84; may be repeated.
    #[arg(long, value_name = "FROM:TO", value_parser = interval)]
    pub hold_out: Vec<(f64, f64)>,
    /// Estimate a constant offset of every output too: sensor bias, trim.
    #[arg(long)]
    pub offsets: bool,
    /// First subtract the mean over the fitted part from every input and output: the model describes deviations from
    /// it.
    #[arg(long, conflicts_with = "offsets")]
    pub detrend: bool,
    #[command(flatten)]
    pub part: RecordArgs,
    /// Remove the delay of a signal that was logged late, for example roll=0.06; may be repeated.
    #[arg(long, value_name = "SIGNAL=TIME", value_parser = delay)]
    pub delay: Vec<(String, f64)>,
    /// Estimate how far an output lags the output that is its derivative (an angle and its rate on different topics),
    /// and remove that delay.
    #[arg(long)]
    pub align: bool,
    /// Seed of the random numbers.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Maximum number of simulations of the genetic algorithm.
    #[arg(long, value_name = "N", default_value_t = 400_000)]
    pub evaluations: usize,
    /// Stop the search after this time and report the best result so far, in seconds or with a unit; exit code 3.
    #[arg(long, value_name = "TIME", value_parser = super::seconds)]
    pub budget: Option<f64>,
    /// Generations without progress after which the genetic algorithm stops.
    #[arg(long, value_name = "N", default_value_t = 100)]
    pub stagnation: usize,
    /// Fitted vehicle file to write.
    #[arg(long, value_name = "FILE")]
    pub output: Option<PathBuf>,
    #[command(flatten)]
    pub result: ResultArgs,
}

/// Design a test flight: inputs that distinguish parameters and effects within limits, and the accuracy to expect.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    whirlstand excite quadrotor --kind multisine --out out/excite\n  \
    whirlstand run out/excite/flight.toml --mode lockstep --out out/flight\n  \
    whirlstand identify out/flight --vehicle quadrotor-structure\n  \
    whirlstand excite quadrotor --controller lqr --out out/closed          # added to the command\n  \
    whirlstand excite quadrotor --controller lqr --setpoint roll --setpoint pitch --out out/closed")]
pub(crate) struct ExciteArgs {
    /// Built-in vehicle or path of a vehicle file.
    pub vehicle: String,
    /// Kind of input.
    #[arg(long, value_enum, default_value_t = ExciteKind::Multistep)]
    pub kind: ExciteKind,
    /// Length of the flight, in seconds or with a unit.
    #[arg(long, value_name = "TIME", value_parser = seconds, default_value_t = 60.0)]
    pub duration: f64,
    /// Rate of the loop, in Hz or with a unit.
    #[arg(long, value_name = "FREQUENCY", value_parser = hertz, default_value_t = 100.0)]
    pub rate: f64,
    /// Lowest frequency, in Hz or with a unit.
    #[arg(long, value_name = "FREQUENCY", value_parser = hertz, default_value_t = 0.1)]
    pub lowest: f64,
    /// Highest frequency, in Hz or with a unit.
    #[arg(long, value_name = "FREQUENCY", value_parser = hertz, default_value_t = 2.0)]
    pub highest: f64,
    /// Largest test signal: for an input, a share of its limit in the vehicle file, or a value in its unit without a
    /// limit; for a setpoint, a share of the limit of its output.
    #[arg(long, value_name = "SHARE", default_value_t = 0.5)]
    pub amplitude: f64,
    /// Controller that stays on: lqr, ppc or smc. The test input is added to its command. Without it, the flight is
    /// open loop.
    #[arg(long, value_name = "LAW")]
    pub controller: Option<String>,
    /// Move the setpoint of this state instead; may be repeated.
    #[arg(long = "setpoint", value_name = "STATE")]
    pub setpoint: Vec<String>,
    /// An option of the law, for example bandwidth=4; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Largest predicted value of an output, for example roll="10 deg"; may be repeated. Angles stay below 20 deg by
    /// default.
    #[arg(long = "limit", value_name = "OUTPUT=VALUE")]
    pub limit: Vec<String>,
    /// Seed of the random numbers.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Folder for inputs.csv and flight.toml.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    pub json: JsonArg,
}

/// Kinds of test input.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum ExciteKind {
    /// One step to each side, one input after the other.
    Doublets,
    /// Steps of 3, 2, 1 and 1 units to alternating sides.
    #[value(name = "3-2-1-1")]
    Steps3211,
    /// Steps of random length and size, as a pilot flies them.
    Multistep,
    /// Orthogonal sums of sines with flat peaks, all inputs at once.
    Multisine,
    /// Sines of rising frequency, one input after the other.
    Sweep,
}

/// How a cost is minimised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum IdentifyMethod {
    /// Genetic algorithm on the mean square error of the simulation, as in the paper.
    Ga,
    /// Gauss-Newton and Levenberg-Marquardt with analytic sensitivities.
    Pem,
    /// Genetic algorithm first, then pem from its result.
    #[value(name = "ga+pem")]
    GaPem,
}

/// How residuals are modelled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum IdentifyNoise {
    /// Output error: fits the open-loop simulation.
    White,
    /// Output error with autoregressive residuals.
    Coloured,
    /// Prediction error in Kalman's innovations form.
    Kalman,
}

/// Reads `SIGNAL=TIME`.
fn delay(text: &str) -> Result<(String, f64), String> {
    match text.split_once('=').map(|(name, time)| (name.trim(), time)) {
        Some((name, time)) if !name.is_empty() => Ok((name.into(), moment(time)?)),
        _ => Err(format!("'{text}' is not a delay: write SIGNAL=TIME, as in roll=0.06 or roll=\"60 ms\"")),
    }
}
