//! Tests whether the flying vehicle still agrees with its file: sequential change detection on the
//! innovations. No I/O.
//!
//! A [`Mirror`] takes the measurements and inputs of each step. It runs the [`Predictor`] with the known
//! model of the vehicle and tests its whitened innovations with a bank of [cumulative sums](`Bank`). When
//! these detect that the prediction has become wrong, it replays the measurements since then under every
//! effect that could be the cause (generalised likelihood ratio).
//!
//! Sources: Basseville and Nikiforov, "Detection of Abrupt Changes", Prentice Hall 1993 (2.2 CUSUM, 2.4 GLR,
//! 7.2 additive changes in state space, 8.2 and 8.3 changes of the spectrum and of parameters); Willsky and
//! Jones, IEEE Trans. Autom. Control 21, 1976 (GLR on the innovations of a Kalman filter); Baum and
//! Veeravalli, IEEE Trans. Inf. Theory 40, 1994 (sequential test of many hypotheses).

mod bank;
mod candidates;
mod capture;
mod error;
mod excess;
mod finding;
mod known;
mod lateness;
mod mirror;
mod onsets;
mod predictor;
mod replay;
mod rounding;
mod run_length;
mod search;
mod tones;
mod verdict;

pub use bank::Bank;
pub use error::MirrorError;
pub use finding::{Cause, Finding, Stage, Value};
pub use known::Knowledge;
pub use mirror::{Mirror, Options};
pub use predictor::{Predictor, Sample};
pub use run_length::{mean_threshold, variance_threshold};
