//! Name of the law under which a vehicle flies.

use whirlstand_bridge::autopilot::AutopilotConfig;
use whirlstand_nodes::config::NodeConfig;

/// Name of the law under which the vehicle flies; an autopilot replaces the controller and its law.
pub(super) fn law(config: &NodeConfig) -> String {
    let autopilot = config.bridge.as_ref().and_then(AutopilotConfig::of);
    let own = serde_json::to_value(config.controller.law).ok();
    match autopilot {
        Some(autopilot) => autopilot.kind.autopilot().into(),
        None => own.as_ref().and_then(|law| law.as_str()).unwrap_or_default().into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::OverrideArgs;
    use crate::file::jobs;

    #[test]
    fn an_autopilot_flies_under_its_own_law_and_not_under_that_of_the_controller_it_replaces() {
        let law_of = |launch: &str, set: &[String]| {
            let overrides = OverrideArgs { set: set.to_vec(), ..OverrideArgs::default() };
            let jobs = jobs(launch, &overrides, true).unwrap();
            law(&jobs.runs[0].plan.config)
        };
        let bridge = |kind: &str| vec![format!("nodes.controller.bridge={kind}")];
        assert_eq!(law_of("quadrotor", &["controller.law=lqr".into()]), "lqr");
        assert_eq!(law_of("quadrotor", &bridge("px4-hil")), "PX4");
        assert_eq!(law_of("quadrotor", &bridge("ardupilot-json")), "ArduPilot");
        assert_eq!(law_of("quadrotor-mavlink", &[]), "lqr", "our controller flies a real vehicle");
    }
}
