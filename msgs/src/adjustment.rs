//! Requests from outside while a bench flies, and their verdicts.

use crate::MAX_INPUTS;
use crate::define::message;

message! {
    /// A request for a change in flight, published on topic `adjust`; the responsible node answers on this
    /// message's own topic. In an answer `head` is the step from which the change is in force, or at which it
    /// was refused.
    Adjustment on "adjusted" {
        /// Number of the request, chosen by the sender; the answer repeats it. A repeated request is answered
        /// again but not executed again.
        id: u64 => "uint64",
        /// The new value, SI: of the state's derivative for a gust, of the state for a setpoint, a factor for the gain, 0
        /// (off), 1 (on, on the ground) or 2 (flying) for the engine, 0 (off) or 1 (on) for an effect, 1 (taken over) or 0 (given
        /// back) for the stick; for the end of the run 0.
        value: f64 => "float64",
        /// Duration of a gust, ns of bench time; 0 for the others.
        length_ns: u64 => "uint64",
        /// Kind of change, an [`AdjustmentKind`].
        what: u32 => "uint32",
        /// Index of the state of a gust or a setpoint in the vehicle's order, or of the effect (those of the
        /// vehicle file first, then those of the launch file), from 0; 0 for the others.
        index: u32 => "uint32",
        /// Verdict, an [`AdjustmentVerdict`].
        verdict: u32 => "uint32",
        /// Always zero.
        reserved: u32 => "uint32",
    }
}

message! {
    /// Inputs of a manual controller outside the loop that has taken over with an [`Adjustment`] and replaces
    /// the law. Silence for half a second of bench time gives control back to the law.
    Stick on "stick" {
        /// Inputs in the vehicle's order, SI; unused ones are zero.
        u: f64[MAX_INPUTS] => "float64[8]",
        /// Number of the request that took over; messages with another number are ignored.
        id: u64 => "uint64",
    }
}

/// Kind of a change, as a number in [`Adjustment::what`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum AdjustmentKind {
    /// Plant: a force on a state for some time, in addition to all others.
    Gust = 1,
    /// Plant: the state of the engine.
    Engine = 2,
    /// Controller: the reference of a state, which replaces that of the launch file from now on.
    Setpoint = 3,
    /// Controller: a factor on the law's feedback.
    Gain = 4,
    /// Plant: the run ends normally after this step.
    Stop = 5,
    /// Plant: an effect with a window is switched on or off, overriding its window from now on.
    Effect = 6,
    /// Controller: the stick is taken over by the sender, or given back to the law. Also sent unasked when
    /// the stick has been silent for too long; `id` is then that of the request that took over.
    Stick = 7,
}

/// Verdict on a request, as a number in [`Adjustment::verdict`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum AdjustmentVerdict {
    /// The message is a request.
    Asked = 0,
    /// The change is in force.
    Done = 1,
    /// The launch file does not allow requests to this node.
    Closed = 2,
    /// The value is not a number, or not one of the allowed ones.
    Unusable = 3,
    /// The vehicle has no state with this index.
    NoSuchState = 4,
    /// The value is out of the node's range.
    OutOfRange = 5,
    /// The largest number of simultaneous gusts is reached, or the stick is taken over by another sender.
    Busy = 6,
    /// The law does not support this change.
    NotOfThisLaw = 7,
    /// The vehicle has no effect with this index, or the effect has no window.
    NoSuchEffect = 8,
}

impl AdjustmentKind {
    /// The kind for a number in [`Adjustment::what`]; `None` for an unknown number.
    pub fn from_u32(value: u32) -> Option<Self> {
        let all =
            [Self::Gust, Self::Engine, Self::Setpoint, Self::Gain, Self::Stop, Self::Effect, Self::Stick];
        all.into_iter().find(|k| *k as u32 == value)
    }
}

impl AdjustmentVerdict {
    /// The verdict for a number in [`Adjustment::verdict`]; `None` for an unknown number.
    pub fn from_u32(value: u32) -> Option<Self> {
        use AdjustmentVerdict::{
            Asked, Busy, Closed, Done, NoSuchEffect, NoSuchState, NotOfThisLaw, OutOfRange, Unusable,
        };
        [Asked, Done, Closed, Unusable, NoSuchState, OutOfRange, Busy, NotOfThisLaw, NoSuchEffect]
            .into_iter()
            .find(|v| *v as u32 == value)
    }
}
