//! `whirlstand bridge`: checks the axes of real hardware.

use std::process::ExitCode;
use std::time::Duration;

use whirlstand_msgs::names::did_you_mean;
use whirlstand_nodes::bridge::check::{CheckOptions, Finding, check_autopilot, check_vehicle};

use super::node::is_mendable;
use super::print;
use crate::cli::{BridgeCheckArgs, BridgeCommand, OverrideArgs};
use crate::error::Failure;
use crate::file::jobs;
use crate::style;

/// Runs the subcommand.
pub(crate) fn bridge(command: &BridgeCommand) -> Result<ExitCode, Failure> {
    match command {
        BridgeCommand::Check(args) => check(args),
    }
}

/// Checks the axes. The exit code is 1 when an axis is wrong, or could not be checked.
fn check(args: &BridgeCheckArgs) -> Result<ExitCode, Failure> {
    let overrides = OverrideArgs { set: args.set.clone(), ..OverrideArgs::default() };
    let jobs = jobs(&args.launch, &overrides, true)?;
    let Some(job) = jobs.runs.into_iter().next() else {
        return Err(Failure::Run("the launch file has no run".into()));
    };
    let config = job.plan.config;
    let Some(bridge) = &config.bridge else {
        return Err(Failure::Mend(format!(
            "{}: no node is a bridge; write bridge = \"mavlink\" under [nodes.plant]",
            args.launch
        )));
    };
    let place = if bridge.kind.is_vehicle() { "plant" } else { "controller" };
    if args.node != place {
        return Err(Failure::Mend(format!(
            "node '{}' is not a bridge{}: in {} the bridge is the {place} ({})",
            args.node,
            did_you_mean(&args.node, [place]),
            args.launch,
            bridge.kind
        )));
    }
    let options = CheckOptions {
        timeout: Duration::from_secs_f64(args.timeout),
        outputs: !args.no_outputs,
        telemetry: args.telemetry.clone(),
        arm: args.arm,
    };
    let check = if bridge.kind.is_vehicle() { check_vehicle } else { check_autopilot };
    let (mut wrong, mut unknown) = (0, 0);
    check(&config, bridge, &options, &mut |finding| {
        let text = match finding {
            Finding::Ask(text) | Finding::Told(text) => format!("{text}\n"),
            Finding::Good(text) => format!("{} {text}\n", style::good("ok")),
            Finding::Unknown(text) => {
                unknown += 1;
                format!("{} {text}\n", style::dim("not checked"))
            }
            Finding::Wrong(text) => {
                wrong += 1;
                format!("{} {text}\n", style::bad("WRONG"))
            }
        };
        // A reader that has gone away does not end the check.
        let _ = print(&text);
    })
    .map_err(|e| if is_mendable(&e) { Failure::mend(e) } else { Failure::run(e) })?;
    if wrong > 0 {
        print(&format!("{}\n", style::bad(&format!("{wrong} checks failed"))))?;
    }
    if unknown > 0 {
        print(&format!("{}\n", style::bad(&format!("{unknown} checks were not possible"))))?;
    }
    Ok(ExitCode::from(u8::from(wrong + unknown > 0)))
}
