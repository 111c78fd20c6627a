//! The vehicle model used by law and filter, where it differs from the vehicle that flies.

use std::path::Path;

use whirlstand_nodes::config::VehicleSource;
use whirlstand_vehicle::Vehicle;

use super::document::{LaunchError, at};
use super::plan::Planner;
use super::schema::LaunchFile;

impl Planner<'_> {
    /// Finds the model and checks its signals against those of the vehicle.
    pub(super) fn model(
        &self,
        file: &LaunchFile,
        folder: &Path,
    ) -> Result<Option<VehicleSource>, LaunchError> {
        let Some(name) = &file.model else { return Ok(None) };
        let fail = |message: String| self.document.error_at(at!["model"], message);
        let model = Vehicle::find_from(name, Some(folder)).map_err(|e| fail(e.to_string()))?;
        if let Some(what) = model.signals_differ(self.vehicle) {
            return Err(fail(format!(
                "the {what} of {name} are not those of the vehicle {}; law and filter need the same names in the same order",
                file.vehicle
            )));
        }
        Ok(Some(VehicleSource { origin: name.clone(), text: model.source_text }))
    }
}
