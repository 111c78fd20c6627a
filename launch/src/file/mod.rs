//! Launch files: read, overridden, checked, and turned into what the supervisor starts.

mod amount;
mod bridge;
mod builtin;
pub(crate) mod document;
mod estimator;
mod expect;
mod finite;
mod jobs;
mod mirror;
mod model;
mod nodes;
mod plan;
mod protect;
mod schema;
mod security;
mod wording;

#[cfg(test)]
mod fuzz;
#[cfg(test)]
mod tests;

pub(crate) use builtin::{BUILTIN, DEFAULT, FoundFile, find};
pub(crate) use document::{Document, at};
pub(crate) use jobs::{Jobs, jobs, jobs_of};
pub(crate) use plan::{Plan, PlannedNode, initial_state, plan};
pub(crate) use schema::{LaunchFile, Ready, Restart};
pub(crate) use security::{Security, secret_beyond_its_reach};
pub(crate) use wording::unknown;
