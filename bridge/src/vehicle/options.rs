//! Errors of invalid options of a bridge to a vehicle.

use crate::arming::ArmBy;
use crate::config::{BridgeConfig, BridgeKind, ConfigError, MavlinkConfig, Output, SafetyConfig};

/// The table of the bridge is missing.
pub(super) fn missing(kind: BridgeKind) -> ConfigError {
    let message = format!("the table [bridge.{kind}] with the key 'link' is missing: add it");
    ConfigError::new(&[kind.name()], message)
}

pub(super) fn check_safety(safety: &SafetyConfig, config: &BridgeConfig) -> Result<(), ConfigError> {
    let fail = |key: &str, message: &str| Err(ConfigError::new(&["safety", key], message));
    for (key, value) in [
        ("stale_s", Some(safety.stale_s)),
        ("command_timeout_s", Some(safety.command_timeout_s)),
        ("link_timeout_s", Some(safety.link_timeout_s)),
        ("recover_after_s", safety.recover_after_s),
    ] {
        if value.is_some_and(|v| !(v > 0.0 && v <= 60.0)) {
            return fail(key, "a time above 0 and up to 60 s is expected");
        }
    }
    if safety.max_innovation.is_nan() || safety.max_innovation <= 1.0 {
        return fail("max_innovation", "a number above 1 is expected: 1 is what a filter predicts");
    }
    match safety.arm {
        ArmBy::Switch if config.options.pilot.is_none() => fail(
            "arm",
            "arm = \"switch\" needs the pilot's stick: add [bridge.pilot], or say arm = \"autopilot\" or \"start\"",
        ),
        ArmBy::Autopilot if config.kind != BridgeKind::Mavlink => fail(
            "arm",
            "only a MAVLink autopilot tells whether it is armed: say arm = \"switch\" or \"start\"",
        ),
        ArmBy::Switch | ArmBy::Autopilot if safety.recover_after_s.is_some() => {
            fail("recover_after_s", "only with arm = \"start\": else whoever arms decides")
        }
        _ => Ok(()),
    }
}

pub(super) fn check_mavlink(config: &MavlinkConfig) -> Result<(), ConfigError> {
    let fail = |key: &str, message: &str| Err(ConfigError::new(&["mavlink", key], message));
    let own_line = matches!(config.output, Output::Crsf | Output::Sbus);
    if own_line && config.output_link.is_none() {
        return fail("output_link", "the channels need a serial port: add the key 'output_link'");
    }
    if !own_line && config.output_link.is_some() {
        return fail("output_link", "only output = \"crsf\" and \"sbus\" have a line of their own");
    }
    if config.message_rate_hz.is_some_and(|hz| !(0.0..=4000.0).contains(&hz)) {
        return fail("message_rate_hz", "a rate from 0 to 4000 Hz is expected");
    }
    if config.system == 0 || config.component == 0 {
        return fail("system", "numbers from 1 on are expected: 0 means all");
    }
    if config.heading.is_some_and(|h| !h.is_finite()) {
        return fail("heading", "a finite angle in rad is expected");
    }
    if !(config.attitude_target.full.is_finite() && config.attitude_target.full_yaw_rate.is_finite()) {
        return fail("attitude_target", "finite numbers are expected");
    }
    Ok(())
}
