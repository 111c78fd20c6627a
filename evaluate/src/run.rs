//! A recorded run: its figures, and its lines thinned for plots.
//!
//! The log is read twice: first for the times of events, then for the figures and the lines. The memory of neither
//! pass grows with the length of the run.

use std::path::Path;

use whirlstand_logs::{BenchInfo, Hole, Log, ReadError};
use whirlstand_vehicle::{Vehicle, VehicleError};

use crate::health::NodeHealth;
use crate::layout::{Layout, NS};
use crate::lines::Lines;
use crate::measures::Measures;
use crate::merge::{Merge, place};
use crate::summary::RunSummary;
use crate::survey::Survey;

/// The reason why a run cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The log cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The log is of another program.
    #[error("{path} is not a bench log: it has no metadata named whirlstand; use compare for foreign logs")]
    NotABench {
        /// The log.
        path: String,
    },
    /// The vehicle file in the log is missing or cannot be used.
    #[error("{path} contains no vehicle file, so its signals have no names")]
    NoVehicle {
        /// The log.
        path: String,
    },
    /// The vehicle file in the log cannot be used.
    #[error("the vehicle file in {path} cannot be used: {source}")]
    Vehicle {
        /// The log.
        path: String,
        /// Why.
        source: Box<VehicleError>,
    },
}

/// A recorded run.
#[derive(Debug, Clone)]
pub struct Run {
    /// Name of the variant.
    pub name: String,
    /// Description of the bench from the log.
    pub info: BenchInfo,
    /// The vehicle.
    pub vehicle: Vehicle,
    /// Launch file, vehicle file and what else is inside the log: name and text.
    pub attachments: Vec<(String, String)>,
    /// The figures.
    pub figures: RunSummary,
    /// Lines for the plots.
    pub lines: Lines,
    /// Health of the nodes.
    pub health: Vec<NodeHealth>,
    /// Parts that could not be written into the log.
    pub holes: Vec<Hole>,
    /// Topics of the loop with the time of their last message, s.
    pub ends: Vec<(&'static str, f64)>,
}

impl Run {
    /// Reads the log of a run (file or folder) as variant `name`. Without `vehicle`, the vehicle file inside the
    /// log is used.
    ///
    /// # Errors
    /// [`RunError`].
    pub fn open(path: impl AsRef<Path>, name: &str, vehicle: Option<&Vehicle>) -> Result<Self, RunError> {
        let log = Log::open(path)?;
        let path = log.path().display().to_string();
        let info = log.info().ok_or_else(|| RunError::NotABench { path: path.clone() })?.clone();
        let vehicle = match (vehicle, log.vehicle_text()) {
            (Some(vehicle), _) => vehicle.clone(),
            (None, None) => return Err(RunError::NoVehicle { path }),
            (None, Some(text)) => Vehicle::parse(text, &info.vehicle).map_err(|source| {
                RunError::Vehicle { path: path.clone(), source: Box::new(source.into()) }
            })?,
        };
        let attachments = log
            .attached()
            .iter()
            .filter_map(|a| Some((a.name.clone(), String::from_utf8(a.data.clone()).ok()?)))
            .collect();
        let period_s = info.period_ns as f64 * NS;
        let layout = Layout::new(&vehicle);
        let survey = Survey::of(&log, &vehicle, &layout, period_s)?;
        let measures = measure(&log, Measures::new(&vehicle, &layout, &survey, period_s), &survey)?;
        let mut measured = measures.finish(&vehicle, &survey.health);
        measured.timing.witness_charge(&survey.charge);
        let ends = survey.ends();
        let mut disturbances = survey.onsets;
        disturbances.truncate(crate::summary::MOST_LISTED);
        let figures = RunSummary {
            name: name.into(),
            vehicle: vehicle.name.clone(),
            mode: info.mode.clone(),
            transport: info.transport.clone(),
            seed: info.seed,
            period_s,
            duration_s: survey.end_s,
            log: path,
            disturbances,
            findings: survey.findings,
            outputs: measured.outputs,
            inputs: measured.inputs,
            estimator: measured.estimator,
            timing: measured.timing,
        };
        let (lines, health, holes) = (measured.lines, survey.health, survey.holes);
        Ok(Self { name: name.into(), info, vehicle, attachments, figures, lines, health, holes, ends })
    }
}

/// Passes the valid messages to `measures`, in the order of their time.
fn measure<'a>(log: &Log, mut measures: Measures<'a>, survey: &Survey) -> Result<Measures<'a>, ReadError> {
    let mut again = survey.again();
    let mut merge = Merge::new(survey.kept.each_ref().map(|kept| kept.messages()));
    for message in log.bench_messages()? {
        let message = message?;
        let Some((topic, ns)) = place(&message) else { continue };
        merge.push(topic, ns, again[topic].counts(ns).then_some(message));
        while let Some(message) = merge.pop() {
            measures.take(&message, &merge);
        }
    }
    Ok(measures)
}
