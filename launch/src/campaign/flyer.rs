//! One flight of a campaign: its launch file with what it draws, in lockstep, in this thread.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};
use tempfile::TempDir;
use whirlstand_campaign::{Campaign, Columns, Ended, Flight};
use whirlstand_evaluate::expectation::{check, signal_figures};
use whirlstand_evaluate::summary::{INPUT_KEYS, OUTPUT_KEYS};
use whirlstand_evaluate::{Expectation, Figure, Run, RunSummary};
use whirlstand_nodes::inproc::run_inproc;
use whirlstand_nodes::os::StopFlag;

use crate::cli::{ModeArg, OverrideArgs, TransportArg};
use crate::error::Failure;
use crate::file::{Document, FoundFile, Jobs, LaunchFile, Plan, find, jobs_of};

/// Limits that depend on the wall clock, of which a flight in one thread knows nothing.
const OF_THE_CLOCK: [&str; 3] = ["max_deadline_misses", "max_latency_p99_s", "max_latency_s"];

/// Keys that cannot vary, because the columns of the table depend on them.
const FIXED: [&str; 2] = ["vehicle", "expect"];

/// Flies the flights of a campaign.
pub(super) struct Flyer {
    campaign: Campaign,
    launch: FoundFile,
    own_effects: usize,
    columns: Columns,
    digest: String,
    name: String,
    /// Where logs lie until they have been looked at.
    scratch: TempDir,
}

impl Flyer {
    /// Reads a campaign file and its launch file, and plans the first flight.
    ///
    /// # Errors
    /// For everything that is wrong in either, with its place.
    pub fn new(path: &Path) -> Result<Self, Failure> {
        let shown = path.display().to_string();
        let text =
            std::fs::read_to_string(path).map_err(|e| Failure::file("read the campaign file", path, &e))?;
        let campaign = Campaign::parse(&shown, &text).map_err(Failure::mend)?;
        let launch = launch_file(&campaign, path)?;
        let file: LaunchFile = launch.document.read().map_err(Failure::mend)?;
        check_alone(&file, &campaign.launch)?;
        let own_effects = file.effects.len();
        let refused =
            |key: &str| FIXED.iter().any(|fixed| key == *fixed || key.starts_with(&format!("{fixed}.")));
        if let Some((key, _)) = campaign.keys().into_iter().find(|(key, _)| refused(key)) {
            return Err(Failure::Mend(format!(
                "{shown}: {key} cannot vary: all flights share one table of figures"
            )));
        }
        let with_effects =
            Document::parse(&shown, &format!("{}{}", launch.document.text(), campaign.effects)).map_err(
                |e| {
                    Failure::Mend(format!("{shown}: its effects cannot follow those of the launch file: {e}"))
                },
            )?;
        let launch = FoundFile { document: with_effects, ..launch };
        let scratch = tempfile::Builder::new()
            .prefix("whirlstand-campaign-")
            .tempdir()
            .map_err(|e| Failure::Run(format!("no folder can be made for the logs of the flights: {e}")))?;
        let name =
            path.file_stem().map_or_else(|| "campaign".into(), |stem| stem.to_string_lossy().into_owned());
        let mut flyer = Self {
            campaign,
            launch,
            own_effects,
            columns: Columns::default(),
            digest: String::new(),
            name,
            scratch,
        };
        let first = flyer.plan(0)?;
        flyer.columns = columns(&flyer.campaign, &first);
        flyer.digest = flyer.digest_of(&first);
        Ok(flyer)
    }

    pub fn campaign(&self) -> &Campaign {
        &self.campaign
    }

    /// Name of the campaign: its file's.
    pub fn name(&self) -> &str {
        &self.name
    }

    pub fn columns(&self) -> &Columns {
        &self.columns
    }

    /// Digest of all that decides what the flights are.
    pub fn digest(&self) -> &str {
        &self.digest
    }

    fn digest_of(&self, first: &Plan) -> String {
        let mut digest = Sha256::new();
        for text in [&self.campaign.text, self.launch.document.text(), &first.config.vehicle.text] {
            digest.update((text.len() as u64).to_le_bytes());
            digest.update(text);
        }
        digest.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// The launch file as flight `number` flies it.
    ///
    /// # Errors
    /// For a drawn value that the launch file does not take, with its key.
    pub fn jobs(&self, number: u64, transport: Option<TransportArg>) -> Result<Jobs, Failure> {
        let set = self.campaign.assignments(number, self.own_effects);
        let overrides =
            OverrideArgs { mode: Some(ModeArg::Lockstep), transport, set, ..OverrideArgs::default() };
        jobs_of(&self.launch, &overrides, false)
            .map_err(|e| Failure::Mend(format!("flight {number} of the campaign cannot be flown: {e}")))
    }

    /// The same, for one thread.
    fn plan(&self, number: u64) -> Result<Plan, Failure> {
        let mut jobs = self.jobs(number, Some(TransportArg::Inproc))?;
        // Variants were refused.
        let job = jobs.runs.pop();
        job.map(|job| job.plan).ok_or_else(|| Failure::Mend(format!("{} has no run", self.campaign.launch)))
    }

    /// Flies one flight; whatever goes wrong is how it ended.
    pub fn fly(&self, number: u64) -> Flight {
        let figures = vec![None; self.columns.figures.len()];
        let failed = |why: String| Flight {
            number,
            values: self.campaign.values(number),
            ended: Ended::Failed(why),
            holds: Vec::new(),
            figures,
        };
        // A fault of one flight must not cost the others.
        match catch_unwind(AssertUnwindSafe(|| self.flown(number))) {
            Ok(Ok(flight)) => flight,
            Ok(Err(why)) => failed(why),
            Err(_) => failed("the program failed in this flight, which is a bug".into()),
        }
    }

    fn flown(&self, number: u64) -> Result<Flight, String> {
        let mut plan = self.plan(number).map_err(|e| e.to_string())?;
        let folder = self.scratch.path().join(number.to_string());
        std::fs::create_dir(&folder).map_err(|e| format!("no folder for its log: {e}"))?;
        let _removed = Folder(&folder);
        let log = folder.join("log.mcap");
        plan.config.bench = format!("campaign-{}-{number}", std::process::id());
        let Some(recorder) = &mut plan.config.recorder else {
            return Err("without a log there are no figures: recorder.enabled must be true".into());
        };
        recorder.path = log.to_string_lossy().into_owned();
        run_inproc(&plan.config, &StopFlag::default()).map_err(|e| e.to_string())?;
        let run = Run::open(&log, &plan.name, None).map_err(|e| e.to_string())?;
        let limits = limits(&plan);
        let checked = check(&limits, &run.figures.timing, Some(&run.figures));
        Ok(Flight {
            number,
            values: self.campaign.values(number),
            ended: Ended::Complete,
            holds: checked.iter().map(|c| c.holds).collect(),
            figures: self.columns.figures.iter().map(|(key, _)| value(&run.figures, key)).collect(),
        })
    }
}

/// A folder that goes with the flight, however that ends.
struct Folder<'a>(&'a PathBuf);

impl Drop for Folder<'_> {
    fn drop(&mut self) {
        // What stays goes with the scratch folder.
        let _ = std::fs::remove_dir_all(self.0);
    }
}

/// The launch file: beside the campaign file, or a built-in one.
fn launch_file(campaign: &Campaign, path: &Path) -> Result<FoundFile, Failure> {
    let beside = path.parent().unwrap_or(Path::new("")).join(&campaign.launch);
    if beside.is_file() { find(&beside.to_string_lossy()) } else { find(&campaign.launch) }
}

/// A flight in one thread is one bench, of nodes that are part of this program.
fn check_alone(file: &LaunchFile, launch: &str) -> Result<(), Failure> {
    if !file.variants.is_empty() {
        return Err(Failure::Mend(format!(
            "{launch} has variants; a campaign flies one bench, and lets for example controller.law vary"
        )));
    }
    let not_ours =
        file.nodes.iter().find(|(_, node)| node.exec.is_some() || node.external || node.bridge.is_some());
    match not_ours {
        Some((name, _)) => Err(Failure::Mend(format!(
            "node {name} of {launch} is a program or hardware of its own; a campaign flies in one thread, without it"
        ))),
        None => Ok(()),
    }
}

/// The limits that a flight in one thread can meet or miss.
fn limits(plan: &Plan) -> Vec<Expectation> {
    plan.expect.iter().filter(|e| !OF_THE_CLOCK.contains(&e.key.as_str())).cloned().collect()
}

fn columns(campaign: &Campaign, plan: &Plan) -> Columns {
    let vehicle = &plan.vehicle;
    let of = |name: &str, keys: &[&str]| -> Vec<(String, String)> {
        let all = signal_figures(vehicle, name).unwrap_or_default();
        let of_kind = all.into_iter().filter(|(key, _)| keys.contains(key));
        of_kind.map(|(key, unit)| (format!("{name}.{key}"), unit.unit.si_symbol())).collect()
    };
    let outputs = vehicle.outputs.iter().flat_map(|output| of(&output.name, &OUTPUT_KEYS));
    let inputs = vehicle.inputs.iter().flat_map(|input| of(&input.name, &INPUT_KEYS));
    Columns {
        keys: campaign.keys(),
        limits: limits(plan).into_iter().map(|e| (e.key, e.limit)).collect(),
        figures: outputs.chain(inputs).chain([("nis_ratio".into(), String::new())]).collect(),
    }
}

fn value(figures: &RunSummary, key: &str) -> Option<f64> {
    match figures.figure(key)? {
        Figure::Value(value) if value.is_finite() => Some(value),
        _ => None,
    }
}
