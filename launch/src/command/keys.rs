//! `whirlstand keys`: makes keys for several hosts, and prints the configuration with which an outside
//! program joins a bench.

use std::process::ExitCode;

use whirlstand_nodes::config::Role;

use super::print;
use crate::cli::{KeysCommand, KeysNewArgs, KeysShowArgs};
use crate::error::Failure;
use crate::key_folder::KeyFolder;
use crate::keys::{GUEST, LAUNCHER, LOOPBACK, OBSERVER, configuration};

/// Runs the subcommand.
pub(crate) fn keys(command: &KeysCommand) -> Result<ExitCode, Failure> {
    match command {
        KeysCommand::New(args) => new(args),
        KeysCommand::Show(args) => show(args),
    }
}

fn new(args: &KeysNewArgs) -> Result<ExitCode, Failure> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
    if let Some(wrong) = args.nodes.iter().find(|n| n.is_empty() || n.len() > 32 || !n.chars().all(allowed)) {
        return Err(Failure::Mend(format!(
            "--node '{wrong}': 1 to 32 letters, digits, '_', '-' or '.' are expected"
        )));
    }
    let mut names: Vec<String> = Role::ALL.map(Role::name).map(String::from).into();
    names.extend([LAUNCHER, OBSERVER, GUEST].map(String::from));
    names.extend(args.nodes.iter().cloned());
    names.sort();
    names.dedup();
    let hosts: Vec<String> =
        LOOPBACK.map(String::from).into_iter().chain(args.hosts.iter().cloned()).collect();
    KeyFolder::make(&args.folder, &names, &hosts)?;
    print(&format!(
        "{}: keys for {}, valid on {}\n",
        args.folder.display(),
        names.join(", "),
        hosts.join(", ")
    ))?;
    Ok(ExitCode::SUCCESS)
}

fn show(args: &KeysShowArgs) -> Result<ExitCode, Failure> {
    let path = configuration(&args.bench, &args.node)?;
    if args.path {
        print(&format!("{}\n", path.display()))?;
    } else {
        print(&std::fs::read_to_string(&path).map_err(|e| Failure::file("read", &path, &e))?)?;
    }
    Ok(ExitCode::SUCCESS)
}
