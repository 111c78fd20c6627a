//! Results of a soak test, as a table and as JSON.

use serde::Serialize;
use whirlstand_nodes::config::Mode;

use super::fault_injector::{CALM_STEPS, FaultInjector, InjectedFault};
use super::losses::losses;
use crate::cli::SoakArgs;
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
    /// Number of consecutive steps in time that count as a recovery.
    calm_steps: u64,
    misses_to_failsafe: u32,
    wall_s: f64,
    /// Number of injected faults after which the loop flew again.
    given: usize,
    survived: usize,
    /// Median time from a fault's end until the loop had recovered, s.
    recovery_s_median: Option<f64>,
    recovery_s_max: Option<f64>,
    /// Number of messages that nodes did not receive, over all nodes. Losses that must not occur are among
    /// the problems.
    lost: u64,
    nodes: Vec<NodeFaults>,
    faults: Vec<InjectedFault>,
    problems: Vec<String>,
    /// Whether nothing went wrong.
    pub ok: bool,
}

/// All faults of one node, or of the bench.
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
        let recoveries = recoveries(faults.iter().copied());
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

/// Times of recovery in ascending order, s.
fn recoveries<'a>(faults: impl Iterator<Item = &'a InjectedFault>) -> Vec<f64> {
    let mut times: Vec<f64> = faults.filter_map(|fault| fault.recovery_s).collect();
    times.sort_by(f64::total_cmp);
    times
}

impl SoakResult {
    pub fn new(args: &SoakArgs, plan: &Plan, seed: u64, injector: FaultInjector, ran: &FinishedRun) -> Self {
        let mut problems: Vec<String> = injector
            .faults
            .iter()
            .filter_map(|f| f.problem.as_ref().map(|p| format!("{} at {:.2} s: {p}", f.node, f.at_s)))
            .collect();
        if injector.left() > 0 {
            problems.push(format!("{} faults were never injected", injector.left()));
        }
        if let Ending::Failed(failure) = &ran.outcome.ending {
            let words = failure.last_lines.join(" / ");
            problems.push(format!("{} {} [{words}]", failure.node, failure.how));
        }
        for node in &ran.outcome.killed_at_end {
            problems.push(format!("{node} hung at the end and had to be killed"));
        }
        problems.extend(ran.residue.clone());
        problems.extend(losses(
            (args.fault, plan.config.mode),
            &ran.outcome,
            ran.log.as_deref(),
            injector.forged,
        ));
        let mut names: Vec<String> = injector.faults.iter().map(|f| f.node.clone()).collect();
        names.sort();
        names.dedup();
        let recoveries = recoveries(injector.faults.iter());
        Self {
            schema: "whirlstand.soak.v1",
            launch: plan.name.clone(),
            mode: plan.config.mode,
            transport: plan.config.transport.to_string(),
            fault: args.fault.word(),
            rounds: args.rounds,
            seed,
            calm_steps: CALM_STEPS,
            misses_to_failsafe: plan.config.plant.misses_to_failsafe,
            wall_s: ran.outcome.wall.as_secs_f64(),
            given: injector.faults.len(),
            survived: recoveries.len(),
            recovery_s_median: recoveries.get(recoveries.len() / 2).copied(),
            recovery_s_max: recoveries.last().copied(),
            lost: ran.outcome.health.lost(),
            nodes: names.iter().map(|n| NodeFaults::new(n, &injector.faults)).collect(),
            faults: injector.faults,
            ok: problems.is_empty(),
            problems,
        }
    }

    /// The result as a table in text.
    pub fn table(&self) -> String {
        let mut text = format!(
            "{} over {}: {}, {} rounds, seed {}, {:.1} s\n\n",
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
        text.push_str(&format!(
            "\n{} of {} faults survived, recovery p50 {} s, max {} s, {} messages lost\n",
            self.survived,
            self.given,
            seconds(self.recovery_s_median),
            seconds(self.recovery_s_max),
            self.lost
        ));
        for problem in &self.problems {
            text.push_str(&format!("{} {problem}\n", style::bad("problem:")));
        }
        if self.ok {
            let all = "The bench survived every fault: no unexpected losses, nothing left in shared memory.";
            text.push_str(&format!("{}\n", style::good(all)));
        }
        text
    }
}
