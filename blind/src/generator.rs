//! The two generators of trials, which differ only in their ranges.

use serde::{Deserialize, Serialize};

use super::ranges::Ranges;
use super::reference::REFERENCE;
use super::shifted::SHIFTED;

/// Selects the ranges from which a trial is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Generator {
    /// The ranges against which the diagnosis was developed.
    #[default]
    Reference,
    /// Different noise, vehicles, excitation, sizes and effects outside the table: a diagnosis that was
    /// fitted to the reference ranges has no advantage here.
    Shifted,
}

impl Generator {
    /// Name of the generator on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Reference => "reference",
            Self::Shifted => "shifted",
        }
    }

    /// The ranges of the generator.
    pub(crate) fn ranges(self) -> &'static Ranges {
        match self {
            Self::Reference => &REFERENCE,
            Self::Shifted => &SHIFTED,
        }
    }
}
