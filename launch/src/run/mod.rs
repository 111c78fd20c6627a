//! `whirlstand run`: runs a bench, from its launch file to its verdict.

mod law;
mod one;
mod progress;
mod reproducible;
mod start;
mod summarised;
mod summary;
mod verdict;
mod waits;

use std::path::Path;
use std::process::ExitCode;

pub(crate) use one::{FinishedRun, fly};
pub(crate) use progress::Progress;
pub(crate) use start::{folder_name, unique_bench};

use whirlstand_bus::Transport;
use whirlstand_msgs::units::rounded;

use crate::cli::{JsonArg, RunArgs};
use crate::command::clean::tidy;
use crate::error::Failure;
use crate::exclusive::{Claim, OutFolder};
use crate::file::{DEFAULT, Jobs, jobs};
use crate::live::{BenchCard, LiveAddresses, LivePage};
use crate::supervisor::Ending;

/// Runs a launch file, with all its variants one after the other, and writes log, summary and report.
pub(crate) fn run(args: &RunArgs) -> Result<ExitCode, Failure> {
    let jobs = jobs(args.launch.as_deref().unwrap_or(DEFAULT), &args.overrides, args.no_log)?;
    // All variants of a run share the given bench name; without one, each variant gets its own.
    let given = args.bench.as_deref().map(Claim::take).transpose()?;
    let live = LiveAddresses { page: args.live, foxglove: args.foxglove };
    fly_all(&jobs, given.as_ref(), args.out.as_deref(), live, &args.json)
}

/// Flies all runs of a launch file one after the other, and writes log, summary and report of each.
///
/// # Errors
/// When a bench cannot be started, or its files cannot be written.
pub(crate) fn fly_all(
    jobs: &Jobs,
    given: Option<&Claim>,
    out: Option<&Path>,
    live: LiveAddresses,
    json: &JsonArg,
) -> Result<ExitCode, Failure> {
    let out = match out {
        Some(path) => OutFolder::given(path)?,
        None => OutFolder::fresh(&start::folder_name(&jobs.name))?,
    };
    let quiet = json.is_printed();
    tidy(quiet);
    let page = live.page.or_else(|| jobs.runs.first().and_then(|job| job.plan.live));
    let page = LivePage::open(LiveAddresses { page, ..live })?;
    // The address is always printed, because the user could not find it otherwise.
    page.iter().for_each(LivePage::announce);
    let mut runs = Vec::new();
    for job in &jobs.runs {
        let (plan, variant) = (&job.plan, job.variant.as_deref());
        let (fresh, inner);
        let claim = match given {
            Some(claim) => claim,
            None => {
                fresh = Claim::take(&unique_bench(&plan.name))?;
                &fresh
            }
        };
        let folder = match variant {
            Some(variant) => {
                inner = OutFolder::given(&out.path().join(variant))?;
                &inner
            }
            None => &out,
        };
        if !quiet {
            announce(jobs, variant, plan, claim.bench());
        }
        let card = BenchCard { is_own: true, ..BenchCard::new(plan, claim.bench()) };
        let title = variant.map_or(jobs.name.clone(), |variant| format!("{} / {variant}", jobs.name));
        let looker = page.as_ref().map(|page| page.look_at(&card, &title)).transpose()?;
        let mut progress = progress::Progress::new(&plan.config, !quiet).with(looker);
        let ran = fly(plan, folder, claim, &mut progress);
        progress.finish();
        let ran = ran?;
        let stop = matches!(ran.outcome.ending, Ending::Interrupted(_));
        runs.push(summarised::summarise(variant, plan, ran));
        if stop {
            break;
        }
    }
    if let Some(page) = page {
        page.end("The run is over; its report and log are in the folder shown in the terminal.");
    }
    let whole = summary::whole(jobs, &runs);
    // The verdict is printed even when no file can be written any more.
    let written = summary::write(jobs, out.path(), &whole, &runs);
    crate::command::tell(json, &whole, || verdict::closing_lines(out.path(), &runs))?;
    written.map(|()| exit_code(&runs))
}

fn announce(jobs: &Jobs, variant: Option<&str>, plan: &crate::file::Plan, bench: &str) {
    let config = &plan.config;
    let mode = serde_json::to_value(config.mode).ok();
    let mode = mode.as_ref().and_then(|v| v.as_str()).unwrap_or_default();
    let variant = variant.map_or(String::new(), |v| format!(" / {v}"));
    crate::style::say(&format!(
        "{}{}: {} under {}, {} at {} Hz for {} s over {}, seed {}",
        crate::style::strong(&jobs.name),
        crate::style::strong(&variant),
        plan.vehicle.name,
        law::law(config),
        mode,
        // The period is a whole number of nanoseconds: 130 Hz would be 129.9999948 Hz.
        rounded(1e9 / config.period_ns as f64, 6),
        rounded(config.steps as f64 * config.period_ns as f64 * 1e-9, 6),
        config.transport,
        config.seed,
    ));
    if config.transport != Transport::Inproc {
        crate::style::say(&BenchCard::new(plan, bench).line());
    }
}

/// Exit code: 0 when all went well, 1 when a run or an expectation failed, 2 when the user can correct the
/// failure, 128 + n after signal n.
fn exit_code(runs: &[summarised::Summarised]) -> ExitCode {
    let code = runs.iter().map(|run| match &run.ending {
        Ending::Interrupted(signal) => 128 + *signal as u8,
        Ending::Failed(failure) if failure.mendable => 2,
        Ending::Failed(_) => 1,
        Ending::Complete if run.holds() => 0,
        Ending::Complete => 1,
    });
    ExitCode::from(code.max().unwrap_or(0))
}
