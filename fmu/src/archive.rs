//! Writes the archive: description, library, the vehicle file, and the files of its mode transitions.

use std::collections::BTreeMap;
use std::io::{Seek, Write};
use std::path::{Component, Path};

use whirlstand_vehicle::{Kind, Vehicle, VehicleError};
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use crate::contents::{SETTINGS_FILE, Settings, VEHICLE_FILE, token};
use crate::description::{STATE_PREFIX, description, model_identifier};
use crate::instance::Instance;
use crate::library::{PLATFORM, SUFFIX};

/// The reason why a vehicle cannot be exported.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The vehicle was made in memory, so there is no file to pack.
    #[error("{0}: this vehicle was not read from a file, and an FMU contains the file")]
    NoText(String),
    /// Two variables of the FMU would have the same name.
    #[error(
        "{vehicle}: {first} and {second} have the same name '{name}', and variables of an FMU need names of their own: \
         rename one of them"
    )]
    SameName {
        /// Name of the vehicle.
        vehicle: String,
        /// The duplicate name.
        name: String,
        /// The first variable of that name.
        first: &'static str,
        /// The second variable of that name.
        second: &'static str,
    },
    /// A mode transition leads to a file that cannot be packed beside the vehicle file.
    #[error(
        "{vehicle}: the mode transition to '{to}' leads out of the vehicle file's folder, and within an FMU there is nothing \
         else: put the file beside the vehicle file, or below it"
    )]
    Outside {
        /// Name of the vehicle.
        vehicle: String,
        /// The path.
        to: String,
    },
    /// The file of a mode transition cannot be read.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
    /// The vehicle cannot be simulated with this period.
    #[error("{vehicle}: {reason}")]
    Simulate {
        /// Name of the vehicle.
        vehicle: String,
        /// Why.
        reason: String,
    },
    /// The archive cannot be written.
    #[error("cannot write the FMU: {0}")]
    Write(#[from] zip::result::ZipError),
    /// The settings cannot be written as TOML, because the period or the seed is not a number that TOML
    /// represents.
    #[error("cannot write the settings into the FMU: {0}")]
    Settings(#[from] toml::ser::Error),
}

/// Writes the FMU of a vehicle with this `library`, the result of [`find_library`](crate::find_library).
///
/// # Errors
/// [`ExportError`] when the vehicle cannot become an FMU, or writing to `out` fails.
pub fn write_archive(
    vehicle: &Vehicle,
    settings: Settings,
    library: &[u8],
    out: impl Write + Seek,
) -> Result<(), ExportError> {
    if vehicle.source_text.is_empty() {
        return Err(ExportError::NoText(vehicle.name.clone()));
    }
    check_names(vehicle)?;
    Instance::new(vehicle.clone(), settings)
        .map_err(|e| ExportError::Simulate { vehicle: vehicle.name.clone(), reason: e.to_string() })?;
    let settings_text = toml::to_string(&settings)?;
    let token = token(&vehicle.source_text, &settings_text);
    let identifier = model_identifier(vehicle);
    let mut files = BTreeMap::from([
        ("modelDescription.xml".to_string(), description(vehicle, settings, &token).into_bytes()),
        (format!("binaries/{PLATFORM}/{identifier}{SUFFIX}"), library.to_vec()),
        (format!("resources/{VEHICLE_FILE}"), vehicle.source_text.clone().into_bytes()),
        (format!("resources/{SETTINGS_FILE}"), settings_text.into_bytes()),
    ]);
    add_successors(vehicle, Path::new(""), &mut files)?;
    let mut archive = ZipWriter::new(out);
    for (name, bytes) in files {
        // Without a modification time the same vehicle gives the same archive.
        archive.start_file(name, SimpleFileOptions::default())?;
        archive.write_all(&bytes).map_err(zip::result::ZipError::from)?;
    }
    archive.finish()?;
    Ok(())
}

fn check_names(vehicle: &Vehicle) -> Result<(), ExportError> {
    let inputs = vehicle.inputs.iter().map(|u| ("an input", u.name.clone()));
    let outputs = vehicle.outputs.iter().map(|y| ("an output", y.name.clone()));
    let states = vehicle.states.iter().map(|x| ("a state", format!("{STATE_PREFIX}{}", x.name)));
    let own = ["time", "seed", "noise"].map(|name| ("a variable of every FMU", name.to_string()));
    let mut seen = BTreeMap::new();
    for (what, name) in own.into_iter().chain(inputs).chain(outputs).chain(states) {
        if let Some(first) = seen.insert(name.clone(), what) {
            return Err(ExportError::SameName { vehicle: vehicle.name.clone(), name, first, second: what });
        }
    }
    Ok(())
}

/// Adds the vehicle files of mode transitions, under their paths relative to the vehicle file.
fn add_successors(
    vehicle: &Vehicle,
    folder: &Path,
    files: &mut BTreeMap<String, Vec<u8>>,
) -> Result<(), ExportError> {
    for effect in vehicle.effects.iter().filter(|e| e.kind() == Kind::ModeTransition) {
        let to = effect.text().unwrap_or_default();
        let next = Vehicle::find_from(to, vehicle.folder.as_deref())?;
        if next.folder.is_none() && Vehicle::builtin(to).is_ok() {
            continue;
        }
        let path = folder.join(to);
        let mut components = path.components();
        if !components.all(|c| matches!(c, Component::Normal(_) | Component::CurDir)) {
            return Err(ExportError::Outside { vehicle: vehicle.name.clone(), to: to.into() });
        }
        let parts: Vec<_> = path.components().filter(|c| *c != Component::CurDir).collect();
        let parts: Vec<_> = parts.iter().map(|c| c.as_os_str().to_string_lossy()).collect();
        if files
            .insert(format!("resources/{}", parts.join("/")), next.source_text.clone().into_bytes())
            .is_none()
        {
            add_successors(&next, path.parent().unwrap_or(Path::new("")), files)?;
        }
    }
    Ok(())
}
