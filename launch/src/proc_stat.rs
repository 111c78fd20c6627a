//! The processes of this machine, as the kernel reports them (proc_pid_stat(5), proc_pid_environ(5)).

use std::os::fd::OwnedFd;
use std::path::Path;

use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open, pidfd_send_signal};

/// Environment variable that identifies every process that a node starts, even one that left the node's
/// process group.
pub(crate) const NOTIFY_SOCKET: &str = "NOTIFY_SOCKET";

/// A process that has not ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct ProcStat {
    /// Its process group.
    pub group: i32,
}

impl ProcStat {
    /// A process by its number; `None` when there is none, or only a zombie.
    pub fn of(pid: i32) -> Option<Self> {
        Self::parse(&std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?)
    }

    /// The fields after the name, which is in brackets and may hold any character: state, parent, group.
    fn parse(stat: &str) -> Option<Self> {
        let (_, fields) = stat.rsplit_once(')')?;
        let mut fields = fields.split_whitespace();
        let state = fields.next()?;
        let group = fields.nth(1)?.parse().ok()?;
        (!matches!(state, "Z" | "X" | "x")).then_some(Self { group })
    }
}

/// A running process with an open handle, so that a signal cannot reach another process that got its number
/// later.
#[derive(Debug)]
pub(crate) struct HeldProcess {
    /// Number of the process.
    pub pid: i32,
    /// Group of the process.
    pub group: i32,
    handle: OwnedFd,
}

impl HeldProcess {
    /// All processes that are visible to this one.
    pub fn all() -> impl Iterator<Item = Self> {
        let numbers = std::fs::read_dir("/proc").into_iter().flatten().flatten();
        numbers.filter_map(|e| Self::of(Pid::from_raw(e.file_name().to_str()?.parse().ok()?)?))
    }

    fn of(pid: Pid) -> Option<Self> {
        // The handle is opened before the fields are read, so that they belong to the same process.
        let handle = pidfd_open(pid, PidfdFlags::empty()).ok()?;
        let pid = pid.as_raw_pid();
        Some(Self { pid, group: ProcStat::of(pid)?.group, handle })
    }

    /// Whether the process's notify socket is `socket`, or is in that folder. It was then started by a node or by
    /// a descendant of a node, as long as the variable was passed on.
    pub fn is_notifier(&self, socket: &Path) -> bool {
        let environment = std::fs::read(format!("/proc/{}/environ", self.pid)).unwrap_or_default();
        is_notifier(&environment, socket)
    }

    /// Sends a signal. The call has no effect on a process that has just ended.
    pub fn signal(&self, signal: Signal) {
        let _ = pidfd_send_signal(&self.handle, signal);
    }
}

/// Whether an environment, whose entries end with zeros, has a notify socket at or below this path.
fn is_notifier(environment: &[u8], socket: &Path) -> bool {
    use std::os::unix::ffi::OsStrExt;
    let value =
        |entry: &[u8]| entry.strip_prefix(NOTIFY_SOCKET.as_bytes())?.strip_prefix(b"=").map(<[u8]>::to_vec);
    let mut values = environment.split(|b| *b == 0).filter_map(value);
    values.any(|path| Path::new(std::ffi::OsStr::from_bytes(&path)).starts_with(socket))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_notifier_is_told_by_its_environment() {
        let environment = b"A=1\0NOTIFY_SOCKET=/dev/shm/s1/plant\0B=/dev/shm/s2\0";
        assert!(is_notifier(environment, Path::new("/dev/shm/s1")));
        assert!(is_notifier(environment, Path::new("/dev/shm/s1/plant")));
        for other in ["/dev/shm/s", "/dev/shm/s2", "/dev/shm/s1/plant2"] {
            assert!(!is_notifier(environment, Path::new(other)), "{other}");
        }
        assert!(!is_notifier(b"", Path::new("/")));
    }

    #[test]
    fn a_name_with_brackets_does_not_mislead_and_a_zombie_is_no_process() {
        assert_eq!(ProcStat::parse("7 (a) Z (b) S 1 42 42 0"), Some(ProcStat { group: 42 }));
        assert_eq!(ProcStat::parse("7 (sh) Z 1 42 42 0"), None);
        assert_eq!(ProcStat::parse("7 (sh"), None);
        let own = std::process::id() as i32;
        assert!(HeldProcess::all().any(|p| p.pid == own && ProcStat::of(own).unwrap().group == p.group));
    }
}
