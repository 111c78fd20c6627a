//! A memory fault: the address space of a node may not grow.

use std::io;

use rustix::process::{Pid, Resource, Rlimit, prlimit};

use super::ongoing::Ongoing;

/// A resource limit of another process. When this is dropped, the process gets its previous limit back.
pub(super) struct Limited {
    pid: Pid,
    resource: Resource,
    before: Rlimit,
}

impl Limited {
    /// Sets the soft limit, which can be restored without any privilege.
    pub fn begin(pid: u32, resource: Resource, limit: u64) -> io::Result<Self> {
        let pid = i32::try_from(pid).ok().and_then(Pid::from_raw).ok_or(io::ErrorKind::InvalidInput)?;
        let none = Rlimit { current: Some(limit), maximum: None };
        // The hard limit must be read first, because it may not be raised.
        let maximum = rustix::process::getrlimit(resource).maximum;
        let before = prlimit(Some(pid), resource, Rlimit { maximum, ..none })?;
        Ok(Self { pid, resource, before })
    }
}

impl Drop for Limited {
    fn drop(&mut self) {
        // A process that has ended needs no limit.
        let _ = prlimit(Some(self.pid), self.resource, self.before);
    }
}

/// A process that can get no page of memory beyond those that it has.
pub(super) struct NoMemory {
    _limit: Limited,
}

impl NoMemory {
    pub fn begin(pid: u32) -> io::Result<Self> {
        // proc_pid_status(5): `VmSize` is the whole address space, in kB.
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
