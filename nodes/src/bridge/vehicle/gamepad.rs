//! A gamepad of this computer as the pilot's stick.

use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use gilrs::{Axis, Button, Gamepad, Gilrs};
use whirlstand_bridge::config::{BridgeConfig, PilotSource};

use super::shared_vehicle::{SharedVehicle, lock};
use crate::error::NodeError;

/// Time between two reports without movement: a connected gamepad sends nothing at rest.
const REPORT: Duration = Duration::from_millis(20);

/// Starts the thread that reads a gamepad, when the pilot has one.
///
/// # Errors
/// The system has no gamepads.
pub(super) fn listen(bridge: &BridgeConfig, shared: Arc<Mutex<SharedVehicle>>) -> Result<(), NodeError> {
    let Some(pilot) = bridge.options.pilot.as_ref().filter(|p| p.source == PilotSource::Gamepad) else {
        return Ok(());
    };
    let wanted = pilot.link.clone().unwrap_or_default();
    let system = |reason: String| NodeError::System {
        action: "listen to gamepads",
        source: std::io::Error::other(reason),
    };
    // The library's handle stays on the thread that created it.
    let (ready, opened) = sync_channel(1);
    std::thread::Builder::new()
        .name("gamepad".into())
        .spawn(move || match Gilrs::new() {
            Ok(gamepads) => {
                // Nobody waits any more when the starting thread has failed.
                let _ = ready.send(None);
                follow(gamepads, &wanted, &shared);
            }
            Err(e) => {
                let _ = ready.send(Some(e.to_string()));
            }
        })
        .map_err(|e| system(e.to_string()))?;
    match opened.recv() {
        Ok(None) => Ok(()),
        Ok(Some(reason)) => Err(system(reason)),
        Err(e) => Err(system(e.to_string())),
    }
}

/// Reports the sticks for as long as the process lives. A disconnected gamepad is silent, and the pilot
/// counts as lost.
fn follow(mut gamepads: Gilrs, wanted: &str, shared: &Mutex<SharedVehicle>) {
    let mut known = None;
    loop {
        while gamepads.next_event_blocking(Some(REPORT)).is_some() {}
        let Some((_, gamepad)) = gamepads.gamepads().find(|(_, g)| g.name().contains(wanted)) else {
            continue;
        };
        if known.as_deref() != Some(gamepad.name()) {
            tracing::info!("the pilot's stick is the gamepad \"{}\"", gamepad.name());
            known = Some(gamepad.name().to_string());
        }
        let us = channels(&gamepad);
        let mut shared = lock(shared);
        let now = shared.now();
        shared.vehicle.stick(&us, now);
    }
}

/// Right stick: roll and pitch (back is nose up); left stick: throttle and yaw; shoulder buttons are held switches on
/// channels 5 (right: arm) and 6 (left: automatic).
fn channels(gamepad: &Gamepad<'_>) -> [f64; 6] {
    let axis = |axis| 1500.0 + 500.0 * f64::from(gamepad.value(axis));
    let switch = |button| if gamepad.is_pressed(button) { 2000.0 } else { 1000.0 };
    [
        axis(Axis::RightStickX),
        3000.0 - axis(Axis::RightStickY),
        axis(Axis::LeftStickY),
        axis(Axis::LeftStickX),
        switch(Button::RightTrigger),
        switch(Button::LeftTrigger),
    ]
}
