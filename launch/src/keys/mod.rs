//! Keys of a bench over Zenoh: who its members are, where their keys come from, and where outside programs find theirs.

mod bench_folder;
mod bench_keys;
mod members;

pub(crate) use bench_folder::{BenchFolder, await_configuration, configuration, write_private};
pub(crate) use bench_keys::{BenchKeys, LOOPBACK};
pub(crate) use members::{GUEST, LAUNCHER, OBSERVER};
