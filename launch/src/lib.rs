//! The command line, the supervisor and the launch files.

mod campaign;
mod cli;
mod command;
mod doctor;
mod error;
mod exclusive;
mod file;
mod key_folder;
mod keys;
mod limits;
mod live;
mod memory;
mod proc_stat;
mod run;
mod soak;
mod style;
mod supervisor;
mod tune;

use std::process::ExitCode;

use clap::Parser;
use rustix::fs::Mode;
use rustix::process::umask;
use tracing_subscriber::EnvFilter;

use cli::{Cli, Command};
use error::Failure;

/// Default log filter: warnings only, and only errors of Zenoh. Zenoh warns of the gossip that a bench
/// disables on purpose.
const QUIET: &str = "warn,zenoh=error";

/// Runs the `whirlstand` command.
pub fn main() -> ExitCode {
    let (name, value) = whirlstand_bus::ONE_THREAD;
    if std::env::var_os(name).is_none() {
        // SAFETY: this is the first action of the process, so no other thread reads the environment. Nodes and
        // programs under `exec` inherit the variable.
        unsafe { std::env::set_var(name, value) };
    }
    let cli = Cli::parse();
    keep_private();
    let result = start_tracing(cli.log_level.as_deref()).and_then(|()| dispatch(&cli.command));
    result.unwrap_or_else(|failure| {
        style::say(&format!("{} {failure}", style::bad("error:")));
        failure.exit_code()
    })
}

/// Restricts the files that this process and its children create to the user: shared memory, sockets, locks, logs
/// and pages.
fn keep_private() {
    let theirs = Mode::from_bits_retain(0o077);
    let before = umask(theirs);
    umask(before | theirs);
}

fn dispatch(command: &Command) -> Result<ExitCode, Failure> {
    match command {
        Command::Run(args) => run::run(args),
        Command::Node(args) => command::node::node(args),
        Command::Design(args) => command::design::design(args),
        Command::Simulate(args) => command::simulate::simulate(args),
        Command::Compare(args) => command::compare::compare(args),
        Command::Diagnose(args) => command::diagnose::diagnose(args),
        Command::Tune(args) => tune::tune(args),
        Command::Identify(args) => command::identify::identify(args),
        Command::Blind(args) => command::blind::blind(args),
        Command::Campaign(args) => campaign::campaign(args),
        Command::Excite(args) => command::excite::excite(args),
        Command::Log(command) => command::log::log(command),
        Command::Vehicle(command) => command::vehicles::vehicles(command),
        Command::Launch(command) => command::launch_files::launch_files(command),
        Command::Keys(command) => command::keys::keys(command),
        Command::Inject(args) => command::adjust::inject(args),
        Command::Set(args) => command::adjust::set(args),
        Command::Echo(args) => command::echo::echo(args),
        Command::Watch(args) => command::watch::watch(args),
        Command::Play(args) => command::watch::play(args),
        Command::Bench(args) => command::bench::bench(args),
        Command::Bridge(command) => command::bridge::bridge(command),
        Command::Relay(command) => command::relay::relay(command),
        Command::Doctor(args) => doctor::doctor(args),
        Command::Soak(args) => soak::soak(args),
        Command::Clean(args) => command::clean::clean(args),
        Command::Completions(args) => command::shell::completions(args),
        Command::Man(args) => command::shell::man(args),
        Command::Guard(args) => command::guard::guard(args),
        Command::Exec(args) => command::node::exec(args),
    }
}

/// Diagnostics go to standard error, filtered by `--log-level` or else by `RUST_LOG`; the nodes inherit the filter.
fn start_tracing(level: Option<&str>) -> Result<(), Failure> {
    let given = level.map(str::to_string).or_else(|| std::env::var("RUST_LOG").ok());
    let text = given.unwrap_or_else(|| QUIET.into());
    let filter = text.parse::<EnvFilter>().map_err(|e| {
        Failure::Mend(format!(
            "the log level '{text}' is not understood ({e}): write error, warn, info, debug or trace"
        ))
    })?;
    let colour =
        std::io::IsTerminal::is_terminal(&std::io::stderr()) && std::env::var_os("NO_COLOR").is_none();
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(colour)
        .with_target(false)
        .init();
    Ok(())
}
