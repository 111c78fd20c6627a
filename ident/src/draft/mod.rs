//! A first vehicle file from a record: signals by name and unit, structures by predictions of held-out data.
//!
//! - [`presets`] and [`proposal`]: which signals of a log are inputs and outputs; [`reading`]: the record of them.
//! - [`blocks`]: data that are fitted and data that are held out; [`own_past`] and [`survey`]: which input explains
//!   which output better than its own past does, and what is refused.
//! - [`mixer`]: rotors that act together.
//! - [`structure`], [`ahead`] and [`select`]: the structure of an axis, fitted by prediction error (Ljung, System
//!   Identification, 2nd ed., chapters 3 and 7; Jategaonkar, Flight Vehicle System Identification, chapter 5).
//! - [`compose`], [`comments`], [`answer`] and [`run`]: the vehicle, its file, and what is told.

mod ahead;
mod answer;
mod blocks;
mod comments;
mod compose;
mod error;
mod mixer;
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

pub use answer::{
    AxisAnswer, DRAFT_SCHEMA, Draft, HeldOut, LeftOut, ParameterAnswer, SignalAnswer, TriedAnswer,
};
pub use error::DraftError;
pub use proposal::Choice;
pub use run::{Names, draft};
pub use structure::Structure;
