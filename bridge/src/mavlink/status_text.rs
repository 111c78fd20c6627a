//! Status texts of a vehicle.

use super::dialect::{MavSeverity, STATUSTEXT_DATA};

/// Bytes of a text in one message; a longer text comes in several, of which only the last is shorter.
const CHUNK: usize = 50;

/// Puts texts together from their messages.
#[derive(Debug, Clone, Default)]
pub(super) struct StatusTexts {
    /// Number of a text that is not complete yet, 0 for none, and the part that has arrived.
    id: u16,
    part: String,
    /// Number of the message that continues it.
    next: u8,
}

impl StatusTexts {
    /// Takes a message; returns the text that it completes, in one line, and whether it is a warning or worse.
    pub(super) fn take(&mut self, message: &STATUSTEXT_DATA) -> Option<(bool, String)> {
        let chunk = message.text.to_str().ok()?;
        if message.id != self.id || message.chunk_seq != self.next || message.chunk_seq == 0 {
            self.part.clear();
        }
        self.next = message.chunk_seq.wrapping_add(1);
        self.part.push_str(chunk);
        self.id = message.id;
        if message.id != 0 && chunk.len() == CHUNK {
            return None;
        }
        self.id = 0;
        let text = std::mem::take(&mut self.part);
        let text: String = text.trim().chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
        let warn = message.severity as u32 <= MavSeverity::MAV_SEVERITY_WARNING as u32;
        (!text.is_empty()).then_some((warn, text))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(
        texts: &mut StatusTexts,
        severity: MavSeverity,
        text: &str,
        id: u16,
        chunk_seq: u8,
    ) -> Option<(bool, String)> {
        texts.take(&STATUSTEXT_DATA { severity, text: text.into(), id, chunk_seq })
    }

    #[test]
    fn words_are_one_line_and_their_severity_counts() {
        let mut texts = StatusTexts::default();
        let mut said = |severity, text: &str| said(&mut texts, severity, text, 0, 0);
        let warning = said(MavSeverity::MAV_SEVERITY_CRITICAL, "PreArm: RC not\ncalibrated");
        assert_eq!(warning, Some((true, "PreArm: RC not calibrated".into())));
        assert_eq!(said(MavSeverity::MAV_SEVERITY_INFO, "EKF ready"), Some((false, "EKF ready".into())));
        assert_eq!(said(MavSeverity::MAV_SEVERITY_INFO, " "), None);
    }

    #[test]
    fn a_text_longer_than_a_message_is_put_together() {
        let mut texts = StatusTexts::default();
        let mut said = |text: &str, id, chunk_seq| {
            said(&mut texts, MavSeverity::MAV_SEVERITY_CRITICAL, text, id, chunk_seq).map(|(_, text)| text)
        };
        let long = "PreArm: AHRS: EKF3 Yaw inconsistent 12 deg. Wait or reboot";
        assert_eq!(said(&long[..CHUNK], 7, 0), None);
        assert_eq!(said(&long[CHUNK..], 7, 1).as_deref(), Some(long));
        // The end of one was lost, and the beginning of another.
        assert_eq!(said(&long[..CHUNK], 8, 0), None);
        assert_eq!(said("short", 9, 0).as_deref(), Some("short"));
        assert_eq!(said("the end", 10, 1).as_deref(), Some("the end"));
        assert_eq!(said(&long[..CHUNK], 0, 0).as_deref(), Some(&long[..CHUNK]), "exactly one message");
    }
}
