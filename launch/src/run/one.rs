//! One run of one bench: in this process, or as processes under the supervisor.

use std::path::{Path, PathBuf};

use whirlstand_bus::Transport;
use whirlstand_nodes::inproc::run_inproc;
use whirlstand_nodes::os::StopFlag;

use super::start::{Listener, bench_spec, start_guard, sweep};
use crate::command::node::is_mendable;
use crate::error::Failure;
use crate::exclusive::{Claim, OutFolder};
use crate::file::Plan;
use crate::keys::BenchKeys;
use crate::live::BenchCard;
use crate::supervisor::{Observer, Outcome, ThreadEnd, supervise, supervise_thread};

/// A finished run.
#[derive(Debug)]
pub(crate) struct FinishedRun {
    /// How the run ended, and the health of its nodes.
    pub outcome: Outcome,
    /// The log; `None` when the run keeps none.
    pub log: Option<PathBuf>,
    /// Reason why shared memory of the bench could not be removed.
    pub residue: Option<String>,
}

/// Runs a planned bench to its end under its claimed name, and leaves nothing of it but the log in `folder`.
///
/// # Errors
/// When the bench cannot be started. A run that fails is not an error of this function.
pub(crate) fn fly(
    plan: &Plan,
    folder: &OutFolder,
    claim: &Claim,
    observer: &mut dyn Observer,
) -> Result<FinishedRun, Failure> {
    crate::limits::check_for_bench()?;
    let mut plan = plan.clone();
    plan.config.bench = claim.bench().into();
    let log = folder.path().join("log.mcap");
    if let Some(recorder) = &mut plan.config.recorder {
        recorder.path = log.to_string_lossy().into_owned();
        remove_old_logs(folder.path())?;
    }
    let log = plan.config.recorder.is_some().then_some(log);
    let keys = BenchKeys::new(&plan)?;
    BenchCard::new(&plan, claim.bench()).leave_in(claim.sockets())?;
    if plan.config.transport == Transport::Inproc {
        let outcome = fly_in_thread(&plan, &keys, claim, observer);
        observer.closed();
        let outcome = outcome?;
        return Ok(FinishedRun { outcome, log, residue: None });
    }
    let spec = bench_spec(&plan, &keys, claim.sockets(), folder.path())?;
    let guard = start_guard(&spec, claim, folder)?;
    let mut listener = Listener::open(&plan, &keys, claim)?;
    observer.opened(listener.bus()).map_err(Failure::mend)?;
    tracing::debug!(bench = plan.config.bench, "the bench is open");
    let outcome = supervise(spec, Some(guard), &mut listener, observer);
    observer.closed();
    drop(listener);
    let residue = sweep(&plan.config.bench).err().map(|e| e.to_string());
    let outcome = outcome.map_err(|e| Failure::Run(format!("the supervisor failed: {e}")))?;
    Ok(FinishedRun { outcome, log, residue })
}

fn fly_in_thread(
    plan: &Plan,
    keys: &BenchKeys,
    claim: &Claim,
    observer: &mut dyn Observer,
) -> Result<Outcome, Failure> {
    let mut listener = Listener::open(plan, keys, claim)?;
    let config = plan.config.clone();
    let flag = StopFlag::default();
    let body = {
        let flag = flag.clone();
        move || -> ThreadEnd {
            match run_inproc(&config, &flag) {
                Ok(ended) => Ok(ended.reports.into_iter().map(|(_, health)| health).collect()),
                Err(e) => Err((e.to_string(), is_mendable(&e))),
            }
        }
    };
    supervise_thread(body, || flag.set(), &mut listener, observer)
        .map_err(|e| Failure::Run(format!("the supervisor failed: {e}")))
}

/// Removes the logs of an earlier run from the folder, so that none of their files is taken for a part of this
/// run.
fn remove_old_logs(folder: &Path) -> Result<(), Failure> {
    let entries = std::fs::read_dir(folder).map_err(|e| Failure::file("use the folder", folder, &e))?;
    for path in entries.flatten().map(|entry| entry.path()) {
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        if name.starts_with("log.") && name.ends_with("mcap") {
            std::fs::remove_file(&path).map_err(|e| Failure::file("remove the old log", &path, &e))?;
        }
    }
    Ok(())
}
