//! `whirlstand guard`: after the death of a launcher, ends its nodes and removes its files. The launcher
//! starts it.

use std::process::ExitCode;
use std::time::Duration;

use crate::cli::GuardArgs;
use crate::error::Failure;
use crate::supervisor::keep_guard;

/// Waits for the launcher's end, and does nothing if the launcher ended in order.
pub(crate) fn guard(args: &GuardArgs) -> Result<ExitCode, Failure> {
    let Some(left) = keep_guard(std::io::stdin().lock()) else { return Ok(ExitCode::SUCCESS) };
    crate::style::say(&format!("the launcher of the bench {} was killed: ending its nodes", args.bench));
    left.end(args.sockets.as_deref(), Duration::from_secs_f64(args.grace.max(0.0)));
    whirlstand_bus::remove_residue(&args.bench).map_err(Failure::run)?;
    for path in &args.remove {
        let removed = if path.is_dir() { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) };
        if let Err(e) = removed
            && e.kind() != std::io::ErrorKind::NotFound
        {
            return Err(Failure::file("remove", path, &e));
        }
    }
    Ok(ExitCode::SUCCESS)
}
