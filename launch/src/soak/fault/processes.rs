//! Signals to nodes.

use rustix::process::{Pid, Signal, kill_process};

use super::ongoing::Ongoing;

/// Kills a process with SIGKILL.
pub(super) fn kill(pid: u32) {
    send(pid, Signal::KILL);
}

/// A stopped process, which continues when this is dropped.
pub(super) struct Stopped {
    pid: u32,
}

impl Stopped {
    pub fn begin(pid: u32) -> Self {
        send(pid, Signal::STOP);
        Self { pid }
    }
}

impl Ongoing for Stopped {
    fn dealt(&self) -> u64 {
        1
    }
}

impl Drop for Stopped {
    fn drop(&mut self) {
        send(self.pid, Signal::CONT);
    }
}

/// A process that has just ended by itself needs no signal.
fn send(pid: u32, signal: Signal) {
    if let Some(pid) = i32::try_from(pid).ok().and_then(Pid::from_raw) {
        let _ = kill_process(pid, signal);
    }
}
