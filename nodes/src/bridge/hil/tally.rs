//! Reports on an autopilot's outputs and on refused packets: each kind once, and totals at the end.

use whirlstand_bridge::autopilot::{Counts, Outputs};
use whirlstand_bridge::mixer::Mixer;
use whirlstand_bridge::note::Note;
use whirlstand_bridge::peer::PeerCounts;

/// Number of unreadable bytes, without a readable packet, from which a wrong link is reported.
const UNREADABLE_BYTES: u64 = 200;

/// Counters, and which of them were reported.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tally {
    name: &'static str,
    counts: Counts,
    unreadable: bool,
    beyond: u64,
    /// Packets lost before the run, which do not count: an autopilot that starts misses nothing of it.
    before: Option<u64>,
}

impl Tally {
    /// Counters for the autopilot with this name.
    pub(super) fn new(name: &'static str) -> Self {
        Self { name, counts: Counts::default(), unreadable: false, beyond: 0, before: None }
    }

    /// Counts outputs used by the mixer that are beyond their range.
    pub(super) fn outputs(&mut self, outputs: &Outputs, mixer: &Mixer) {
        let Some(first) = mixer.first_used(outputs.beyond) else { return };
        self.beyond += 1;
        if self.beyond == 1 {
            tracing::warn!("{}: output {first} is out of range and was limited", self.name);
        }
    }

    /// Number of outputs held at a limit.
    pub(super) fn beyond(&self) -> u64 {
        self.beyond
    }

    /// Marks the beginning of the run.
    pub(super) fn begin(&mut self, counts: Counts) {
        self.before.get_or_insert(counts.lost + counts.skipped);
    }

    /// Number of packets of the run that never arrived, or were never sent.
    pub(super) fn lost(&self, counts: Counts) -> u64 {
        self.before.map_or(0, |before| (counts.lost + counts.skipped).saturating_sub(before))
    }

    /// Reports events that happened for the first time.
    pub(super) fn look(&mut self, counts: Counts, refused: PeerCounts) {
        if counts.malformed > 0 && self.counts.malformed == 0 {
            tracing::warn!("{} sent messages that are not in its protocol: {counts:?}", self.name);
        }
        if counts.stale > 0 && self.counts.stale == 0 {
            tracing::warn!(
                "{} sent outputs with a repeated or older time or number: they are ignored",
                self.name
            );
        }
        let unreadable = counts.malformed + refused.invalid;
        if !self.unreadable && counts.outputs == 0 && unreadable > UNREADABLE_BYTES {
            self.unreadable = true;
            tracing::warn!(
                "{unreadable} bytes or packets arrived, none of them from {}: on a serial line, check the baud rate",
                self.name
            );
        }
        self.counts = counts;
    }

    /// Reports the totals.
    pub(super) fn end(&self, unsent: u64, refused: PeerCounts) {
        tracing::info!(
            unsent,
            strangers = refused.sum(),
            beyond = self.beyond,
            "the session with {} has ended: {:?}",
            self.name,
            self.counts
        );
        if self.beyond > 0 {
            tracing::warn!("{}: {} outputs were out of range", self.name, self.beyond);
        }
        if refused.sum() > 0 {
            tracing::warn!(
                "{} datagrams or clients that were not {}'s were refused: {refused:?}",
                refused.sum(),
                self.name
            );
        }
    }
}

/// Reports a note of the protocol.
pub(super) fn tell(note: &Note) {
    let Note { warn, text } = note;
    if *warn {
        tracing::warn!("{text}");
    } else {
        tracing::info!("{text}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_autopilot_that_takes_its_time_to_start_has_lost_nothing_of_the_run() {
        let mut tally = Tally::new("an autopilot");
        let counts = |lost, skipped| Counts { lost, skipped, ..Counts::default() };
        assert_eq!(tally.lost(counts(0, 9)), 0);
        tally.begin(counts(1, 9));
        assert_eq!(tally.lost(counts(1, 9)), 0);
        assert_eq!(tally.lost(counts(3, 10)), 3);
    }
}
