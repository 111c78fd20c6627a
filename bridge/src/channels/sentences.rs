//! Describes in one sentence per channel how it moves the vehicle, for a user who is about to arm.

use super::{ANGLES, Input, Mapping, Source};
use crate::pilot::Axis;

/// Words for a positive and a negative rotation about each axis.
const TURNS: [[&str; 2]; 3] = [
    ["rolls right", "rolls left"],
    ["pitches nose up", "pitches nose down"],
    ["yaws clockwise", "yaws counter-clockwise"],
];

/// Smallest effect on an axis, relative to the largest, that is mentioned.
const LEAST_SHARE: f64 = 0.05;

/// A channel with an input that rotates the vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Steering {
    /// Channel, from 0.
    pub channel: usize,
    /// Axis, 0 to 2.
    pub axis: usize,
    /// True when the vehicle turns right, nose up or clockwise as the channel increases.
    pub up_is_positive: bool,
}

impl Mapping {
    /// The channels with inputs that rotate the vehicle.
    pub fn steering(&self, inputs: &[Input]) -> Vec<Steering> {
        let steering = |m: &super::Mapped| match m.source {
            Source::Input(i, _) => inputs.get(i).and_then(Input::axis).map(|axis| Steering {
                channel: m.index,
                axis,
                up_is_positive: !m.reversed,
            }),
            _ => None,
        };
        self.mapped.iter().filter_map(steering).collect()
    }

    /// One sentence for each channel: its source, and its effect on each axis.
    pub fn sentences(&self, inputs: &[Input]) -> Vec<String> {
        // An unnamed channel that is low or the pilot's own is the default, and is not mentioned.
        let is_told = |m: &&super::Mapped| self.in_use()[m.index] || m.source == Source::Arm;
        self.mapped.iter().filter(is_told).map(|m| sentence(m, inputs)).collect()
    }
}

fn sentence(m: &super::Mapped, inputs: &[Input]) -> String {
    let number = m.index + 1;
    match m.source {
        Source::Fixed => format!("channel {number} is held at {:.0} us while armed", m.trim_us),
        Source::Arm => {
            format!("channel {number} arms the vehicle: high while the controller or the pilot is in charge")
        }
        Source::Stick(axis) => format!("channel {number} is the pilot's {}", axis.name()),
        Source::Pilot(channel) => format!("channel {number} is the pilot's channel {channel}"),
        Source::Input(i, _) => {
            let Some(input) = inputs.get(i) else { return format!("channel {number} carries nothing") };
            let way = if m.span_us < 0.0 { "down" } else { "up" };
            let (effects, reversed) =
                (effects(input), if m.reversed { ", because its span_us is negative" } else { "" });
            if effects.is_empty() {
                return format!(
                    "{} + -> channel {number} {way}; it turns the vehicle about no axis",
                    input.name
                );
            }
            format!("{} + -> channel {number} {way}{reversed} -> the vehicle {effects}", input.name)
        }
    }
}

/// Effect of a positive input, its own axis first.
fn effects(input: &Input) -> String {
    let own = input.axis();
    let most = input.turns.iter().fold(0.0, |most: f64, t| most.max(t.abs()));
    let mut axes: Vec<usize> =
        (0..ANGLES.len()).filter(|a| own == Some(*a) || input.turns[*a].abs() > LEAST_SHARE * most).collect();
    axes.sort_by_key(|a| own != Some(*a));
    let words = axes
        .iter()
        .filter(|a| input.turns[**a] != 0.0)
        .map(|a| TURNS[*a][usize::from(input.turns[*a] < 0.0)]);
    words.collect::<Vec<_>>().join(" and ")
}

impl Steering {
    /// Name of the stick, and its direction for a positive rotation.
    pub fn stick(&self) -> (&'static str, &'static str) {
        let place = match ANGLES[self.axis] {
            Axis::Pitch => "back (nose up)",
            Axis::Yaw | Axis::Roll | Axis::Throttle => "to the right",
        };
        (ANGLES[self.axis].name(), place)
    }
}
