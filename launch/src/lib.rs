//! The command line, the supervisor and the launch files.

use std::process::ExitCode;

/// Runs the `whirlstand` command.
pub fn main() -> ExitCode {
    ExitCode::SUCCESS
}
