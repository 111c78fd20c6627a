//! The guard of a bench: a process that outlives a killed launcher for as long as it takes to end what the launcher
//! started, and to tidy up after it.
//!
//! The kernel tells each node by SIGTERM that its launcher died (`PR_SET_PDEATHSIG`), so that actuators go to neutral; but
//! not what an `exec` node started itself, nor a node that hangs. The guard reads from a pipe which process groups there
//! are. The pipe's end without a word of farewell is the launcher's death, however it came. The guard also holds the
//! launcher's locks, so that nobody takes the bench's name or folder while nodes of the dead run are still at work, and
//! the pipes that programs write to: one that says something while it brings its actuators to neutral would be killed by
//! SIGPIPE if nobody could read it.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{File, OpenOptions};
use std::io::{self, BufRead, Read, Write};
use std::os::fd::{AsRawFd, BorrowedFd};
use std::os::unix::fs::OpenOptionsExt;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::time::{Duration, Instant};

use rustix::process::Signal;

use super::process::CommandLine;
use crate::proc_stat::HeldProcess;

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

/// Process groups that a launcher left behind, with the pipes that they write to.
#[derive(Debug, Default)]
pub(crate) struct LeftGroups(BTreeMap<i32, Vec<File>>);

/// The guard's side: reads orders to their end. Returns the groups that the launcher left behind when it died; `None` when
/// it took its leave.
pub(crate) fn keep_guard(orders: impl BufRead) -> Option<LeftGroups> {
    let mut groups = BTreeMap::new();
    for order in orders.lines().map_while(Result::ok) {
        if order == FAREWELL {
            return None;
        }
        let (sign, number) = order.split_at_checked(1).unwrap_or_default();
        match (sign, number.parse::<i32>()) {
            ("+", Ok(group)) => _ = groups.insert(group, pipes_of(group)),
            ("-", Ok(group)) => _ = groups.remove(&group),
            // The last line of a launcher that died while it wrote.
            _ => {}
        }
    }
    Some(LeftGroups(groups))
}

/// The reading ends of the pipes that a process has as standard output and error: the kernel opens a pipe anew by its name
/// below /proc (proc_pid_fd(5)).
fn pipes_of(pid: i32) -> Vec<File> {
    let open = |fd: i32| {
        let path = format!("/proc/{pid}/fd/{fd}");
        let is_pipe = std::fs::read_link(&path).is_ok_and(|to| to.to_string_lossy().starts_with("pipe:"));
        is_pipe.then(|| OpenOptions::new().read(true).custom_flags(libc::O_NONBLOCK).open(path).ok())?
    };
    [1, 2].into_iter().filter_map(open).collect()
}

impl LeftGroups {
    /// Ends the groups, and what left them and has its notify socket in the folder `sockets`: asks each process once, and kills
    /// what is still there after `grace`.
    pub fn end(mut self, sockets: Option<&Path>, grace: Duration) {
        let mut asked = BTreeSet::new();
        let vanished = self.until_vanished(sockets, grace, |process| {
            // Whoever was just being started, or was about to leave its group, is only found at a later look.
            if asked.insert(process.pid) {
                process.signal(Signal::TERM);
                // A stopped process hears only this.
                process.signal(Signal::CONT);
            }
        });
        if !vanished {
            self.until_vanished(sockets, VANISH, |process| process.signal(Signal::KILL));
        }
    }

    /// Does something to every process that is left, look by look; whether all of them are gone within this time.
    fn until_vanished(
        &mut self,
        sockets: Option<&Path>,
        limit: Duration,
        mut each: impl FnMut(&HeldProcess),
    ) -> bool {
        let until = Instant::now() + limit;
        loop {
            let mut is_left = false;
            let left = |p: &HeldProcess| {
                self.0.contains_key(&p.group) || sockets.is_some_and(|sockets| p.is_notifier(sockets))
            };
            for process in HeldProcess::all().filter(left) {
                is_left = true;
                each(&process);
            }
            if !is_left {
                return true;
            }
            if Instant::now() >= until {
                return false;
            }
            self.drain();
            std::thread::sleep(LOOK);
        }
    }

    /// Takes what was written to the pipes, so that nobody who writes has to wait.
    fn drain(&mut self) {
        // As much as a pipe holds, and no more: somebody may write without end.
        let mut taken = [0; 1 << 16];
        for pipe in self.0.values_mut().flatten() {
            // An error says that nothing is there.
            let _ = pipe.read(&mut taken);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pipe_tells_an_orderly_end_from_a_death_and_who_is_left() {
        let left =
            |orders: &str| keep_guard(orders.as_bytes()).map(|left| left.0.into_keys().collect::<Vec<_>>());
        assert_eq!(left("+7\n+8\n-7\nall ended\n"), None);
        assert_eq!(left("+7\n+8\n-7\n"), Some(vec![8]));
        assert_eq!(left(""), Some(vec![]));
        assert_eq!(left("+7\nall en"), Some(vec![7]));
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
        let group = stubborn.id() as i32;
        let began = Instant::now();
        LeftGroups(BTreeMap::from([(group, Vec::new())])).end(None, Duration::from_millis(200));
        assert!(began.elapsed() >= Duration::from_millis(200));
        assert!(!HeldProcess::all().any(|p| p.group == group));
        stubborn.wait().unwrap();
    }

    /// A program that reports on its way to neutral more than a pipe holds, after the launcher's end of the pipe is gone.
    #[test]
    fn a_program_may_still_write_when_its_launcher_is_dead() {
        let folder = tempfile::tempdir().unwrap();
        let neutral = folder.path().join("neutral");
        let script = "trap 'head -c 200000 /dev/zero; echo stopping >&2; : > \"$0\"; exit' TERM; echo ready; \
                      while :; do sleep 0.01; done";
        let mut program = Command::new("sh")
            .args(["-c", script])
            .arg(&neutral)
            .process_group(0)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut word = [0; 5];
        program.stdout.as_mut().unwrap().read_exact(&mut word).unwrap();
        // The guard keeps the pipes; the launcher's ends go with it.
        let group = program.id() as i32;
        let left = LeftGroups(BTreeMap::from([(group, pipes_of(group))]));
        assert_eq!(left.0[&group].len(), 2);
        (program.stdout, program.stderr) = (None, None);
        left.end(None, Duration::from_secs(20));
        program.wait().unwrap();
        assert!(neutral.exists(), "it was killed by what it wrote");
    }
}
