//! The commands that do not start a bench.

pub(crate) mod adjust;
pub(crate) mod bench;
mod bench_mirror;
mod bench_tune;
pub(crate) mod blind;
pub(crate) mod bridge;
pub(crate) mod clean;
pub(crate) mod compare;
pub(crate) mod design;
pub(crate) mod diagnose;
mod early_end;
pub(crate) mod echo;
pub(crate) mod excite;
pub(crate) mod guard;
pub(crate) mod identify;
mod json_text;
pub(crate) mod keys;
pub(crate) mod launch_files;
pub(crate) mod log;
pub(crate) mod node;
pub(crate) mod relay;
pub(crate) mod shell;
pub(crate) mod simulate;
pub(crate) mod stage_line;
pub(crate) mod vehicle_fmu;
pub(crate) mod vehicle_new;
pub(crate) mod vehicles;
pub(crate) mod watch;

use std::io::{IsTerminal, Write};
use std::path::Path;

use crate::cli::JsonArg;
use crate::error::Failure;

/// Exit code of a command that was interrupted and reported its results so far, as in shells.
pub(crate) const INTERRUPTED: u8 = 130;

/// Exit code of a command whose budget of time was spent and that reported its results so far.
pub(crate) const PARTIAL: u8 = 3;

/// Prints text on standard output, with escapes if that is a terminal. A reader that has closed the pipe
/// (`| head`) is no failure.
pub(crate) fn print(text: &str) -> Result<(), Failure> {
    write_out(&crate::style::rendered(text))
}

/// Prints text of others or for programs, such as a file or JSON: unchanged, but escaped on a terminal.
pub(crate) fn print_data(text: &str) -> Result<(), Failure> {
    write_out(&crate::style::data(text, std::io::stdout().is_terminal()))
}

fn write_out(text: &str) -> Result<(), Failure> {
    let mut out = anstream::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(Failure::Run(format!("cannot write to standard output: {e}")))
        }
        _ => Ok(()),
    }
}

/// Prints a value as JSON.
pub(crate) fn print_json(value: &impl serde::Serialize) -> Result<(), Failure> {
    let text = json_text::pretty(value).map_err(Failure::run)?;
    print_data(&(text + "\n"))
}

/// Writes a value as JSON to a file, or to standard output for `-`.
pub(crate) fn write_json(value: &impl serde::Serialize, path: &Path) -> Result<(), Failure> {
    if path == Path::new("-") {
        return print_json(value);
    }
    let text = json_text::pretty(value).map_err(Failure::run)?;
    write(path, &(text + "\n"))
}

/// Writes a value as JSON where that is requested. Prints the text unless only JSON is to be printed.
pub(crate) fn tell(
    json: &JsonArg,
    value: &impl serde::Serialize,
    text: impl FnOnce() -> String,
) -> Result<(), Failure> {
    if let Some(path) = &json.path {
        write_json(value, path)?;
    }
    if json.is_printed() { Ok(()) } else { print(&text()) }
}

/// Writes a text file, and creates its folder.
pub(crate) fn write(path: &Path, text: &str) -> Result<(), Failure> {
    if let Some(folder) = path.parent().filter(|f| !f.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).map_err(|e| Failure::file("make the folder", folder, &e))?;
    }
    std::fs::write(path, text).map_err(|e| Failure::file("write", path, &e))
}
