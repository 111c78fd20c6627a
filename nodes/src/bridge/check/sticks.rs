//! Determines the sign of a channel from the vehicle's own radio: a pilot holds the stick to the right, and
//! the vehicle rolls right. A channel that increases then is one that rolls the vehicle right.

use whirlstand_bridge::channels::Steering;
use whirlstand_bridge::config::{BridgeConfig, BridgeKind, Output};

use super::Finding;

/// Smallest change of a channel by a held stick, us.
const HELD_US: f64 = 150.0;

/// True when the vehicle may have its own radio: not where the bridge is its radio.
pub(super) fn has_own_radio(bridge: &BridgeConfig) -> bool {
    let output = bridge.options.mavlink.as_ref().map(|m| m.output);
    bridge.kind == BridgeKind::Mavlink && !matches!(output, Some(Output::Crsf | Output::Sbus))
}

/// The channel, from 0, that moved most from its rest position while a stick is held, and its change, us.
pub(super) fn moved(rest: &[f64], now: &[f64]) -> Option<(usize, f64)> {
    let changes = now.iter().zip(rest).map(|(now, rest)| now - rest).enumerate();
    changes.max_by(|(_, a), (_, b)| a.abs().total_cmp(&b.abs())).filter(|(_, change)| change.abs() > HELD_US)
}

/// Compares the sign of the stick's channel with that of the bridge's.
pub(super) fn judge(steering: Steering, moved: Option<(usize, f64)>) -> Finding {
    let ((name, place), number) = (steering.stick(), steering.channel + 1);
    match moved {
        None => Finding::Unknown(format!(
            "channel {number}: which way it turns the vehicle, because nobody held the {name} stick in time"
        )),
        Some((channel, _)) if channel != steering.channel => Finding::Wrong(format!(
            "the {name} stick moves channel {}, and the bridge has {name} on channel {number}",
            channel + 1
        )),
        Some((_, change)) if (change > 0.0) == steering.up_is_positive => Finding::Good(format!(
            "channel {number}: {change:+.0} us for the {name} stick {place}, as the bridge has it"
        )),
        Some((_, change)) => Finding::Wrong(format!(
            "channel {number}: {change:+.0} us for the {name} stick {place}, and the bridge has it the other way round, which \
             is positive feedback: turn the sign of span_us of this channel"
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stick_says_which_channel_it_moves_and_which_way() {
        let rest = [1500.0, 1500.0, 1000.0, 1500.0];
        assert_eq!(moved(&rest, &[1510.0, 1490.0, 1100.0, 1500.0]), None);
        let held = moved(&rest, &[1510.0, 1100.0, 1000.0, 1500.0]);
        assert_eq!(held, Some((1, -400.0)));
        let steering = |channel, up_is_positive| Steering { channel, axis: 1, up_is_positive };
        assert!(matches!(judge(steering(1, false), held), Finding::Good(_)));
        let Finding::Wrong(text) = judge(steering(1, true), held) else { panic!() };
        assert!(text.contains("positive feedback") && text.contains("span_us"), "{text}");
        let Finding::Wrong(text) = judge(steering(0, true), held) else { panic!() };
        assert!(text.contains("pitch stick moves channel 2"), "{text}");
        assert!(matches!(judge(steering(0, true), None), Finding::Unknown(_)));
    }
}
