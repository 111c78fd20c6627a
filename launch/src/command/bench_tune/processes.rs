//! The flights of a cell in separate processes: plant, filter, law and recorder are separate nodes on the
//! bus.
//!
//! Costs are computed from the logs, in lockstep and in real time alike.

use std::path::{Path, PathBuf};

use whirlstand_evaluate::Flight;
use whirlstand_logs::{BenchMessage, Log, stats};
use whirlstand_msgs::{Setpoint, Truth};
use whirlstand_nodes::setup::Setup;
use whirlstand_vehicle::Vehicle;

use super::answer::{Answer, OnTruth, Outcome};
use crate::cli::ModeArg;
use crate::command::vehicles;
use crate::error::Failure;
use crate::exclusive::{Claim, OutFolder};
use crate::file::{Document, Plan, find, plan};
use crate::run::{Progress, fly, unique_bench};
use crate::supervisor::Ending;
use crate::tune::{Tuning, compare_costs, cost};

/// First seed of the flights on the true vehicle; none of them is the seed of the record.
const FRESH: u64 = 1 << 16;

/// Mode of the clock, and number of flights of each law on the true vehicle.
#[derive(Debug, Clone, Copy)]
pub(super) struct Processes {
    pub mode: ModeArg,
    pub seeds: u64,
}

/// How a flight ended: with its log, by a signal, or by the failure of a node.
enum Flown {
    Log(PathBuf),
    Interrupted,
    Failed(String),
}

impl Processes {
    /// Lines of the launch file that set the mode of these flights.
    pub fn words(self) -> String {
        format!("mode = '{}'", self.mode.word())
    }

    /// Flies the record and writes its log into `folder`. `Ok(None)` when a signal ended it.
    pub fn record(self, launch: &str, folder: &Path) -> Result<Option<PathBuf>, Failure> {
        let found = find(launch)?;
        let planned = plan(&found.document, &found.name, &found.folder).map_err(Failure::mend)?;
        match flown(&planned, folder)? {
            Flown::Log(log) => Ok(Some(log)),
            Flown::Interrupted => Ok(None),
            Flown::Failed(why) => Err(Failure::Run(format!("the flight of the record failed: {why}"))),
        }
    }

    /// Flies three laws on the true vehicle: the old one, that of `tuned.toml` and the one designed on
    /// `truth.toml`. Files and logs are written into `folder`.
    pub fn outcome(
        self,
        tuning: &Tuning,
        named: Vec<String>,
        folder: &Path,
    ) -> Result<Option<Answer>, Failure> {
        let path = |name: &str| folder.join(name);
        let (before, designed) = (path("launch.toml"), path("designed.toml"));
        let truth = vehicles::find(&path("truth.toml").display().to_string())?;
        let kept = tuning.gain.certain;
        let mut costs: [Vec<f64>; 3] = Default::default();
        let laws = [Some(&*before), kept.then(|| Path::new(&tuning.tuned)), Some(&*designed)];
        for seed in FRESH..FRESH + self.seeds {
            for (law, costs) in laws.iter().zip(&mut costs) {
                let Some(launch) = law else { continue };
                let planned = with_seed(launch, seed)?;
                let log = match flown(&planned, &folder.join("flight"))? {
                    Flown::Log(log) => log,
                    Flown::Interrupted => return Ok(None),
                    Flown::Failed(why) => return Ok(Some(Answer::Failed(why))),
                };
                let plant =
                    Setup::plant_of(&truth, Setup::period_s(&planned.config)).map_err(Failure::mend)?;
                costs.push(cost(&motion(&log, &truth)?, &plant));
            }
        }
        if !kept {
            costs[1] = costs[0].clone();
        }
        let law = |costs: &[f64]| OnTruth { cost: Some(stats::median(costs)), lost: 0.0 };
        let [before, after, designed] = costs.each_ref().map(|c| stats::median(c));
        let share = (before - after) / (before - designed);
        Ok(Some(Answer::Flown(Box::new(Outcome {
            named,
            kept,
            before: law(&costs[0]),
            after: law(&costs[1]),
            new: law(&costs[1]),
            designed: law(&costs[2]),
            share: share.is_finite().then_some(share),
            after_over_before_low: compare_costs(&costs[0], &costs[1]).cost_ratio_low,
            designed_over_before_high: compare_costs(&costs[0], &costs[2]).cost_ratio_high,
        }))))
    }
}

/// The plan of a launch file with another seed.
fn with_seed(launch: &Path, seed: u64) -> Result<Plan, Failure> {
    let found = find(&launch.display().to_string())?;
    let text = format!("seed = {seed}\n{}", found.document.text());
    let document = Document::parse(&found.name, &text).map_err(Failure::mend)?;
    plan(&document, &found.name, &found.folder).map_err(Failure::mend)
}

/// Flies a launch file and writes its log into `folder`.
fn flown(planned: &Plan, folder: &Path) -> Result<Flown, Failure> {
    let claim = Claim::take(&unique_bench("bench-tune"))?;
    let out = OutFolder::given(folder)?;
    let mut progress = Progress::new(&planned.config, false);
    let finished = fly(planned, &out, &claim, &mut progress);
    progress.finish();
    let finished = finished?;
    Ok(match (finished.outcome.ending, finished.log) {
        (Ending::Complete, Some(log)) => Flown::Log(log),
        (Ending::Complete, None) => Flown::Failed("the flight has no log".into()),
        (Ending::Interrupted(_), _) => Flown::Interrupted,
        (Ending::Failed(node), _) => {
            Flown::Failed(format!("{} {}: {}", node.node, node.how, node.last_lines.join(" ")))
        }
    })
}

/// The motion recorded in a log.
fn motion(log: &Path, vehicle: &Vehicle) -> Result<Flight, Failure> {
    let (mut truths, mut setpoints): (Vec<Truth>, Vec<Setpoint>) = Default::default();
    let messages = Log::open(log).and_then(|log| log.bench_messages()).map_err(Failure::run)?;
    for message in messages {
        match message.map_err(Failure::run)? {
            BenchMessage::Truth(m) => truths.push(m),
            BenchMessage::Setpoint(m) => setpoints.push(m),
            _ => {}
        }
    }
    setpoints.sort_by_key(|m| m.head.stamp_ns);
    let mut flight = Flight::default();
    for m in &truths {
        let later = setpoints.partition_point(|s| s.head.stamp_ns <= m.head.stamp_ns);
        // Until the first setpoint arrives, the first one is used.
        let Some(setpoint) = setpoints.get(later.saturating_sub(1)) else { continue };
        flight.take(&m.x[..vehicle.states.len()], &m.u[..vehicle.inputs.len()], setpoint);
    }
    Ok(flight)
}
