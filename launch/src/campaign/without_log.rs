//! One bench in this thread without bus and log: its figures are to the last bit those that its log would give.

use whirlstand_evaluate::{Flown, FlownStep, NodeCounts, RunSummary};
use whirlstand_nodes::NodeError;
use whirlstand_nodes::config::NodeConfig;
use whirlstand_nodes::flight::{Counts, LANES, Pilot, Step};
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
    Ok(flown.summary(pilot.vehicle(), name, config.seed, &node_counts(&counts)))
}

fn node_counts(counts: &Counts) -> NodeCounts {
    let [filter, law] = counts.refused;
    NodeCounts { misses: counts.misses, rejected: [counts.rejected, filter, law] }
}

/// Flies benches with the law and filter of `pilot` side by side, each with a name; `None` for one that has to be flown alone.
pub(super) fn together_without_log(
    benches: [(&NodeConfig, &str); LANES],
    pilot: &Pilot,
) -> [Option<RunSummary>; LANES] {
    let vehicle = pilot.vehicle();
    let new = |(config, _): (&NodeConfig, &str)| {
        Flown::new(vehicle, Setup::period_s(config), config.steps as usize)
    };
    let mut flown = benches.map(new);
    let (mut x, mut disturbance) = (vec![0.0; vehicle.states.len()], vec![0.0; vehicle.states.len()]);
    let mut u = vec![0.0; vehicle.inputs.len()];
    let counts = pilot.fly_together(&benches.map(|(config, _)| config), |step| {
        for (lane, flown) in flown.iter_mut().enumerate().filter(|(lane, _)| !step.lost[*lane]) {
            let pick = |row: &mut [f64], all: &[[f64; LANES]]| {
                row.iter_mut().zip(all).for_each(|(value, all)| *value = all[lane]);
            };
            pick(&mut x, step.x);
            pick(&mut u, step.u);
            pick(&mut disturbance, step.disturbance);
            flown.take(&FlownStep {
                stamp_ns: step.stamp_ns,
                x: &x,
                u: &u,
                flags: step.flags[lane],
                disturbance: &disturbance,
                setpoint: step.setpoint,
                innovation: (step.filter.nis()[lane], step.filter.dof()),
                std: step.filter.std(),
                converged: step.filter.converged(),
            });
        }
    });
    let mut flown = flown.into_iter().zip(benches).zip(counts);
    std::array::from_fn(|_| {
        let ((flown, (config, name)), counts) = flown.next()?;
        Some(flown.summary(vehicle, name, config.seed, &node_counts(&counts?)))
    })
}
