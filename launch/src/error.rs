//! How a command fails: by what the user can mend (exit 2), or by what was run (exit 1).

use std::io::ErrorKind;
use std::path::Path;
use std::process::ExitCode;

/// Exit code of a node that would fail again in the same way.
pub(crate) const FINAL: u8 = 3;

/// Why a command did not succeed; the text is a full sentence for the user.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Failure {
    /// A file, an argument or a setting of the machine that the user can mend: exit code 2.
    #[error("{0}")]
    Mend(String),
    /// A node, a run or an expectation failed: exit code 1.
    #[error("{0}")]
    Run(String),
    /// A node ended as it would end again: exit code 3, upon which it is not started anew.
    #[error("{0}")]
    Final(String),
}

impl Failure {
    /// What the user can mend, told by `error`.
    pub fn mend(error: impl std::fmt::Display) -> Self {
        Self::Mend(error.to_string())
    }

    /// What went wrong while running, told by `error`.
    pub fn run(error: impl std::fmt::Display) -> Self {
        Self::Run(error.to_string())
    }

    /// A file or folder that cannot be used; `doing` says for what, as in "write the report to".
    pub fn file(doing: &str, path: &Path, error: &std::io::Error) -> Self {
        let advice = match error.kind() {
            ErrorKind::StorageFull => {
                ": the disk is full; free some space, or choose another folder with --out"
            }
            ErrorKind::QuotaExceeded => {
                ": your disk quota is used up; free some space, or choose another folder"
            }
            _ => "",
        };
        Self::Mend(format!("cannot {doing} {}: {error}{advice}", path.display()))
    }

    /// The exit code for the shell.
    pub fn exit_code(&self) -> ExitCode {
        match self {
            Self::Mend(_) => ExitCode::from(2),
            Self::Run(_) => ExitCode::from(1),
            Self::Final(_) => ExitCode::from(FINAL),
        }
    }
}
