//! ArduPilot's texts on why it does not arm: one for each check that fails (`PreArm: ...`), each time the checks
//! are reported, and one for a refused attempt (`Arm: ...`).
//!
//! Source: `AP_Arming::check_failed` (`libraries/AP_Arming/AP_Arming.cpp`).

/// Largest number of failing checks that are kept: whatever arrives, it is a line that somebody reads.
const MOST: usize = 16;

/// Texts that hold now.
#[derive(Debug, Clone, Default)]
pub(super) struct PreArm {
    /// Failing checks, and whether each was reported since the last request.
    failing: Vec<(String, bool)>,
    /// Reason for the last refused attempt.
    refused: Option<String>,
}

impl PreArm {
    /// Takes a text of this kind; returns whether it is new, or `None` for another text.
    pub(super) fn take(&mut self, text: &str) -> Option<bool> {
        if text.starts_with("Arm: ") {
            let is_new = self.refused.as_deref() != Some(text);
            self.refused = Some(text.into());
            return Some(is_new);
        }
        if !text.starts_with("PreArm: ") {
            return None;
        }
        if let Some((_, is_current)) = self.failing.iter_mut().find(|(failing, _)| failing == text) {
            *is_current = true;
            return Some(false);
        }
        let is_new = self.failing.len() < MOST;
        if is_new {
            self.failing.push((text.into(), true));
        }
        Some(is_new)
    }

    /// The checks are requested anew: those that were not reported since the last request pass by now.
    pub(super) fn asked(&mut self) {
        self.failing.retain(|(_, is_current)| *is_current);
        self.failing.iter_mut().for_each(|(_, is_current)| *is_current = false);
    }

    /// All texts that hold.
    pub(super) fn texts(&self) -> impl Iterator<Item = &str> {
        self.refused.iter().map(String::as_str).chain(self.failing.iter().map(|(text, _)| text.as_str()))
    }

    /// Discards everything, as it is armed.
    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }
}
