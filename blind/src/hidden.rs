//! What acts on a vehicle beside its model, as the truth model and the sensors take it.

use whirlstand_vehicle::Effect;

use super::out_of_library::OutOfLibraryEffect;
use super::turbulence::Spectrum;

/// What acts on a vehicle beside its model.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hidden<'a> {
    pub effects: &'a [Effect],
    pub outside: Option<&'a OutOfLibraryEffect>,
    /// Leave out what is random: turbulence, noise, dropouts, outliers, rounding.
    pub expected: bool,
    /// Spectrum of turbulence.
    pub spectrum: Spectrum,
    /// Trial whose random streams are used.
    pub trial: u64,
}

/// A parameter that the table guarantees.
pub(crate) fn value(effect: &Effect, name: &str) -> f64 {
    effect.parameter(name).unwrap_or(0.0)
}
