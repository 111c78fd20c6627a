//! Check stage: findings on single samples and on the inputs that need no model.

use super::load::Loaded;
use crate::answer::DataFinding;
use crate::data::checks;
use crate::data::record::Data;
use crate::data::sample_effect::SampleEffect;
use crate::data::sample_effects::measured_effects;

/// Records with their bad samples excluded.
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

    /// True when no cause can be searched for.
    pub fn is_blocked(&self) -> bool {
        self.found.iter().any(|f| f.blocking)
    }
}
