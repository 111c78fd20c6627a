//! A node that gets no more memory: its address space may not grow.

use std::io;

use rustix::process::{Pid, Resource, Rlimit, prlimit};

use super::ongoing::Ongoing;

/// A limit of a process, set from outside; dropped, the process has the one of before.
pub(super) struct Limited {
    pid: Pid,
    resource: Resource,
    before: Rlimit,
}

impl Limited {
    /// Sets the soft limit, so that it can be taken back without any right.
    pub fn begin(pid: u32, resource: Resource, limit: u64) -> io::Result<Self> {
        let pid = i32::try_from(pid).ok().and_then(Pid::from_raw).ok_or(io::ErrorKind::InvalidInput)?;
        let none = Rlimit { current: Some(limit), maximum: None };
        // The hard limit is not known beforehand, and may not be raised.
        let maximum = rustix::process::getrlimit(resource).maximum;
        let before = prlimit(Some(pid), resource, Rlimit { maximum, ..none })?;
        Ok(Self { pid, resource, before })
    }
}

impl Drop for Limited {
    fn drop(&mut self) {
        // A process that has gone needs no limit.
        let _ = prlimit(Some(self.pid), self.resource, self.before);
    }
}

/// A process without a page more than it has.
pub(super) struct NoMemory {
    _limit: Limited,
}

impl NoMemory {
    pub fn begin(pid: u32) -> io::Result<Self> {
        // proc_pid_status(5): the whole address space, in kB.
        let status = std::fs::read_to_string(format!("/proc/{pid}/status"))?;
        let size = status.lines().find_map(|line| line.strip_prefix("VmSize:"));
        let kilobytes: Option<u64> = size.and_then(|size| size.split_whitespace().next()?.parse().ok());
        let bytes = kilobytes.ok_or(io::ErrorKind::InvalidData)? << 10;
        Ok(Self { _limit: Limited::begin(pid, Resource::As, bytes)? })
    }
}

impl Ongoing for NoMemory {
    fn dealt(&self) -> u64 {
        1
    }
}
