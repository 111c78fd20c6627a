//! Data of a diagnosis: records on an even grid, and checks that need no model.

pub mod checks;
pub mod declared_vibration;
pub mod deviations;
#[cfg(test)]
pub mod flown;
mod held_samples;
mod join;
pub mod limits;
pub mod outliers;
pub mod record;
mod rests;
pub mod sample_effect;
pub mod sample_effects;
