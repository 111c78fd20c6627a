//! Options of the calls that tell the shell and `man` of this command.

use std::path::PathBuf;

use clap::Args;
use clap_complete::Shell;

/// Print shell completions for commands, options and their values.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    whirlstand completions bash > ~/.local/share/bash-completion/completions/whirlstand\n  \
    whirlstand completions zsh > ~/.zfunc/_whirlstand          # with ~/.zfunc in fpath\n  \
    whirlstand completions fish > ~/.config/fish/completions/whirlstand.fish")]
pub(crate) struct CompletionsArgs {
    /// The shell.
    pub shell: Shell,
}

/// Write the manual pages, one for each command.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  \
    whirlstand man ~/.local/share/man/man1 && man whirlstand-run")]
pub(crate) struct ManArgs {
    /// Folder for whirlstand.1, whirlstand-run.1 and so on.
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
}
