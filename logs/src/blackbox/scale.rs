//! Units of the fields, and the scales that convert stored numbers to them.
//!
//! After Betaflight's `blackbox.c`. Fields that are not listed, such as motor outputs, stick commands and the
//! terms of the controller, are the firmware's own numbers.

use super::header::Header;

/// First major version of Betaflight whose battery fields are in hundredths of a volt and of an ampere.
const MODERN: u32 = 4;

/// Factor and unit of a field; no unit for the firmware's own numbers.
pub(super) fn scale(header: &Header, name: &str) -> (f64, Option<&'static str>) {
    let (field, index) = match name.split_once('[') {
        Some((field, index)) => (field, index.trim_end_matches(']')),
        None => (name, ""),
    };
    // Fields that a setting of the logger multiplies by ten.
    let fine = if header.number("blackbox_high_resolution") == Some(1.0) { 0.1 } else { 1.0 };
    match field {
        "gyroADC" | "gyroUnfilt" => match gyro(header) {
            Some((factor, unit)) => (factor * fine, Some(unit)),
            None => (fine, None),
        },
        "setpoint" if index != "3" => (fine, Some("deg/s")),
        "rcCommand" => (fine, None),
        "accSmooth" => match header.number("acc_1G") {
            Some(one) if one > 0.0 => (one.recip(), Some("g")),
            _ => (1.0, None),
        },
        "vbatLatest" if is_modern(header) => (0.01, Some("V")),
        "amperageLatest" if is_modern(header) => (0.01, Some("A")),
        "BaroAlt" => (1.0, Some("cm")),
        "GPS_coord" => (1e-7, Some("deg")),
        "GPS_speed" => (1.0, Some("cm/s")),
        "GPS_ground_course" => (0.1, Some("deg")),
        _ => (1.0, None),
    }
}

/// Scale and unit of the gyroscope. The header stores the scale as the bits of a 32-bit float.
fn gyro(header: &Header) -> Option<(f64, &'static str)> {
    let text = header.line("gyro_scale").or(header.line("gyro.scale"))?.trim();
    let bits = match text.strip_prefix("0x") {
        Some(digits) => u32::from_str_radix(digits, 16).ok()?,
        None => text.parse().ok()?,
    };
    let scale = f64::from(f32::from_bits(bits));
    let known = scale.is_finite() && scale > 0.0;
    known.then(|| match header.line("Firmware type") {
        // The scale is in radians per microsecond.
        Some("Baseflight") => (scale * 1e6, "rad/s"),
        _ => (scale, "deg/s"),
    })
}

/// Whether the Betaflight version defines the units of its battery fields.
fn is_modern(header: &Header) -> bool {
    let version = || {
        header.line("Firmware revision")?.strip_prefix("Betaflight ")?.split('.').next()?.parse::<u32>().ok()
    };
    version().is_some_and(|major| major >= MODERN)
}
