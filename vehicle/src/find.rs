//! Finds vehicles by name or path.

use std::path::Path;

use crate::error::VehicleError;
use crate::model::Vehicle;

impl Vehicle {
    /// Reads a vehicle file.
    ///
    /// # Errors
    /// When the file cannot be read or is not a valid vehicle file; the message names line, field and reason.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, VehicleError> {
        let path = path.as_ref();
        let text = std::fs::read_to_string(path)
            .map_err(|source| VehicleError::Read { file: path.into(), source })?;
        Ok(Self::parse(&text, &path.display().to_string())?)
    }

    /// A vehicle by built-in name, or by path (any text that ends in `.toml` or contains a path separator).
    ///
    /// # Errors
    /// As [`Vehicle::load`]; [`VehicleError::Unknown`] for a name that is not built in and no file.
    pub fn find(name_or_path: &str) -> Result<Self, VehicleError> {
        Self::find_from(name_or_path, None)
    }

    /// A vehicle as by [`Vehicle::find`], with relative paths resolved against `folder`.
    ///
    /// # Errors
    /// As [`Vehicle::find`].
    pub fn find_from(name_or_path: &str, folder: Option<&Path>) -> Result<Self, VehicleError> {
        let path = folder.unwrap_or(Path::new("")).join(name_or_path);
        let is_path = name_or_path.ends_with(".toml") || name_or_path.contains(std::path::MAIN_SEPARATOR);
        if is_path || path.is_file() && crate::builtin::text(name_or_path).is_none() {
            return Self::load(path);
        }
        Self::builtin(name_or_path)
    }
}
