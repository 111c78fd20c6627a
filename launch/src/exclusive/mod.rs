//! What one run has for itself: its folder and its bench's name; and what is left of runs that were killed.

mod claim;
mod lock_file;
mod out_folder;
mod runtime_folder;
mod stale;

pub(crate) use claim::{Claim, running_benches, sockets_of};
pub(crate) use out_folder::OutFolder;
pub(crate) use stale::{StaleRun, remove, stale};
