//! Texts on requests from outside and the reasons for their refusal.

use whirlstand_msgs::{AdjustmentKind, AdjustmentVerdict};

/// Reason for the refusal of a request, as a sentence; `key` is the launch-file key that allows requests.
pub fn refusal(verdict: AdjustmentVerdict, key: &str) -> String {
    match verdict {
        AdjustmentVerdict::Asked | AdjustmentVerdict::Done => "it is not refused".into(),
        AdjustmentVerdict::Closed => {
            format!("the bench does not accept such messages from outside: start it with --set {key}=true")
        }
        AdjustmentVerdict::Unusable => "its value has no meaning here".into(),
        AdjustmentVerdict::NoSuchState => "the vehicle has no such state".into(),
        AdjustmentVerdict::OutOfRange => {
            "it is beyond the limits: the bound of the state, or 0.1 to 10 for the gain".into()
        }
        AdjustmentVerdict::Busy => {
            "the maximum number of gusts is already active, or someone else has the stick".into()
        }
        AdjustmentVerdict::NotOfThisLaw => "the law has no such setting".into(),
        AdjustmentVerdict::NoSuchEffect => "the vehicle has no such effect with from_s or until_s".into(),
    }
}

/// Name of the requested change.
pub(crate) fn name(kind: AdjustmentKind) -> &'static str {
    match kind {
        AdjustmentKind::Gust => "a gust",
        AdjustmentKind::Engine => "a state of the engine",
        AdjustmentKind::Setpoint => "a setpoint",
        AdjustmentKind::Gain => "a gain",
        AdjustmentKind::Stop => "an end of the run",
        AdjustmentKind::Effect => "a switch of an effect",
        AdjustmentKind::Stick => "the stick",
    }
}
