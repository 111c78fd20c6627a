//! Output rate that a line can carry: further outputs would wait in the driver, with a failsafe behind them.

use std::time::Duration;

use crate::config::{BridgeConfig, BridgeKind, ConfigError, Output};
use crate::line::{COMMON_SHARE, serial_line};

/// Share of a dedicated line for outputs.
const OWN_SHARE: f64 = 0.9;

/// Length of a signature in bytes.
const SIGNATURE: u32 = 13;

/// Largest length of an output in bytes. For MAVLink: 12 of the frame, and the fields.
fn bytes(output: Output, signed: bool) -> u32 {
    let signature = if signed { SIGNATURE } else { 0 };
    match output {
        Output::RcOverride => 12 + 38 + signature,
        Output::ManualControl => 12 + 30 + signature,
        Output::AttitudeTarget => 12 + 51 + signature,
        Output::Crsf => 26,
        Output::Sbus => 25,
    }
}

/// The shortest time between two outputs that the line allows, with a note; none for a line that allows the
/// loop's rate.
///
/// # Errors
/// The launch file asks for more outputs than the line carries.
pub(super) fn budget(
    config: &BridgeConfig,
    output: Output,
    asked_hz: Option<f64>,
    rate_hz: f64,
) -> Result<Option<(Duration, String)>, ConfigError> {
    let options = &config.options;
    let mavlink = options.mavlink.as_ref().filter(|_| config.kind == BridgeKind::Mavlink);
    let (link, share) = match (mavlink, &options.crsf) {
        (Some(own), _) => match &own.output_link {
            Some(line) => (line, OWN_SHARE),
            None => (&own.link, COMMON_SHARE),
        },
        (None, Some(own)) => (&own.link, OWN_SHARE),
        (None, None) => return Ok(None),
    };
    let Some((baud, bits)) = serial_line(link) else { return Ok(None) };
    let bytes = bytes(output, mavlink.is_some_and(|m| m.signing_key.is_some()));
    let most_hz = share * baud / (bits * f64::from(bytes));
    let wanted_hz = asked_hz.unwrap_or(rate_hz);
    if wanted_hz <= most_hz {
        return Ok(None);
    }
    let text = format!(
        "{wanted_hz:.0} outputs of {bytes} bytes a second are more than {link} carries, at most {most_hz:.0}"
    );
    if asked_hz.is_some() {
        return Err(ConfigError::new(&[config.kind.name(), "output_rate_hz"], text));
    }
    Ok(Some((
        Duration::from_secs_f64(1.0 / most_hz),
        format!("{text}: the newest are sent, the others left out"),
    )))
}
