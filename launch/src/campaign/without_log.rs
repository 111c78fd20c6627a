//! One bench in this thread without bus and log: its figures are to the last bit those that its log would give.

use whirlstand_evaluate::{Flown, FlownStep, NodeCounts, RunSummary};
use whirlstand_nodes::NodeError;
use whirlstand_nodes::config::NodeConfig;
use whirlstand_nodes::flight::{Pilot, Step};
use whirlstand_nodes::setup::Setup;

/// Flies a bench with the law and filter of `pilot`; `each` sees every step.
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
            x: step.x,
            u: step.u,
            flags: step.flags,
            disturbance: step.disturbance,
            setpoint: step.setpoint,
            innovation: (step.filter.nis(), step.filter.dof()),
            std: step.filter.std(),
            converged: step.filter.converged(),
        });
        each(step);
    })?;
    let [filter, law] = counts.refused;
    let counts = NodeCounts { misses: counts.misses, rejected: [counts.rejected, filter, law] };
    Ok(flown.summary(pilot.vehicle(), name, config.seed, &counts))
}
