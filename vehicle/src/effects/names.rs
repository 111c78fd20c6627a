//! Names of effects, and their entries in the table.

use whirlstand_msgs::names::did_you_mean;

use super::kind::Kind;
use super::table::{SPECS, Spec};
use crate::error::{EffectError, list};

impl Kind {
    /// The effect's row of the table.
    pub fn spec(self) -> &'static Spec {
        &SPECS[self as usize]
    }

    /// Name in files, for example `input_delay`.
    pub fn name(self) -> &'static str {
        self.spec().name
    }

    /// All effects.
    pub fn all() -> impl Iterator<Item = Self> {
        SPECS.iter().map(|s| s.kind)
    }

    /// The effect with the given name.
    ///
    /// # Errors
    /// For an unknown name; the message suggests the nearest.
    pub fn from_name(name: &str) -> Result<Self, EffectError> {
        SPECS.iter().find(|s| s.name == name).map(|s| s.kind).ok_or_else(|| EffectError {
            effect: name.into(),
            place: String::new(),
            field: Some("effect".into()),
            reason: format!(
                "there is no effect '{name}'{}; effects are {}",
                did_you_mean(name, SPECS.iter().map(|s| s.name)),
                list(SPECS.iter().map(|s| s.name)),
            ),
        })
    }
}

impl std::fmt::Display for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}
