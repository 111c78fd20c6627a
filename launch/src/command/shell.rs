//! `whirlstand completions` and `whirlstand man`.

use std::process::ExitCode;

use clap::CommandFactory;

use super::print_data;
use crate::cli::{Cli, CompletionsArgs, ManArgs};
use crate::error::Failure;

/// Prints the completions of a shell.
pub(crate) fn completions(args: &CompletionsArgs) -> Result<ExitCode, Failure> {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "whirlstand", &mut text);
    print_data(&String::from_utf8_lossy(&text))?;
    Ok(ExitCode::SUCCESS)
}

/// Writes the manual pages.
pub(crate) fn man(args: &ManArgs) -> Result<ExitCode, Failure> {
    let folder = &args.folder;
    std::fs::create_dir_all(folder).map_err(|e| Failure::file("make the folder", folder, &e))?;
    clap_mangen::generate_to(Cli::command(), folder)
        .map_err(|e| Failure::file("write manual pages into", folder, &e))?;
    Ok(ExitCode::SUCCESS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_call_has_its_page() {
        let folder = tempfile::tempdir().unwrap();
        man(&ManArgs { folder: folder.path().join("man1") }).unwrap();
        for page in ["whirlstand.1", "whirlstand-run.1", "whirlstand-vehicle-new.1", "whirlstand-set.1"] {
            let text = std::fs::read_to_string(folder.path().join("man1").join(page)).unwrap();
            assert!(text.contains(".SH SYNOPSIS"), "{page}");
        }
        assert!(!folder.path().join("man1/whirlstand-guard.1").exists(), "hidden calls have none");
    }
}
