//! Launch files: read, overridden, checked, and turned into what the supervisor starts.

mod amount;
mod bridge;
mod builtin;
mod document;
mod expect;
mod jobs;
mod nodes;
mod plan;
mod schema;
mod wording;

#[cfg(test)]
mod tests;

pub(crate) use builtin::{BUILTIN, DEFAULT, find};
pub(crate) use document::Document;
pub(crate) use jobs::{Jobs, jobs};
pub(crate) use plan::{Plan, PlannedNode, plan};
pub(crate) use schema::{Ready, Restart};
