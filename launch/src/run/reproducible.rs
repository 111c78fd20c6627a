//! Whether another run of the same launch file would leave the same log, bit for bit.

use whirlstand_evaluate::metrics::Timing;
use whirlstand_nodes::config::NodeConfig;

/// Reasons why another run can differ from this one; empty for a reproducible run.
pub(super) fn reasons_against(
    config: &NodeConfig,
    timing: &Timing,
    restarts: &[(String, u32)],
) -> Vec<String> {
    let mut reasons = Vec::new();
    let mut count = |n: u64, one: &str, many: &str| match n {
        0 => {}
        1 => reasons.push(format!("1 {one}")),
        n => reasons.push(format!("{n} {many}")),
    };
    count(timing.deadline_misses, "step had no command in time", "steps had no command in time");
    count(timing.lost, "message was lost", "messages were lost");
    let starts = restarts.iter().filter(|(_, n)| *n > 0);
    reasons.extend(
        starts.map(|(node, n)| format!("{node} was restarted ({n} times)").replace("(1 times)", "once")),
    );
    let outside = [
        (config.plant.inject, "disturbances are accepted from outside (plant.inject)"),
        (config.controller.pilot, "setpoints are accepted from outside (controller.pilot)"),
        (config.bridge.is_some(), "a bridge talks to a system with its own clock"),
    ];
    reasons.extend(outside.into_iter().filter(|(is, _)| *is).map(|(_, why)| why.to_string()));
    reasons
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::file::jobs;

    #[test]
    fn a_run_without_a_fault_is_reproducible_and_another_says_why_not() {
        let jobs = jobs("quadrotor", &Default::default(), false).unwrap();
        let mut config = jobs.runs[0].plan.config.clone();
        let mut timing = Timing::default();
        assert!(reasons_against(&config, &timing, &[("plant".into(), 0)]).is_empty());
        (timing.deadline_misses, timing.lost) = (2, 1);
        config.plant.inject = true;
        assert_eq!(
            reasons_against(&config, &timing, &[("plant".into(), 1)]),
            [
                "2 steps had no command in time",
                "1 message was lost",
                "plant was restarted once",
                "disturbances are accepted from outside (plant.inject)",
            ]
        );
    }
}
