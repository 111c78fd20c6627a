//! Contents of the archive besides description and library, and the token that ties its parts together.

use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use whirlstand_vehicle::Vehicle;

/// The vehicle file, within the folder of resources.
pub(crate) const VEHICLE_FILE: &str = "vehicle.toml";

/// The settings, within the folder of resources.
pub(crate) const SETTINGS_FILE: &str = "settings.toml";

/// Settings of the simulation in the FMU.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Period of the simulator, s.
    pub period_s: f64,
    /// Seed of the random numbers, unless the tool sets another.
    pub seed: u64,
}

/// The reason why the folder of resources cannot be used; each sentence names the file.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ContentsError {
    #[error("{file} of the FMU cannot be read: {reason}; export the FMU again")]
    Read { file: &'static str, reason: String },
    #[error(
        "the description of this FMU belongs to another vehicle file or version of Whirlstand than its resources: the \
         instantiation token is {given}, {expected} is expected; export the FMU again"
    )]
    Token { given: String, expected: String },
}

/// The token from which a library recognises that the description was made with these resources and for this
/// version.
pub(crate) fn token(vehicle_text: &str, settings_text: &str) -> String {
    let mut hash = Sha256::new();
    for part in [env!("CARGO_PKG_VERSION"), settings_text, vehicle_text] {
        hash.update((part.len() as u64).to_le_bytes());
        hash.update(part);
    }
    hash.finalize().iter().take(16).map(|byte| format!("{byte:02x}")).collect()
}

/// Reads the folder of resources.
pub(crate) fn read(resources: &Path, given_token: &str) -> Result<(Vehicle, Settings), ContentsError> {
    let text = |file: &'static str| {
        std::fs::read_to_string(resources.join(file))
            .map_err(|e| ContentsError::Read { file, reason: e.to_string() })
    };
    let (vehicle_text, settings_text) = (text(VEHICLE_FILE)?, text(SETTINGS_FILE)?);
    let expected = token(&vehicle_text, &settings_text);
    if given_token != expected {
        return Err(ContentsError::Token { given: given_token.into(), expected });
    }
    let settings = toml::from_str(&settings_text)
        .map_err(|e| ContentsError::Read { file: SETTINGS_FILE, reason: e.to_string() })?;
    let vehicle = Vehicle::load(resources.join(VEHICLE_FILE))
        .map_err(|e| ContentsError::Read { file: VEHICLE_FILE, reason: e.to_string() })?;
    Ok((vehicle, settings))
}
