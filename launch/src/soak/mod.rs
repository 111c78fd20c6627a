//! `whirlstand soak`: faults are injected into every node of a bench at random times, and the bench must survive.
//!
//! After a fault the bench has recovered when the plant has applied [`CALM_STEPS`] commands in a row that came in
//! time. The failsafe is compared with the launch file: no more than `misses_to_failsafe` steps may hold an old
//! command before the inputs go to neutral.

mod fault_injector;
mod result;

use std::process::ExitCode;

use crate::cli::{FaultArg, OverrideArgs, SoakArgs};
use crate::error::Failure;
use crate::exclusive::{Claim, OutFolder};
use crate::file::{DEFAULT, Plan, jobs};
use crate::run::{fly, unique_bench};
use crate::supervisor::Ending;
use fault_injector::{FaultInjector, FaultKind};
use result::SoakResult;
use whirlstand_msgs::names::did_you_mean;

/// Bench time of a soak: it ends when all faults are done, long before.
const FOR_EVER_S: f64 = 1e6;

/// Runs the command `soak`.
pub(crate) fn soak(args: &SoakArgs) -> Result<ExitCode, Failure> {
    if args.rounds == 0 {
        return Err(Failure::Mend("--rounds 0: at least one round is expected".into()));
    }
    let plan = plan(args)?;
    let nodes = nodes(args, &plan)?;
    let kind = match args.fault {
        FaultArg::Kill => FaultKind::Kill,
        FaultArg::Stop if args.stop_for > 0.0 && args.stop_for.is_finite() => {
            FaultKind::Stop(std::time::Duration::from_secs_f64(args.stop_for))
        }
        FaultArg::Stop => {
            return Err(Failure::Mend(format!("--stop-for {}: a time above 0 s is expected", args.stop_for)));
        }
    };
    let folder = tempfile::Builder::new()
        .prefix("whirlstand-soak-")
        .tempdir()
        .map_err(|e| Failure::file("make a folder in", &std::env::temp_dir(), &e))?;
    let seed = args.overrides.seed.unwrap_or(1);
    let mut injector = FaultInjector::new(&plan.config, &nodes, kind, args.rounds, seed);
    let out = OutFolder::given(folder.path())?;
    let claim = Claim::take(&plan.config.bench)?;
    let ran = fly(&plan, &out, &claim, &mut injector)?;
    if let Ending::Interrupted(signal) = ran.outcome.ending {
        return Ok(ExitCode::from(128 + signal as u8));
    }
    let result = SoakResult::new(args, &plan, seed, injector, &ran);
    crate::command::tell(&args.json, &result, || result.table())?;
    Ok(if result.ok { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

/// The launch file's first run, with as many restarts as there will be faults and without an end of its own.
fn plan(args: &SoakArgs) -> Result<Plan, Failure> {
    let overrides = OverrideArgs { duration: Some(FOR_EVER_S), ..args.overrides.clone() };
    let jobs = jobs(args.launch.as_deref().unwrap_or(DEFAULT), &overrides, false)?;
    let Some(job) = jobs.runs.into_iter().next() else {
        return Err(Failure::Run("the launch file has no run".into()));
    };
    let mut plan = job.plan;
    if plan.config.transport == whirlstand_bus::Transport::Inproc {
        return Err(Failure::Mend(
            "soak injects faults into processes: transport iceoryx2 or zenoh is expected".into(),
        ));
    }
    plan.expect.clear();
    plan.config.bench = unique_bench(&format!("soak-{}", plan.name));
    for node in &mut plan.nodes {
        node.section.restart = crate::file::Restart::OnFailure;
        node.section.max_restarts = u32::MAX;
    }
    if let Some(recorder) = &mut plan.config.recorder {
        recorder.most_runs = u32::MAX;
    }
    Ok(plan)
}

/// The nodes that get the faults.
fn nodes(args: &SoakArgs, plan: &Plan) -> Result<Vec<String>, Failure> {
    let all: Vec<_> = plan.nodes.iter().filter(|n| !n.section.external).map(|n| n.name.clone()).collect();
    if let Some(unknown) = args.nodes.iter().find(|n| !all.contains(n)) {
        let hint = did_you_mean(unknown, all.iter().map(String::as_str));
        return Err(Failure::Mend(format!(
            "--node {unknown}{hint}: the bench has the nodes {}",
            all.join(", ")
        )));
    }
    Ok(if args.nodes.is_empty() { all } else { args.nodes.clone() })
}
