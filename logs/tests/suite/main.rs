//! Logs of every format, whole and damaged.

mod blackbox;
#[path = "../support/blackbox.rs"]
mod blackbox_file;
#[path = "../support/damage.rs"]
mod damage;
mod dataflash;
#[path = "../support/dataflash.rs"]
mod dataflash_file;
mod diff_and_info;
mod foreign_logs;
mod mcap_log;
