//! Hidden effects of a trial, as input of the truth model and the sensors.

use whirlstand_vehicle::Effect;

use super::out_of_library::OutOfLibraryEffect;
use super::turbulence::Spectrum;

/// The effects that act on a vehicle in addition to its model.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hidden<'a> {
    pub effects: &'a [Effect],
    pub outside: Option<&'a OutOfLibraryEffect>,
    /// Whether random parts are left out: turbulence, noise, dropouts, outliers, rounding.
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
