//! Exclusive resources of a run: its folder and its bench's name; and the files that killed runs left behind. One
//! lock, the claim of the name, covers everything that a bench has on this machine: memory, sockets and keys.

mod claim;
mod lock_file;
mod out_folder;
mod runtime_folder;
mod stale;

pub(crate) use claim::{Claim, benches_with_keys, keys_of, running_benches, sockets_of};
pub(crate) use out_folder::OutFolder;
pub(crate) use runtime_folder::own_folder;
pub(crate) use stale::{StaleRun, remove, stale};
