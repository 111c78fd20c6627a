//! Consent to moving a vehicle's channels: what will move is named beforehand, and nothing moves without it.

use whirlstand_bridge::channels::Steering;

use super::Finding;

/// Movement of each channel during the check, us.
pub(super) const MOVED_BY_US: f64 = 100.0;

/// Answer to the question whether the channels may move.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Consent {
    /// They may move.
    Given,
    /// They may not.
    Refused,
    /// There is nobody who can be asked.
    Nobody,
}

/// The question to ask before the channels `in_use`, numbered from 0, are moved.
pub(super) fn question(in_use: &[usize], steering: &[Steering]) -> String {
    let moves = listed(in_use, |channel| {
        let axis = steering.iter().find(|s| s.channel == channel).map(|s| s.stick().0);
        axis.map_or_else(String::new, |axis| format!(" ({axis})"))
    });
    format!(
        "This check moves {moves} of the vehicle by {MOVED_BY_US} us. Are the propellers off, and may it move them?"
    )
}

/// What remains unchecked of a channel, from 0, without consent.
pub(super) fn unmoved(channel: usize, consent: Consent) -> Finding {
    let why = match consent {
        Consent::Nobody => "there is no terminal to ask for consent: --yes gives it",
        Consent::Given | Consent::Refused => "there was no consent to moving it",
    };
    Finding::Unknown(format!(
        "channel {}: whether it arrives, and which way it turns the vehicle, because {why}",
        channel + 1
    ))
}

/// The channels, from 0, as words, each followed by its note.
pub(super) fn listed(channels: &[usize], note: impl Fn(usize) -> String) -> String {
    let names: Vec<_> = channels.iter().map(|c| format!("{}{}", c + 1, note(*c))).collect();
    match names.split_last() {
        None => "no channel".into(),
        Some((only, [])) => format!("channel {only}"),
        Some((last, rest)) => format!("channels {} and {last}", rest.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_question_names_every_channel_that_moves_and_the_propellers() {
        let steering =
            [(0, 0), (1, 1)].map(|(channel, axis)| Steering { channel, axis, up_is_positive: true });
        let asked = question(&[0, 1, 6], &steering);
        for words in ["channels 1 (roll), 2 (pitch) and 7 of", "by 100 us", "Are the propellers off"] {
            assert!(asked.contains(words), "{words}: {asked}");
        }
        assert!(question(&[2], &[]).contains("moves channel 3 of"));
    }

    #[test]
    fn a_channel_that_did_not_move_is_unchecked_with_the_reason() {
        for (consent, words) in [(Consent::Nobody, "--yes"), (Consent::Refused, "no consent")] {
            let Finding::Unknown(text) = unmoved(1, consent) else { panic!("{consent:?}") };
            assert!(text.starts_with("channel 2: ") && text.contains(words), "{text}");
        }
    }
}
