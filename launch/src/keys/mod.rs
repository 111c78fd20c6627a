//! Keys of a bench over Zenoh: its members, the origin of their keys, and the folder in which outside programs
//! find theirs.

mod bench_folder;
mod bench_keys;
mod members;

pub(crate) use bench_folder::{BenchFolder, await_configuration, configuration, write_private};
pub(crate) use bench_keys::{BenchKeys, LOOPBACK};
pub(crate) use members::{GUEST, LAUNCHER, OBSERVER};
