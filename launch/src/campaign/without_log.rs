//! One bench in this thread without bus and log. Its figures are bit for bit those that its log would give.

use whirlstand_evaluate::{Flown, FlownStep, FlownTogether, NodeCounts, RunSummary};
use whirlstand_nodes::NodeError;
use whirlstand_nodes::config::NodeConfig;
use whirlstand_nodes::flight::{Counts, LANES, Pilot, Step};
use whirlstand_nodes::setup::Setup;

/// Flies a bench with the law and filter of `pilot`; `each` is called with every step.
///
/// # Errors
/// As [`Pilot::fly`].
pub(crate) fn without_log(
    config: &NodeConfig,
    pilot: &Pilot,
    name: &str,
    mut each: impl FnMut(&Step<'_>),
) -> Result<RunSummary, NodeError> {
    let mut flown = Flown::new(pilot.vehicle(), Setup::period_s(config), config.steps as usize);
    let counts = pilot.fly(config, |step| {
        flown.take(&FlownStep {
            stamp_ns: step.stamp_ns,
            x: step.x.as_chunks().0,
            u: step.u.as_chunks().0,
            flags: &[step.flags],
            disturbance: step.disturbance.as_chunks().0,
            setpoint: step.setpoint,
            nis: &[step.filter.nis()],
            dof: step.filter.dof(),
            std: step.filter.std(),
            converged: step.filter.converged(),
        });
        each(step);
    })?;
    Ok(flown.summary(pilot.vehicle(), name, config.seed, &node_counts(&counts)))
}

fn node_counts(counts: &Counts) -> NodeCounts {
    let [filter, law] = counts.refused;
    NodeCounts { misses: counts.misses, rejected: [counts.rejected, filter, law] }
}

/// Flies benches with the law and filter of `pilot` side by side. Each bench has a name; the result is `None` for
/// one that has to be flown alone.
pub(super) fn together_without_log(
    benches: [(&NodeConfig, &str); LANES],
    pilot: &Pilot,
) -> [Option<RunSummary>; LANES] {
    let vehicle = pilot.vehicle();
    let (first, _) = benches[0];
    let mut flown = FlownTogether::new(vehicle, Setup::period_s(first), first.steps as usize);
    let counts = pilot.fly_together(&benches.map(|(config, _)| config), &mut |step| {
        flown.take(&FlownStep {
            stamp_ns: step.stamp_ns,
            x: step.x,
            u: step.u,
            flags: step.flags,
            disturbance: step.disturbance,
            setpoint: step.setpoint,
            nis: step.filter.nis(),
            dof: step.filter.dof(),
            std: step.filter.std(),
            converged: step.filter.converged(),
        });
    });
    std::array::from_fn(|lane| {
        let (config, name) = benches[lane];
        Some(flown.summary(lane, (vehicle, name, config.seed), &node_counts(&counts[lane]?)))
    })
}
