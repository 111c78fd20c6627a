//! What is asked for from outside while a bench flies, and what became of it.

use crate::MAX_INPUTS;
use crate::define::message;

message! {
    /// A change in flight: asked for on topic `adjust`, answered on this message's own topic by the node whose business it
    /// is. In an answer `head` is the step from which it is in force, or at which it was refused.
    Adjustment on "adjusted" {
        /// Number of the request, of the asker's choice; the answer repeats it. The same request once more is answered once
        /// more and not done again.
        id: u64 => "uint64",
        /// The new value, SI: of the state's derivative for a gust, of the state for a setpoint, a factor for the gain, 0
        /// (off), 1 (on, on the ground) or 2 (flying) for the engine, 0 (off) or 1 (on) for an effect, 1 (taken over) or 0 (given
        /// back) for the stick; for the end of the run 0.
        value: f64 => "float64",
        /// How long a gust acts, ns of bench time; for the others 0.
        length_ns: u64 => "uint64",
        /// An [`AdjustmentKind`].
        what: u32 => "uint32",
        /// Which state, in the vehicle's order, of a gust or a setpoint, or which effect, those of the vehicle file first and
        /// then those of the launch file, from 0; for the others 0.
        index: u32 => "uint32",
        /// An [`AdjustmentVerdict`].
        verdict: u32 => "uint32",
        /// Zero.
        reserved: u32 => "uint32",
    }
}

message! {
    /// The stick in the hand of somebody outside, who has taken it over with an [`Adjustment`]: it flies in the place of the
    /// law. Who says nothing for half a second of bench time gives it back.
    Stick on "stick" {
        /// The inputs, in the vehicle's order, SI; unused ones are zero.
        u: f64[MAX_INPUTS] => "float64[8]",
        /// Number of the request with which it was taken over: what comes from others is not obeyed.
        id: u64 => "uint64",
    }
}

/// What is adjusted, as a number in [`Adjustment::what`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum AdjustmentKind {
    /// The plant: a push on a state for some time, added to all others.
    Gust = 1,
    /// The plant: what the engine does.
    Engine = 2,
    /// The controller: the reference of a state, in the place of the launch file's from now on.
    Setpoint = 3,
    /// The controller: a factor on the law's feedback.
    Gain = 4,
    /// The plant: the run ends in order after this step, as if it had been planned so.
    Stop = 5,
    /// The plant: an effect that has a window acts, or does not, from now on whatever its window says.
    Effect = 6,
    /// The controller: the stick is in the hand of whoever asks, or the law flies again. Also said without being asked, when
    /// the hand has been silent for too long; `id` is then that of the request with which it was taken over.
    Stick = 7,
}

/// What became of a request, as a number in [`Adjustment::verdict`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum AdjustmentVerdict {
    /// It is a request.
    Asked = 0,
    /// It is in force.
    Done = 1,
    /// The launch file does not open the node to the outside.
    Closed = 2,
    /// The value is no number, or not one of those that there are.
    Unusable = 3,
    /// The vehicle has no such state.
    NoSuchState = 4,
    /// The value is beyond what the node allows.
    OutOfRange = 5,
    /// As many gusts blow as there can be at once, or somebody else has the stick.
    Busy = 6,
    /// This law has no such thing.
    NotOfThisLaw = 7,
    /// The vehicle has no such effect, or it is one without a window.
    NoSuchEffect = 8,
}

impl AdjustmentKind {
    /// The kind for a number in [`Adjustment::what`]; `None` for one that this version does not know.
    pub fn from_u32(value: u32) -> Option<Self> {
        let all =
            [Self::Gust, Self::Engine, Self::Setpoint, Self::Gain, Self::Stop, Self::Effect, Self::Stick];
        all.into_iter().find(|k| *k as u32 == value)
    }
}

impl AdjustmentVerdict {
    /// The verdict for a number in [`Adjustment::verdict`]; `None` for one that this version does not know.
    pub fn from_u32(value: u32) -> Option<Self> {
        use AdjustmentVerdict::{
            Asked, Busy, Closed, Done, NoSuchEffect, NoSuchState, NotOfThisLaw, OutOfRange, Unusable,
        };
        [Asked, Done, Closed, Unusable, NoSuchState, OutOfRange, Busy, NotOfThisLaw, NoSuchEffect]
            .into_iter()
            .find(|v| *v as u32 == value)
    }
}
