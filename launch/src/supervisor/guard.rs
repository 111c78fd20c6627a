//! The guard of a bench: a process that outlives a killed launcher for as long as it takes to end what the launcher
//! started, and to tidy up after it.
//!
//! The kernel tells each node by SIGTERM that its launcher died (`PR_SET_PDEATHSIG`), so that actuators go to neutral; but
//! not what an `exec` node started itself, nor a node that hangs. The guard reads from a pipe which process groups there
//! are. The pipe's end without a word of farewell is the launcher's death, however it came. The guard also holds the
//! launcher's locks, so that nobody takes the bench's name or folder while nodes of the dead run are still at work.

use std::collections::BTreeSet;
use std::io::{self, BufRead, Write};
use std::os::fd::{AsRawFd, BorrowedFd};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process_group};

use super::process::CommandLine;
use crate::proc_stat::{ProcStat, signal_notifiers};

/// What the launcher writes when all has ended in order.
const FAREWELL: &str = "all ended";

/// Time between two looks whether the nodes have ended.
const LOOK: Duration = Duration::from_millis(10);

/// How long a killed process may take to vanish.
const VANISH: Duration = Duration::from_secs(1);

/// The launcher's side of the guard.
#[derive(Debug)]
pub(crate) struct Guard {
    child: Child,
    orders: Option<ChildStdin>,
}

impl Guard {
    /// Starts the guard, which inherits `locks`.
    ///
    /// # Errors
    /// When the process cannot be started.
    pub fn start(line: &CommandLine, locks: &[BorrowedFd<'_>]) -> io::Result<Self> {
        let mut command = Command::new(&line.program);
        // A group of its own: Ctrl-C at the terminal is for the launcher.
        command.args(&line.arguments).process_group(0).stdin(Stdio::piped()).stdout(Stdio::null());
        let locks: Vec<_> = locks.iter().map(AsRawFd::as_raw_fd).collect();
        // SAFETY: between fork and exec only fcntl(2) and the making of an error without allocation happen, which are
        // async-signal-safe; the descriptors are open, because this function borrows them until the child runs.
        unsafe {
            command.pre_exec(move || {
                for &lock in &locks {
                    if libc::fcntl(lock, libc::F_SETFD, 0) != 0 {
                        return Err(io::Error::last_os_error());
                    }
                }
                Ok(())
            });
        }
        let mut child = command.spawn()?;
        let orders = child.stdin.take();
        Ok(Self { child, orders })
    }

    /// A process group that began.
    pub fn watch(&mut self, pid: u32) {
        self.say(&format!("+{pid}"));
    }

    /// A process group that has ended.
    pub fn forget(&mut self, pid: u32) {
        self.say(&format!("-{pid}"));
    }

    fn say(&mut self, order: &str) {
        // Somebody who kills the guard as well leaves the nodes to the kernel's SIGTERM.
        if let Some(Err(e)) = self.orders.as_mut().map(|pipe| writeln!(pipe, "{order}")) {
            tracing::debug!("the guard of the bench does not respond: {e}");
        }
    }
}

impl Drop for Guard {
    fn drop(&mut self) {
        self.say(FAREWELL);
        self.orders = None;
        let _ = self.child.wait();
    }
}

/// The guard's side: reads orders to their end. Returns the groups that the launcher left behind when it died; `None` when
/// it took its leave.
pub(crate) fn keep_guard(orders: impl BufRead) -> Option<BTreeSet<i32>> {
    let mut groups = BTreeSet::new();
    for order in orders.lines().map_while(Result::ok) {
        if order == FAREWELL {
            return None;
        }
        let (sign, number) = order.split_at_checked(1).unwrap_or_default();
        match (sign, number.parse::<i32>()) {
            ("+", Ok(group)) => _ = groups.insert(group),
            ("-", Ok(group)) => _ = groups.remove(&group),
            // The last line of a launcher that died while it wrote.
            _ => {}
        }
    }
    Some(groups)
}

/// Ends process groups, and what left them and has its notify socket in the folder `sockets`: asks them, and kills what is
/// still there after `grace`.
pub(crate) fn end_groups(groups: &BTreeSet<i32>, sockets: Option<&Path>, grace: Duration) {
    signal(groups, sockets, Signal::TERM);
    // A stopped process hears only this.
    signal(groups, sockets, Signal::CONT);
    if !vanished(groups, sockets, grace) {
        signal(groups, sockets, Signal::KILL);
        vanished(groups, sockets, VANISH);
    }
}

fn signal(groups: &BTreeSet<i32>, sockets: Option<&Path>, signal: Signal) {
    let alive: BTreeSet<_> = ProcStat::all().map(|p| p.group).collect();
    for group in groups.intersection(&alive).filter_map(|&group| Pid::from_raw(group)) {
        // A group that is already gone needs no signal.
        let _ = kill_process_group(group, signal);
    }
    if let Some(sockets) = sockets {
        signal_notifiers(sockets, |group| groups.contains(&group), Some(signal));
    }
}

/// Whether all of them are gone within this time.
fn vanished(groups: &BTreeSet<i32>, sockets: Option<&Path>, limit: Duration) -> bool {
    let until = Instant::now() + limit;
    let are_left = || {
        ProcStat::all().any(|p| groups.contains(&p.group))
            || sockets.is_some_and(|sockets| signal_notifiers(sockets, |_| false, None) > 0)
    };
    while are_left() {
        if Instant::now() >= until {
            return false;
        }
        std::thread::sleep(LOOK);
    }
    true
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;

    #[test]
    fn the_pipe_tells_an_orderly_end_from_a_death_and_who_is_left() {
        assert_eq!(keep_guard(&b"+7\n+8\n-7\nall ended\n"[..]), None);
        assert_eq!(keep_guard(&b"+7\n+8\n-7\n"[..]), Some(BTreeSet::from([8])));
        assert_eq!(keep_guard(&b""[..]), Some(BTreeSet::new()));
        assert_eq!(keep_guard(&b"+7\nall en"[..]), Some(BTreeSet::from([7])));
    }

    #[test]
    fn a_group_that_does_not_listen_is_killed_with_its_children() {
        let mut stubborn = Command::new("sh")
            .args(["-c", "trap '' TERM; echo deaf; sleep 1000 & wait; wait"])
            .process_group(0)
            .stdout(std::process::Stdio::piped())
            .spawn()
            .unwrap();
        let mut word = [0; 4];
        stubborn.stdout.as_mut().unwrap().read_exact(&mut word).unwrap();
        let groups = BTreeSet::from([stubborn.id() as i32]);
        let began = Instant::now();
        end_groups(&groups, None, Duration::from_millis(200));
        assert!(began.elapsed() >= Duration::from_millis(200));
        assert!(vanished(&groups, None, Duration::ZERO));
        stubborn.wait().unwrap();
    }
}
