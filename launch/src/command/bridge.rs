//! `whirlstand bridge`: checks the axes of real hardware.

use std::io::{IsTerminal, Write};
use std::process::ExitCode;
use std::time::Duration;

use whirlstand_msgs::names::did_you_mean;
use whirlstand_nodes::bridge::check::{CheckOptions, Consent, Finding, check_autopilot, check_vehicle};

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
    let mut ask = |question: &str| if args.yes { Consent::Given } else { consent(question) };
    let (mut wrong, mut unknown) = (0, 0);
    let mut say = |finding| {
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
    };
    let checked = if bridge.kind.is_vehicle() {
        check_vehicle(&config, bridge, &options, &mut ask, &mut say)
    } else {
        check_autopilot(&config, bridge, &options, &mut say)
    };
    checked.map_err(|e| if is_mendable(&e) { Failure::mend(e) } else { Failure::run(e) })?;
    if wrong > 0 {
        print(&format!("{}\n", style::bad(&format!("{wrong} checks failed"))))?;
    }
    if unknown > 0 {
        print(&format!("{}\n", style::bad(&format!("{unknown} checks were not possible"))))?;
    }
    Ok(ExitCode::from(u8::from(wrong + unknown > 0)))
}

/// Asks on the terminal whether the channels may move; anything but a yes is a no.
fn consent(question: &str) -> Consent {
    let (stdin, mut stderr) = (std::io::stdin(), anstream::stderr());
    if !stdin.is_terminal() || !std::io::stderr().is_terminal() {
        return Consent::Nobody;
    }
    let mut answer = String::new();
    // A terminal that has gone away answers nothing, which is a no.
    let _ = write!(stderr, "{} [y/N] ", style::rendered(question)).and_then(|()| stderr.flush());
    let _ = stdin.read_line(&mut answer);
    match answer.trim().to_ascii_lowercase().as_str() {
        "y" | "yes" => Consent::Given,
        _ => Consent::Refused,
    }
}
