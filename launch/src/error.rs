//! How a command fails: because of something that the user can correct (exit code 2), or in what was run
//! (exit code 1).

use std::io::ErrorKind;
use std::path::Path;
use std::process::ExitCode;

/// Exit code of a node that would fail in the same way again.
pub(crate) const FINAL: u8 = 3;

/// Why a command failed; the text is a full sentence for the user.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Failure {
    /// A file, an argument or a setting of the machine that the user can correct: exit code 2.
    #[error("{0}")]
    Mend(String),
    /// A node, a run or an expectation failed: exit code 1.
    #[error("{0}")]
    Run(String),
    /// A node failed in a way that would repeat: exit code 3. The node is not restarted.
    #[error("{0}")]
    Final(String),
}

impl Failure {
    /// A failure that the user can correct, described by `error`.
    pub fn mend(error: impl std::fmt::Display) -> Self {
        Self::Mend(error.to_string())
    }

    /// A failure while running, described by `error`.
    pub fn run(error: impl std::fmt::Display) -> Self {
        Self::Run(error.to_string())
    }

    /// A file or folder that cannot be used; `doing` names the purpose, as in "write the report to".
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
