//! Hidden effects of a trial, as input of the truth model and the sensors.

use whirlstand_vehicle::Effect;

use super::out_of_library::OutOfLibraryEffect;
use super::turbulence::Spectrum;

/// The effects that act on a vehicle in addition to its model.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hidden<'a> {
    pub effects: &'a [Effect],
    pub outside: Option<&'a OutOfLibraryEffect>,
    /// Whether random parts (turbulence, noise, dropouts, outliers) and rounding are left out.
    pub expected: bool,
    /// Spectrum of the turbulence.
    pub spectrum: Spectrum,
    /// Number of the trial, which selects the random streams.
    pub trial: u64,
}

/// The value of a parameter that every effect of this kind has.
pub(crate) fn value(effect: &Effect, name: &str) -> f64 {
    effect.parameter(name).unwrap_or(0.0)
}
