//! External requirements of a bridge: a key, a gamepad.

use whirlstand_bridge::mavlink::Key;

use crate::error::NodeError;

/// Reads the secret of a signed link.
///
/// # Errors
/// The file cannot be read, or is empty.
pub(super) fn read_key(path: &str) -> Result<Key, NodeError> {
    let fail = |reason: String| NodeError::Config {
        field: "bridge.mavlink.signing_key".into(),
        value: path.into(),
        reason,
    };
    let text = std::fs::read_to_string(path).map_err(|e| fail(format!("the file cannot be read: {e}")))?;
    let text = text.trim();
    if text.is_empty() {
        return Err(fail("the file is empty: 64 hexadecimal digits or a passphrase are expected".into()));
    }
    Ok(Key::from_text(text))
}

/// Refuses a pilot with a gamepad in a build without gamepad support.
///
/// # Errors
/// The pilot's stick is a gamepad.
#[cfg(not(feature = "gamepad"))]
pub(super) fn refuse_gamepad(bridge: &whirlstand_bridge::config::BridgeConfig) -> Result<(), NodeError> {
    use whirlstand_bridge::config::PilotSource;
    match &bridge.options.pilot {
        Some(pilot) if pilot.source == PilotSource::Gamepad => Err(NodeError::Config {
            field: "bridge.pilot.source".into(),
            value: "gamepad".into(),
            reason: "this program was built without gamepads: install libudev-dev and build it with \
                     --features gamepad"
                .into(),
        }),
        _ => Ok(()),
    }
}
