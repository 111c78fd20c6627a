//! A first vehicle file from a record: signals by name and unit, structures by predictions of held-out data.
//!
//! - [`presets`], [`controls`] and [`proposal`]: selection of inputs and outputs among the signals of a log; [`reading`]:
//!   their record; [`turns`]: degrees or radians.
//! - [`blocks`]: fitted and held-out data; [`own_past`], [`cross_validation`] and [`survey`]: inputs that explain an output better
//!   than its own past, and refusals.
//! - [`feedback`]: whether an input reacts to an output; [`intersample`]: what it does between its samples;
//!   [`mixer`]: rotors that act together.
//! - [`structure`], [`ahead`] and [`select`]: the structure of an axis, fitted by prediction error (Ljung, System
//!   Identification, 2nd ed., chapters 3 and 7; Jategaonkar, Flight Vehicle System Identification, chapter 5).
//! - [`compose`], [`comments`], [`finish`], [`answer`] and [`run`]: the vehicle, its file, and the answer.

mod ahead;
mod answer;
mod blocks;
mod comments;
mod comparison;
mod compose;
mod controls;
mod cross_validation;
mod error;
mod feedback;
mod finish;
mod flown;
mod intersample;
mod mixer;
mod names;
mod own_past;
mod presets;
mod proposal;
mod reading;
mod run;
mod select;
mod structure;
mod survey;
#[cfg(test)]
mod tests;
mod turns;

pub use answer::{
    AxisAnswer, DRAFT_SCHEMA, Draft, HeldOut, LeftOut, ParameterAnswer, SignalAnswer, TriedAnswer,
};
pub use error::DraftError;
pub use finish::Names;
pub use proposal::Choice;
pub use run::draft;
pub use structure::Structure;
