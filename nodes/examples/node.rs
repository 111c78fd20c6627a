//! One node of a bench as a process: `node ROLE < config.json`.
//!
//! This is what `whirlstand node ROLE --config -` does, without the command line around it.

use std::io::Read;
use std::process::ExitCode;

use whirlstand_nodes::config::{NodeConfig, Role};

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("{e}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), Box<dyn std::error::Error>> {
    let name =
        std::env::args().nth(1).ok_or("a role is expected: plant, estimator, controller or recorder")?;
    let role = Role::ALL.into_iter().find(|r| r.name() == name).ok_or("there is no such role")?;
    let mut text = String::new();
    std::io::stdin().read_to_string(&mut text)?;
    let config: NodeConfig = serde_json::from_str(&text)?;
    Ok(whirlstand_nodes::run_node(role, &config)?)
}
