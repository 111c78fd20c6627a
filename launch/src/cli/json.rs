//! `--json`, the same for every call that has it.

use std::path::{Path, PathBuf};

use clap::Args;

/// Where JSON goes, if it is asked for.
#[derive(Debug, Clone, Default, Args)]
pub(crate) struct JsonArg {
    /// Write JSON to FILE; without FILE, or with -, print only JSON.
    #[arg(id = "json", long = "json", value_name = "FILE", num_args = 0..=1, default_missing_value = "-")]
    pub path: Option<PathBuf>,
}

impl JsonArg {
    /// Whether standard output is for JSON, and for nothing else.
    pub fn is_printed(&self) -> bool {
        self.path.as_deref() == Some(Path::new("-"))
    }
}
