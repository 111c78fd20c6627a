//! What is told, once, of a MAVLink link on which little comes that can be used.

use crate::mavlink::Counts;
use crate::note::Notes;

/// After so many bytes without a message the baud rate is said to be wrong.
const BAUD_WARNING_BYTES: u64 = 600;

/// So many messages without a right signature are no accident.
const SIGNATURE_WARNING_MESSAGES: u64 = 5;

/// What was told.
#[derive(Debug, Clone, Default)]
pub(super) struct Warnings {
    baud: bool,
    signature: bool,
}

impl Warnings {
    /// Looks at what has come on `link`, and tells what is wrong for the first time.
    pub(super) fn look(&mut self, counts: &Counts, link: &str, notes: &mut Notes) {
        if !self.signature && counts.signature() >= SIGNATURE_WARNING_MESSAGES {
            self.signature = true;
            notes.warn(format!("on {link} {}", signatures(counts)));
        }
        // Frames whose checksum holds came at the right rate.
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

/// What is wrong with the signatures, by how many messages.
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
