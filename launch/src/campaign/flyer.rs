//! One flight of a campaign: the launch file with the drawn values, flown in lockstep in this thread.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use sha2::{Digest, Sha256};
use tempfile::TempDir;
use whirlstand_campaign::{Campaign, Columns, Ended, FigureColumn, Flight, WEIGHT};
use whirlstand_evaluate::expectation::{check, signal_figures};
use whirlstand_evaluate::summary::{INPUT_KEYS, OUTPUT_KEYS};
use whirlstand_evaluate::{Expectation, Figure, Run, RunSummary};
use whirlstand_msgs::units::ShownUnit;
use whirlstand_nodes::flight::LANES;

use super::in_thread::InThread;
use super::pilots::Pilots;
use super::redrawn::Redrawn;
use super::without_log::{together_without_log, without_log};
use crate::cli::{ModeArg, OverrideArgs, TransportArg};
use crate::error::Failure;
use crate::file::{Document, FoundFile, Jobs, LaunchFile, Plan, find, jobs_of};

/// Limits on wall-clock timing. A flight in one thread has no wall-clock timing, so they do not apply to it.
const OF_THE_CLOCK: [&str; 3] = ["max_deadline_misses", "max_latency_p99_s", "max_latency_s"];

/// Most steps of a flight that is held in memory while it is flown. A step takes a few hundred bytes.
const MOST_HELD: u64 = 1 << 18;

/// Least number of flights that are flown side by side; fewer are flown one by one.
const FEWEST_TOGETHER: usize = 4;

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
    /// Makes the plan of most flights from the plan of the first one.
    redrawn: Option<Redrawn>,
    pilots: Pilots,
    /// Folder in which the logs of long flights are kept until they have been evaluated.
    scratch: TempDir,
}

impl Flyer {
    /// Reads a campaign file and its launch file, and plans the first flight.
    ///
    /// # Errors
    /// For everything that is wrong in either file, with its place.
    pub fn new(path: &Path) -> Result<Self, Failure> {
        let shown = path.display().to_string();
        let campaign = Campaign::open(path).map_err(Failure::mend)?;
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
            .map_err(|e| Failure::Run(format!("cannot create a folder for the logs of the flights: {e}")))?;
        let name =
            path.file_stem().map_or_else(|| "campaign".into(), |stem| stem.to_string_lossy().into_owned());
        let mut flyer = Self {
            campaign,
            launch,
            own_effects,
            columns: Columns::default(),
            digest: String::new(),
            name,
            redrawn: None,
            pilots: Pilots::default(),
            scratch,
        };
        let first = flyer.read(0)?;
        let (campaign, own_effects) = (&flyer.campaign, flyer.own_effects);
        let redrawn = Redrawn::new(&flyer.launch.document, &first, campaign, own_effects);
        // A difference that `Redrawn` leaves out would show in one of these flights.
        let same = |redrawn: &Redrawn| {
            [0, 1, campaign.flights() - 1].into_iter().filter(|n| *n < campaign.flights()).all(|n| {
                redrawn
                    .plan(&campaign.drawn(n, own_effects))
                    .is_none_or(|plan| flyer.read(n).is_ok_and(|read| Redrawn::flies_as(&plan, &read)))
            })
        };
        flyer.redrawn = redrawn.filter(same);
        flyer.columns = columns(&flyer.campaign, &first);
        flyer.digest = flyer.digest_of(&first);
        Ok(flyer)
    }

    pub fn campaign(&self) -> &Campaign {
        &self.campaign
    }

    /// Name of the campaign, which is the name of its file.
    pub fn name(&self) -> &str {
        &self.name
    }

    pub fn columns(&self) -> &Columns {
        &self.columns
    }

    /// Digest of everything that determines the flights.
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

    /// The plan of flight `number` for one thread. It is made from the plan of the first flight where every drawn
    /// value is a number that can be replaced there.
    fn plan(&self, number: u64) -> Result<Plan, Failure> {
        let redrawn = self.redrawn.as_ref();
        let plan = redrawn.and_then(|r| r.plan(&self.campaign.drawn(number, self.own_effects)));
        plan.map_or_else(|| self.read(number), Ok)
    }

    /// The plan of flight `number` for one thread, read from the launch file.
    fn read(&self, number: u64) -> Result<Plan, Failure> {
        let mut jobs = self.jobs(number, Some(TransportArg::Inproc))?;
        // Variants were refused.
        let job = jobs.runs.pop();
        job.map(|job| job.plan).ok_or_else(|| Failure::Mend(format!("{} has no run", self.campaign.launch)))
    }

    /// Flies some flights, side by side where one law and one filter serve all of them. A failure of a flight is
    /// its result.
    pub fn fly_some(&self, numbers: &[u64]) -> Vec<Flight> {
        // A failure here occurs again in the flight that it belongs to.
        let planned = |n: &u64| catch_unwind(AssertUnwindSafe(|| self.plan(*n).ok())).ok().flatten();
        let plans: Vec<Option<Plan>> = numbers.iter().map(planned).collect();
        let together = catch_unwind(AssertUnwindSafe(|| self.together(&plans))).ok().flatten();
        let mut figures = together.into_iter().flatten();
        let flights = numbers.iter().zip(plans);
        flights.map(|(number, plan)| self.fly(*number, plan, figures.next().flatten())).collect()
    }

    /// The figures of flights that are flown side by side; `None` for a flight that has to be flown alone.
    fn together(&self, plans: &[Option<Plan>]) -> Option<[Option<RunSummary>; LANES]> {
        let plans = plans.iter().map(Option::as_ref).collect::<Option<Vec<_>>>()?;
        let can = |plan: &&Plan| plan.config.recorder.is_some() && plan.config.steps <= MOST_HELD;
        if !(FEWEST_TOGETHER..=LANES).contains(&plans.len()) || !plans.iter().all(can) {
            return None;
        }
        let pilot = self.pilots.of(&plans[0].config).ok()?;
        // Where there are fewer, the last one is flown several times.
        let bench = |lane: usize| plans[lane.min(plans.len() - 1)];
        let benches = std::array::from_fn(|lane| (&bench(lane).config, bench(lane).name.as_str()));
        Some(together_without_log(benches, &pilot))
    }

    /// Flies one flight, unless `figures` already holds its result.
    fn fly(&self, number: u64, plan: Option<Plan>, figures: Option<RunSummary>) -> Flight {
        let weights = self.columns.figures.iter();
        let weights = weights.map(|figure| self.weight(&figure.key, number)).collect();
        let failed = |why: String| Flight {
            number,
            values: self.campaign.values(number),
            ended: Ended::Failed(why),
            holds: Vec::new(),
            figures: weights,
        };
        // A fault of one flight must not cost the others.
        match catch_unwind(AssertUnwindSafe(|| self.flown(number, plan, figures))) {
            Ok(Ok(flight)) => flight,
            Ok(Err(why)) => failed(why),
            Err(_) => failed("the program failed in this flight; this is a bug".into()),
        }
    }

    fn flown(&self, number: u64, plan: Option<Plan>, figures: Option<RunSummary>) -> Result<Flight, String> {
        let plan = plan.map_or_else(|| self.plan(number), Ok).map_err(|e| e.to_string())?;
        if plan.config.recorder.is_none() {
            return Err("without a log there are no figures: recorder.enabled must be true".into());
        }
        let figures = match figures {
            Some(figures) => figures,
            None if plan.config.steps > MOST_HELD => self.recorded(number, &plan)?,
            None => self.direct(&plan)?,
        };
        let checked = check(&limits(&plan), &figures.timing, Some(&figures));
        Ok(Flight {
            number,
            values: self.campaign.values(number),
            ended: Ended::Complete,
            holds: checked.iter().map(|c| c.holds).collect(),
            figures: self
                .columns
                .figures
                .iter()
                .map(|figure| self.weight(&figure.key, number).or_else(|| value(&figures, &figure.key)))
                .collect(),
        })
    }

    /// The value under `key` that does not depend on the outcome of the flight: its weight.
    fn weight(&self, key: &str, number: u64) -> Option<f64> {
        if key == WEIGHT { self.campaign.weight(number) } else { None }
    }

    /// The figures of a flight without bus and log.
    fn direct(&self, plan: &Plan) -> Result<RunSummary, String> {
        let pilot = self.pilots.of(&plan.config).map_err(|e| e.to_string())?;
        without_log(&plan.config, &pilot, &plan.name, |_| {}).map_err(|e| e.to_string())
    }

    /// The figures of a flight that is too long to be held in memory: from a log that is deleted afterwards.
    fn recorded(&self, number: u64, plan: &Plan) -> Result<RunSummary, String> {
        let flight =
            InThread::new(self.scratch.path(), number).map_err(|e| format!("no folder for its log: {e}"))?;
        let bench = format!("campaign-{}-{number}", std::process::id());
        flight.fly(plan.config.clone(), bench).map_err(|e| e.to_string())?;
        Ok(Run::open(flight.log(), &plan.name, None).map_err(|e| e.to_string())?.figures)
    }
}

/// The launch file: beside the campaign file, or a built-in one.
fn launch_file(campaign: &Campaign, path: &Path) -> Result<FoundFile, Failure> {
    let beside = path.parent().unwrap_or(Path::new("")).join(&campaign.launch);
    if beside.is_file() { find(&beside.to_string_lossy()) } else { find(&campaign.launch) }
}

/// Refuses a launch file that is not one bench made only of nodes of this program: a flight in one thread can
/// be nothing else.
fn check_alone(file: &LaunchFile, launch: &str) -> Result<(), Failure> {
    if !file.variants.is_empty() {
        return Err(Failure::Mend(format!(
            "{launch} has variants, but a campaign flies one bench: vary controller.law or another key instead"
        )));
    }
    let not_ours =
        file.nodes.iter().find(|(_, node)| node.exec.is_some() || node.external || node.bridge.is_some());
    match not_ours {
        Some((name, _)) => Err(Failure::Mend(format!(
            "node {name} of {launch} is an external program or hardware, which a campaign cannot fly: it flies in \
             one thread"
        ))),
        None => Ok(()),
    }
}

/// The limits that a flight in one thread can meet or miss.
pub(crate) fn limits(plan: &Plan) -> Vec<Expectation> {
    plan.expect.iter().filter(|e| !OF_THE_CLOCK.contains(&e.key.as_str())).cloned().collect()
}

fn columns(campaign: &Campaign, plan: &Plan) -> Columns {
    let vehicle = &plan.vehicle;
    let of = |name: &str, keys: &[&str]| -> Vec<FigureColumn> {
        let all = signal_figures(vehicle, name).unwrap_or_default();
        let of_kind = all.into_iter().filter(|(key, _)| keys.contains(key));
        of_kind.map(|(key, unit)| column(format!("{name}.{key}"), &unit.shown())).collect()
    };
    let outputs = vehicle.outputs.iter().flat_map(|output| of(&output.name, &OUTPUT_KEYS));
    let inputs = vehicle.inputs.iter().flat_map(|input| of(&input.name, &INPUT_KEYS));
    let pure = |key: &str| column(key.into(), &ShownUnit::default());
    let weight = campaign.weight(0).map(|_| pure(WEIGHT));
    Columns {
        keys: campaign.keys(),
        limits: limits(plan).into_iter().map(|e| (e.key, e.limit)).collect(),
        figures: outputs.chain(inputs).chain([pure("nis_ratio")]).chain(weight).collect(),
    }
}

fn column(key: String, unit: &ShownUnit) -> FigureColumn {
    FigureColumn { key, unit: unit.si_symbol().into(), shown: unit.symbol().into() }
}

fn value(figures: &RunSummary, key: &str) -> Option<f64> {
    match figures.figure(key)? {
        Figure::Value(value) if value.is_finite() => Some(value),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The part of a flight's figures that is compared.
    fn bits(
        flyer: &Flyer,
        figures: &Result<RunSummary, String>,
    ) -> Result<Vec<(String, Option<u64>)>, String> {
        let figures = figures.as_ref().map_err(Clone::clone)?;
        let of = |key: &str| (key.to_string(), value(figures, key).map(f64::to_bits));
        let counts = ["held_steps", "failsafe_steps", "deadline_misses", "lost", "restarts"];
        Ok(flyer.columns.figures.iter().map(|figure| figure.key.as_str()).chain(counts).map(of).collect())
    }

    /// Flies the campaign's flights without a log and with one, both read from the launch file.
    fn same(campaign: &str) -> Vec<Result<RunSummary, String>> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("c.toml");
        std::fs::write(&path, campaign).unwrap();
        let flyer = Flyer::new(&path).unwrap();
        let fly = |number| {
            let (plan, read) = (flyer.plan(number).unwrap(), flyer.read(number).unwrap());
            assert!(Redrawn::flies_as(&plan, &read), "flight {number} of {campaign}");
            let (direct, recorded) = (flyer.direct(&plan), flyer.recorded(number, &read));
            let [a, b] = [&direct, &recorded].map(|figures| bits(&flyer, figures));
            assert_eq!(a, b, "flight {number} of {campaign}");
            if let (Ok(direct), Ok(recorded)) = (&direct, &recorded) {
                let limits = limits(&plan);
                let holds = |figures: &RunSummary| check(&limits, &figures.timing, Some(figures));
                assert_eq!(holds(direct), holds(recorded), "flight {number} of {campaign}");
                assert_eq!(direct.disturbances, recorded.disturbances);
            }
            direct
        };
        let flights: Vec<_> = (0..flyer.campaign.flights()).map(fly).collect();
        // The same flights side by side, with as many copies as that takes.
        let plans: Vec<_> = (0..FEWEST_TOGETHER as u64)
            .map(|copy| flyer.plan(copy % flyer.campaign.flights()).ok())
            .collect();
        let together = flyer.together(&plans).unwrap_or_default();
        for (figures, alone) in together.iter().zip(flights.iter().cycle()).take(plans.len()) {
            if let Some(figures) = figures {
                assert_eq!(bits(&flyer, &Ok(figures.clone())), bits(&flyer, alone), "{campaign}");
            }
        }
        flights
    }

    #[test]
    fn a_flight_without_a_log_has_the_figures_of_its_log_to_the_last_bit() {
        for law in ["smc", "lqr", "ppc", "manual"] {
            same(&format!(
                "launch = \"quadrotor\"\nflights = 3\nset = [\"duration_s=9\", \"controller.law={law}\"]\n\
                 [[effects]]\neffect = \"input_delay\"\nwhere = \"u_roll\"\ndelay_s = 0.012\n\
                 [[effects]]\neffect = \"dropouts\"\nwhere = \"pitch\"\nfraction = 0.05\n\
                 [[effects]]\neffect = \"turbulence\"\nwhere = \"roll_rate\"\nstd = \"20 deg/s^2\"\nbandwidth_hz = 2.0\n\
                 [[vary]]\nkey = \"effects.0.magnitude\"\nuniform = [\"100 deg/s^2\", \"300 deg/s^2\"]\n\
                 [[vary]]\nkey = \"plant.initial.roll\"\nuniform = [\"-5 deg\", \"5 deg\"]\n\
                 [[vary]]\nkey = \"seed\"\nintegers = [1, 1000]\n"
            ));
        }
        for launch in ["helicopter-hover-lqr", "helicopter-longitudinal-smc", "helicopter-lateral-ppc"] {
            same(&format!(
                "launch = \"{launch}\"\nflights = 2\nset = [\"duration_s=7\"]\n\
                 [[vary]]\nkey = \"seed\"\nintegers = [1, 1000]\n\
                 [[vary]]\nkey = \"estimator.kind\"\namong = [\"model\", \"kinematic\"]\n"
            ));
        }
    }

    #[test]
    fn a_vehicle_that_leaves_its_model_ends_with_the_same_words() {
        let ends = same(
            "launch = \"quadrotor\"\nflights = 1\nset = [\"duration_s=9\", \"controller.law=manual\"]\n\
             [[effects]]\neffect = \"parameter_change\"\nwhere = \"A[2,1]\"\nvalue = \"90 1/s^2\"\n",
        );
        assert!(ends[0].as_ref().is_err_and(|why| why.contains("roll")), "{ends:?}");
    }
}
