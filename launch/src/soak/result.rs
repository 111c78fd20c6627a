//! Results of a soak test, as a table and as JSON.

use serde::Serialize;
use whirlstand_nodes::config::Mode;

use super::fault_injector::{CALM_STEPS, FaultInjector, InjectedFault};
use crate::cli::{FaultArg, SoakArgs};
use crate::file::Plan;
use crate::run::FinishedRun;
use crate::style;
use crate::supervisor::Ending;

/// The result of a soak.
#[derive(Debug, Serialize)]
pub(super) struct SoakResult {
    schema: &'static str,
    launch: String,
    mode: Mode,
    transport: String,
    fault: &'static str,
    rounds: u32,
    seed: u64,
    /// Steps in time that count as a recovery.
    calm_steps: u64,
    misses_to_failsafe: u32,
    wall_s: f64,
    nodes: Vec<NodeFaults>,
    faults: Vec<InjectedFault>,
    problems: Vec<String>,
    /// Nothing went wrong.
    pub ok: bool,
}

/// All faults of one node.
#[derive(Debug, Serialize)]
struct NodeFaults {
    node: String,
    faults: usize,
    recovered: usize,
    failsafes: usize,
    held_before_failsafe_max: Option<u64>,
    restart_s_max: Option<f64>,
    recovery_s_median: Option<f64>,
    recovery_s_max: Option<f64>,
}

impl NodeFaults {
    fn new(node: &str, all: &[InjectedFault]) -> Self {
        let faults: Vec<_> = all.iter().filter(|f| f.node == node).collect();
        let mut recoveries: Vec<f64> = faults.iter().filter_map(|f| f.recovery_s).collect();
        recoveries.sort_by(f64::total_cmp);
        Self {
            node: node.into(),
            faults: faults.len(),
            recovered: recoveries.len(),
            failsafes: faults.iter().filter(|f| f.held_before_failsafe.is_some()).count(),
            held_before_failsafe_max: faults.iter().filter_map(|f| f.held_before_failsafe).max(),
            restart_s_max: faults.iter().filter_map(|f| f.restart_s).max_by(f64::total_cmp),
            recovery_s_median: recoveries.get(recoveries.len() / 2).copied(),
            recovery_s_max: recoveries.last().copied(),
        }
    }
}

impl SoakResult {
    pub fn new(args: &SoakArgs, plan: &Plan, seed: u64, injector: FaultInjector, ran: &FinishedRun) -> Self {
        let mut problems: Vec<String> = injector
            .faults
            .iter()
            .filter_map(|f| f.problem.as_ref().map(|p| format!("{} at {:.2} s: {p}", f.node, f.at_s)))
            .collect();
        if injector.left() > 0 {
            problems.push(format!("{} faults were never reached", injector.left()));
        }
        if let Ending::Failed(failure) = &ran.outcome.ending {
            let words = failure.last_lines.join(" / ");
            problems.push(format!("{} {} [{words}]", failure.node, failure.how));
        }
        for node in &ran.outcome.killed_at_end {
            problems.push(format!("{node} hung at the end and had to be killed"));
        }
        problems.extend(ran.residue.clone());
        problems.extend(ran.log.as_deref().and_then(unreadable));
        let mut names: Vec<String> = plan.nodes.iter().map(|n| n.name.clone()).collect();
        names.retain(|n| injector.faults.iter().any(|f| f.node == *n));
        Self {
            schema: "whirlstand.soak.v1",
            launch: plan.name.clone(),
            mode: plan.config.mode,
            transport: plan.config.transport.to_string(),
            fault: match args.fault {
                FaultArg::Kill => "kill",
                FaultArg::Stop => "stop",
            },
            rounds: args.rounds,
            seed,
            calm_steps: CALM_STEPS,
            misses_to_failsafe: plan.config.plant.misses_to_failsafe,
            wall_s: ran.outcome.wall.as_secs_f64(),
            nodes: names.iter().map(|n| NodeFaults::new(n, &injector.faults)).collect(),
            faults: injector.faults,
            ok: problems.is_empty(),
            problems,
        }
    }

    /// The result for people.
    pub fn table(&self) -> String {
        let mut text = format!(
            "{} over {}: {} of every node, {} rounds, seed {}, {:.1} s\n\n",
            self.launch, self.transport, self.fault, self.rounds, self.seed, self.wall_s
        );
        let head = format!(
            "{:<12} {:>6} {:>10} {:>10} {:>11} {:>11} {:>15} {:>12}\n",
            "node", "faults", "recovered", "failsafes", "held steps", "restart s", "recovery s p50", "max"
        );
        text.push_str(&style::dim(&head));
        let seconds = |s: Option<f64>| s.map_or("-".into(), |s| format!("{s:.3}"));
        for n in &self.nodes {
            text.push_str(&format!(
                "{:<12} {:>6} {:>10} {:>10} {:>11} {:>11} {:>15} {:>12}\n",
                n.node,
                n.faults,
                n.recovered,
                n.failsafes,
                n.held_before_failsafe_max.map_or("-".into(), |h| h.to_string()),
                seconds(n.restart_s_max),
                seconds(n.recovery_s_median),
                seconds(n.recovery_s_max),
            ));
        }
        for problem in &self.problems {
            text.push_str(&format!("{} {problem}\n", style::bad("problem:")));
        }
        if self.ok {
            let all =
                "The bench survived every fault; nothing is left in shared memory, and the log is readable.";
            text.push_str(&format!("\n{}\n", style::good(all)));
        }
        text
    }
}

/// Why the log cannot be read, if it cannot.
fn unreadable(path: &std::path::Path) -> Option<String> {
    let read = whirlstand_logs::Log::open(path)
        .map_err(|e| e.to_string())
        .and_then(|log| whirlstand_logs::bench_record(&log).map_err(|e| e.to_string()));
    match read {
        Ok(record) if record.is_empty() => Some(format!("the log {} is empty", path.display())),
        Ok(_) => None,
        Err(e) => Some(format!("the log cannot be read: {e}")),
    }
}
