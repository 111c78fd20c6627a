//! `whirlstand soak`: faults are injected into a bench at random times, and the bench must survive with nothing lost.
//!
//! After a fault the bench has recovered when the plant has applied [`CALM_STEPS`](fault_injector) commands in a row that
//! came in time. The failsafe is compared with the launch file: no more than `misses_to_failsafe` steps may hold an old
//! command before the inputs go to neutral. What may be lost, and what may not, is in [`losses`].

mod fault;
mod fault_injector;
mod losses;
mod result;

use std::process::ExitCode;
use std::time::Duration;

use crate::cli::{OverrideArgs, SoakArgs};
use crate::error::Failure;
use crate::exclusive::{Claim, OutFolder};
use crate::file::{DEFAULT, Plan, jobs};
use crate::run::{fly, unique_bench};
use crate::supervisor::Ending;
use fault::FaultKind;
use fault_injector::FaultInjector;
use result::SoakResult;
use whirlstand_msgs::names::did_you_mean;

/// Bench time of a soak, s: far more than it needs, because it ends when all faults are done.
const FOR_EVER_S: f64 = 1e6;

/// Runs the command `soak`.
pub(crate) fn soak(args: &SoakArgs) -> Result<ExitCode, Failure> {
    if args.rounds == 0 {
        return Err(Failure::Mend("--rounds 0: at least one round is expected".into()));
    }
    let mut plan = plan(args)?;
    let nodes = nodes(args, &plan)?;
    let folder = tempfile::Builder::new()
        .prefix("whirlstand-soak-")
        .tempdir()
        .map_err(|e| Failure::file("make a folder in", &std::env::temp_dir(), &e))?;
    let seed = args.overrides.seed.unwrap_or(1);
    // The fault is prepared first: a file system of the soak's own has to exist before the first thread.
    let kind = FaultKind::prepare(args.fault, &mut plan, folder.path())?;
    let lasting = Duration::from_secs_f64(args.lasting);
    let mut injector = FaultInjector::new(&plan.config, &nodes, kind, lasting, (args.rounds, seed));
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

/// The plan of the launch file's first run, with as many restarts as there will be faults, and without an end
/// of its own.
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
    if plan.config.bridge.as_ref().is_some_and(|bridge| bridge.kind.is_vehicle()) {
        return Err(Failure::Mend(
            "soak watches the simulated plant: a launch file without a real vehicle is expected".into(),
        ));
    }
    plan.expect.clear();
    plan.config.bench = unique_bench(&format!("soak-{}", plan.name));
    for node in &mut plan.nodes {
        node.section.restart = crate::file::Restart::OnFailure;
        node.section.max_restarts = u32::MAX;
    }
    if let Some(recorder) = &mut plan.config.recorder {
        // The plant may be restarted by a fault, and by the launcher after a long silence.
        recorder.most_runs = args.rounds.saturating_mul(2).saturating_add(1);
    }
    Ok(plan)
}

/// The nodes that are targets of the faults.
fn nodes(args: &SoakArgs, plan: &Plan) -> Result<Vec<String>, Failure> {
    let all: Vec<_> = plan.nodes.iter().filter(|n| !n.section.external).map(|n| n.name.clone()).collect();
    if !args.fault.is_of_a_node() && !args.nodes.is_empty() {
        let fault = args.fault.word();
        return Err(Failure::Mend(format!("--node: --fault {fault} is done to the bench, not to a node")));
    }
    if let Some(unknown) = args.nodes.iter().find(|n| !all.contains(n)) {
        let hint = did_you_mean(unknown, all.iter().map(String::as_str));
        return Err(Failure::Mend(format!(
            "--node {unknown}{hint}: the bench has the nodes {}",
            all.join(", ")
        )));
    }
    Ok(if args.nodes.is_empty() { all } else { args.nodes.clone() })
}
