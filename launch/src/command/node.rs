//! `whirlstand node`: one node, started by the launcher or by hand. Also the process that becomes another
//! program.

use std::io::Read;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

use whirlstand_bus::{OpenError, over_tls};
use whirlstand_msgs::names::did_you_mean;
use whirlstand_nodes::NodeError;
use whirlstand_nodes::config::{NodeConfig, RealtimeOptions, Role};
use whirlstand_nodes::os::apply_realtime;

use crate::cli::{ExecArgs, NodeArgs};
use crate::error::Failure;
use crate::file::{DEFAULT, Security, jobs, secret_beyond_its_reach};
use crate::keys::{BenchKeys, await_configuration};

/// Runs one node to its end.
pub(crate) fn node(args: &NodeArgs) -> Result<ExitCode, Failure> {
    let role = role(&args.kind)?;
    crate::limits::check_for_bench()?;
    let (mut config, security) = match &args.config {
        Some(path) => (from_launcher(path)?, Security::Open),
        None => by_hand(args)?,
    };
    config.zenoh.listen.extend(args.listen.iter().cloned());
    config.zenoh.connect.extend(args.connect.iter().cloned());
    if let Ok(peers) = std::env::var("WHIRLSTAND_ZENOH_CONNECT") {
        config.zenoh.connect.extend(peers.split(',').filter(|e| !e.is_empty()).map(str::to_string));
    }
    if security == Security::Secret {
        join_with_secret(role, &mut config)?;
    }
    match whirlstand_nodes::run_node(role, &config) {
        Ok(_) => Ok(ExitCode::SUCCESS),
        Err(e) if is_mendable(&e) => Err(Failure::mend(e)),
        Err(
            e @ (NodeError::Diverged { .. } | NodeError::NotArmed { .. } | NodeError::NoAutopilot { .. }),
        ) => Err(Failure::Final(e.to_string())),
        Err(e) => Err(Failure::run(e)),
    }
}

/// Whether another attempt would fail in the same way until the user changes something.
pub(crate) fn is_mendable(error: &NodeError) -> bool {
    matches!(
        error,
        NodeError::Vehicle { .. }
            | NodeError::NotOnBus { .. }
            | NodeError::Config { .. }
            | NodeError::Design { .. }
            | NodeError::Realtime(_)
            | NodeError::Open(
                OpenError::Name { .. }
                    | OpenError::Schema { .. }
                    | OpenError::ZenohConfig { .. }
                    | OpenError::Full { .. }
            )
    )
}

fn role(kind: &str) -> Result<Role, Failure> {
    let known = Role::ALL.map(Role::name);
    Role::ALL.into_iter().find(|r| r.name() == kind).ok_or_else(|| {
        let hint = did_you_mean(kind, known);
        Failure::Mend(format!("there is no node '{kind}'{hint}; known are {}", known.join(", ")))
    })
}

fn from_launcher(path: &Path) -> Result<NodeConfig, Failure> {
    let mut text = String::new();
    let read = if path == Path::new("-") {
        std::io::stdin().read_to_string(&mut text).map(|_| ())
    } else {
        std::fs::read_to_string(path).map(|t| text = t)
    };
    read.map_err(|e| Failure::file("read the node's configuration from", path, &e))?;
    serde_json::from_str(&text)
        .map_err(|e| Failure::Mend(format!("{}: this is not a node's configuration: {e}", path.display())))
}

/// The configuration of a node of a bench whose other nodes run elsewhere.
fn by_hand(args: &NodeArgs) -> Result<(NodeConfig, Security), Failure> {
    let jobs = jobs(args.launch.as_deref().unwrap_or(DEFAULT), &args.overrides, args.output.is_none())?;
    let Some(job) = jobs.runs.into_iter().next() else {
        return Err(Failure::Run("the launch file has no run".into()));
    };
    let mut plan = job.plan;
    let named = || std::env::var("WHIRLSTAND_BENCH").ok();
    plan.config.bench = args.bench.clone().or_else(named).unwrap_or(jobs.name);
    if let Security::Tls(_) = plan.security {
        plan.config.zenoh.protection = BenchKeys::new(&plan)?.protection(&args.kind)?;
    }
    let mut config = plan.config;
    if let (Some(recorder), Some(output)) = (&mut config.recorder, &args.output) {
        recorder.path = output.to_string_lossy().into_owned();
    }
    if args.kind == Role::Recorder.name() && config.recorder.is_none() {
        return Err(Failure::Mend("a recorder needs a file to write: give it with --output FILE".into()));
    }
    Ok((config, plan.security))
}

/// Takes the secret of a bench of this user on this host; the bench may only be starting.
fn join_with_secret(role: Role, config: &mut NodeConfig) -> Result<(), Failure> {
    let endpoints = [config.zenoh.listen.clone(), config.zenoh.connect.clone()].concat();
    if let Some(why) = secret_beyond_its_reach(&endpoints) {
        return Err(Failure::Mend(why));
    }
    let patience = Duration::from_secs_f64(config.start_timeout_s);
    config.zenoh.config = Some(await_configuration(&config.bench, role.name(), patience)?);
    for endpoint in config.zenoh.listen.iter_mut().chain(&mut config.zenoh.connect) {
        *endpoint = over_tls(endpoint).map_err(Failure::Mend)?;
    }
    Ok(())
}

/// Requests the real-time options and then becomes the program. Returns only when that fails.
pub(crate) fn exec(args: &ExecArgs) -> Result<ExitCode, Failure> {
    let options: RealtimeOptions = serde_json::from_str(&args.realtime)
        .map_err(|e| Failure::Mend(format!("--realtime: these are not real-time options: {e}")))?;
    apply_realtime(&options).map_err(Failure::mend)?;
    let Some((program, arguments)) = args.command.split_first() else {
        return Err(Failure::Mend("a program is expected after --".into()));
    };
    let error = std::process::Command::new(program).args(arguments).exec();
    Err(Failure::Mend(format!("{program} cannot be started: {error}")))
}
