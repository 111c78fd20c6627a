//! Opens sessions of Zenoh. Its futures are compiled where they are awaited, half a megabyte for those of opening: so
//! in one place.

use zenoh::Wait;

/// Why a session did not open.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// Zenoh does not accept the settings.
    #[error("{0}")]
    Settings(String),
    /// A listener, a link or the runtime failed.
    #[error("{0}")]
    Open(String),
}

/// Opens a session of Zenoh with settings in its own format ([`crate::zenoh_configuration`]).
///
/// # Errors
/// [`SessionError`] with Zenoh's reason.
pub fn open_session(settings: &serde_json::Value) -> Result<zenoh::Session, SessionError> {
    let config = zenoh::Config::from_json5(&settings.to_string())
        .map_err(|e| SessionError::Settings(e.to_string()))?;
    zenoh::open(config).wait().map_err(|e| SessionError::Open(e.to_string()))
}
