//! Which processes there are, as the kernel tells it (proc_pid_stat(5), proc_pid_environ(5)).

use std::os::fd::OwnedFd;
use std::path::Path;

use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open, pidfd_send_signal};

/// The variable by which whatever a node starts is known, also when it left the node's process group.
pub(crate) const NOTIFY_SOCKET: &str = "NOTIFY_SOCKET";

/// A process that has not ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct ProcStat {
    /// Its process group.
    pub group: i32,
}

impl ProcStat {
    /// A process by its number; `None` when there is none, or only a zombie that nobody has waited for.
    pub fn of(pid: i32) -> Option<Self> {
        Self::parse(&std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?)
    }

    /// The fields behind the name, which stands in brackets and may hold anything: state, parent, group.
    fn parse(stat: &str) -> Option<Self> {
        let (_, fields) = stat.rsplit_once(')')?;
        let mut fields = fields.split_whitespace();
        let state = fields.next()?;
        let group = fields.nth(1)?.parse().ok()?;
        (!matches!(state, "Z" | "X" | "x")).then_some(Self { group })
    }
}

/// A process that has not ended, held so that a signal reaches no other that got its number later.
#[derive(Debug)]
pub(crate) struct HeldProcess {
    /// Its number.
    pub pid: i32,
    /// Its process group.
    pub group: i32,
    handle: OwnedFd,
}

impl HeldProcess {
    /// All processes that this one may see.
    pub fn all() -> impl Iterator<Item = Self> {
        let numbers = std::fs::read_dir("/proc").into_iter().flatten().flatten();
        numbers.filter_map(|e| Self::of(Pid::from_raw(e.file_name().to_str()?.parse().ok()?)?))
    }

    fn of(pid: Pid) -> Option<Self> {
        // Held before the look, so that what is seen is of the process that is held.
        let handle = pidfd_open(pid, PidfdFlags::empty()).ok()?;
        let pid = pid.as_raw_pid();
        Some(Self { pid, group: ProcStat::of(pid)?.group, handle })
    }

    /// Whether its notify socket is this one, or in this folder: it was started by a node, or by what a node started, for as
    /// long as the variable is handed on.
    pub fn is_notifier(&self, socket: &Path) -> bool {
        let environment = std::fs::read(format!("/proc/{}/environ", self.pid)).unwrap_or_default();
        is_notifier(&environment, socket)
    }

    /// Sends a signal. A process that has just ended needs none.
    pub fn signal(&self, signal: Signal) {
        let _ = pidfd_send_signal(&self.handle, signal);
    }
}

/// Whether an environment, its entries ended by zeros, has a notify socket at or below this path.
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
