//! Models of a record: free runs, noise, likelihood, and the response of the samples to effects.

pub mod channel_noise;
pub mod climb;
pub mod columns;
pub mod commands;
mod descent;
pub mod driven;
pub mod fit;
pub mod forced_response;
pub mod free_run;
pub mod innovations;
pub mod input_reconstruction;
pub mod noise;
pub mod observer;
pub mod optimum;
pub mod part;
pub mod part_fit;
mod place;
pub mod predictor;
mod profile_interval;
pub mod reach;
pub mod score_test;
pub mod sensitivities;
pub mod state_filter;
pub mod step_response;
mod wander;
pub(crate) mod wave;
pub mod whittle;
