//! Check: what single samples and the inputs show, whatever the model.

use super::load::Loaded;
use crate::answer::DataFinding;
use crate::data::checks;
use crate::data::record::Data;
use crate::data::sample_effects::{SampleEffect, measured_effects};

/// Records whose bad samples are set aside.
#[derive(Debug, Clone)]
pub(crate) struct Checked<'a> {
    pub loaded: &'a Loaded<'a>,
    pub data: Data,
    pub found: Vec<DataFinding>,
    /// Rounding, clipping and held samples.
    pub samples: Vec<SampleEffect>,
}

impl<'a> Checked<'a> {
    pub fn new(loaded: &'a Loaded<'a>) -> Self {
        let (vehicle, mut data) = (loaded.vehicle, loaded.data.clone());
        let mut found = loaded.found.clone();
        found.extend(checks::stuck(&mut data, vehicle));
        found.extend(checks::excitation(&data, vehicle));
        let samples = measured_effects(&mut data, vehicle);
        Self { loaded, data, found, samples }
    }

    /// True when no cause can be looked for.
    pub fn is_blocked(&self) -> bool {
        self.found.iter().any(|f| f.blocking)
    }
}
