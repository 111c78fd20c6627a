//! Warnings, once each, about a MAVLink link with little usable data.

use crate::mavlink::Counts;
use crate::note::Notes;

/// Number of bytes without a message from which a wrong baud rate is reported.
const BAUD_WARNING_BYTES: u64 = 600;

/// Number of messages with a wrong or missing signature that is no coincidence.
const SIGNATURE_WARNING_MESSAGES: u64 = 5;

/// Warnings given so far.
#[derive(Debug, Clone, Default)]
pub(super) struct Warnings {
    baud: bool,
    signature: bool,
}

impl Warnings {
    /// Checks the counts of `link`, and warns about each problem once.
    pub(super) fn look(&mut self, counts: &Counts, link: &str, notes: &mut Notes) {
        if !self.signature && counts.signature() >= SIGNATURE_WARNING_MESSAGES {
            self.signature = true;
            notes.warn(format!("on {link} {}", signatures(counts)));
        }
        // Frames with a correct checksum arrived at the correct baud rate.
        let nothing = counts.messages + counts.signature() == 0;
        if !self.baud && nothing && counts.bytes > BAUD_WARNING_BYTES {
            self.baud = true;
            notes.warn(format!(
                "{} bytes arrived on {link}, none of them MAVLink: check the baud rate, and that this is the telemetry port",
                counts.bytes
            ));
        }
    }
}

/// Text on signature problems, with the number of messages.
fn signatures(counts: &Counts) -> String {
    let kinds = [
        (counts.wrong_signature, "had a wrong signature: is bridge.mavlink.signing_key the vehicle's key?"),
        (
            counts.unsigned,
            "had no signature: bridge.mavlink.signing_key asks for one; give the vehicle the same key",
        ),
        (counts.replayed, "were signed at an earlier time: they were replayed, or a clock is wrong"),
    ];
    let parts: Vec<_> = kinds
        .iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, what)| format!("{count} messages {what}"))
        .collect();
    parts.join("; ")
}
