//! Status texts of a vehicle.

use super::dialect::{MavSeverity, STATUSTEXT_DATA};

/// A status text in one line, and whether it is a warning or worse; `None` for an empty text.
pub(super) fn status_text(message: &STATUSTEXT_DATA) -> Option<(bool, String)> {
    let text = message.text.to_str().ok()?.trim();
    let text: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    let warn = message.severity as u32 <= MavSeverity::MAV_SEVERITY_WARNING as u32;
    (!text.is_empty()).then_some((warn, text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_one_line_and_their_severity_counts() {
        let said = |severity, text: &str| {
            status_text(&STATUSTEXT_DATA { severity, text: text.into(), ..Default::default() })
        };
        let warning = said(MavSeverity::MAV_SEVERITY_CRITICAL, "PreArm: RC not\ncalibrated");
        assert_eq!(warning, Some((true, "PreArm: RC not calibrated".into())));
        assert_eq!(said(MavSeverity::MAV_SEVERITY_INFO, "EKF ready"), Some((false, "EKF ready".into())));
        assert_eq!(said(MavSeverity::MAV_SEVERITY_INFO, " "), None);
    }
}
