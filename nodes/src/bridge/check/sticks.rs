//! Determines the sign of a channel from the vehicle's own radio: a pilot holds the stick to the right, and
//! the vehicle rolls right. A channel that increases then is one that rolls the vehicle right.

use whirlstand_bridge::channels::Steering;
use whirlstand_bridge::config::{BridgeKind, Output};

use super::Finding;
use super::consent::listed;

/// Smallest change of a channel by a held stick, us.
const HELD_US: f64 = 150.0;

/// Name of the radio line that the bridge sends to, where it is the vehicle's radio itself and the vehicle has
/// no other.
pub(super) fn radio_line(kind: BridgeKind, output: Option<Output>) -> Option<&'static str> {
    match (kind, output) {
        (BridgeKind::Crsf, _) | (BridgeKind::Mavlink, Some(Output::Crsf)) => Some("CRSF"),
        (BridgeKind::Mavlink, Some(Output::Sbus)) => Some("SBUS"),
        _ => None,
    }
}

/// Why no channels came back.
pub(super) fn no_channels(kind: BridgeKind) -> &'static str {
    match kind {
        BridgeKind::Crsf => {
            "CRSF brings no channels back: watch it on the receiver page of the vehicle's configurator"
        }
        _ => "the vehicle does not report its channels (RC_CHANNELS)",
    }
}

/// The direction of channels that go out over a radio line. A disarmed vehicle does not turn, so its attitude
/// shows nothing either; the bridge compares the two as soon as the vehicle flies.
pub(super) fn one_way(line: &str, steering: &[Steering]) -> Finding {
    let channels: Vec<_> = steering.iter().map(|s| s.channel).collect();
    Finding::Unknown(format!(
        "{}: which way the vehicle turns, because over {line} a disarmed vehicle shows nothing of what a channel \
         does; in flight the bridge compares the attitude with its commands, and goes neutral at a wrong sign",
        listed(&channels, |_| String::new())
    ))
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
    fn channels_that_go_out_over_a_radio_line_are_told_as_unchecked_once() {
        assert_eq!(radio_line(BridgeKind::Crsf, None), Some("CRSF"));
        assert_eq!(radio_line(BridgeKind::Mavlink, Some(Output::Crsf)), Some("CRSF"));
        assert_eq!(radio_line(BridgeKind::Mavlink, Some(Output::Sbus)), Some("SBUS"));
        assert_eq!(radio_line(BridgeKind::Mavlink, Some(Output::RcOverride)), None);
        let steering = [0, 1].map(|channel| Steering { channel, axis: channel, up_is_positive: true });
        let Finding::Unknown(text) = one_way("SBUS", &steering) else { panic!() };
        assert!(text.starts_with("channels 1 and 2: which way") && text.contains("over SBUS"), "{text}");
    }

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
