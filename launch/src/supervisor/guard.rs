//! The guard of a bench: a process that outlives a killed launcher until it has ended what the launcher started,
//! and removed its files.
//!
//! The kernel sends each node SIGTERM when its launcher dies (`PR_SET_PDEATHSIG`), so that actuators go to
//! neutral. This does not reach processes that an `exec` node started, nor a node that hangs. The guard learns the
//! process groups from a pipe. An end of the pipe without a farewell means that the launcher died, by whatever
//! cause. The guard also holds the launcher's locks, so that no other run takes the bench's name or folder while
//! nodes of the dead run are still working. It holds the pipes that programs write to as well: a program that
//! writes while it brings its actuators to neutral would be killed by SIGPIPE if no process could read the pipe.

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

/// Order that the launcher writes when all nodes have ended in order.
const FAREWELL: &str = "all ended";

/// Time between two checks whether the nodes have ended.
const LOOK: Duration = Duration::from_millis(10);

/// Longest time until a killed process disappears.
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
        // The guard has its own process group, because Ctrl-C at the terminal is meant for the launcher.
        command.args(&line.arguments).process_group(0).stdin(Stdio::piped()).stdout(Stdio::null());
        let locks: Vec<_> = locks.iter().map(AsRawFd::as_raw_fd).collect();
        // SAFETY: between fork and exec only fcntl(2) and the construction of an error without allocation happen,
        // which are async-signal-safe; the descriptors are open, because this function borrows them until the
        // child runs.
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

    /// Tells the guard of a process group that has started.
    pub fn watch(&mut self, pid: u32) {
        self.say(&format!("+{pid}"));
    }

    /// Tells the guard of a process group that has ended.
    pub fn forget(&mut self, pid: u32) {
        self.say(&format!("-{pid}"));
    }

    fn say(&mut self, order: &str) {
        // If the guard has been killed too, only the kernel's SIGTERM ends the nodes.
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

/// The guard's side: reads orders to their end. Returns the groups that the launcher left behind when it died;
/// `None` when the launcher sent its farewell.
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
            // An incomplete last line of a launcher that died while writing.
            _ => {}
        }
    }
    Some(LeftGroups(groups))
}

/// Opens the reading ends of the pipes that a process has as standard output and error: the kernel opens a pipe
/// again by its name below /proc (proc_pid_fd(5)).
fn pipes_of(pid: i32) -> Vec<File> {
    let open = |fd: i32| {
        let path = format!("/proc/{pid}/fd/{fd}");
        let is_pipe = std::fs::read_link(&path).is_ok_and(|to| to.to_string_lossy().starts_with("pipe:"));
        is_pipe.then(|| OpenOptions::new().read(true).custom_flags(libc::O_NONBLOCK).open(path).ok())?
    };
    [1, 2].into_iter().filter_map(open).collect()
}

/// Number of the process that was created last (proc_loadavg(5)): numbers rise. The greatest where it is not known.
fn newest_pid() -> i32 {
    let load = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    load.split_whitespace().last().and_then(|pid| pid.parse().ok()).unwrap_or(i32::MAX)
}

impl LeftGroups {
    /// Ends the groups, and the processes that left them and have their notify socket in the folder `sockets`.
    /// Each process is asked once; those that remain after `grace` are killed.
    pub fn end(mut self, sockets: Option<&Path>, grace: Duration) {
        let mut asked = BTreeSet::new();
        // What a program starts on its way to neutral is to do its work.
        let newest = newest_pid();
        let vanished = self.until_vanished(sockets, grace, |process| {
            // A process that was just being started, or was leaving its group, is found only in a later pass.
            if process.pid <= newest && asked.insert(process.pid) {
                process.signal(Signal::TERM);
                // A stopped process reacts only after this signal.
                process.signal(Signal::CONT);
            }
        });
        if !vanished {
            self.until_vanished(sockets, VANISH, |process| process.signal(Signal::KILL));
        }
    }

    /// Applies an action to every remaining process, pass by pass. Returns whether all of them have ended within
    /// the given time.
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

    /// Reads the pipes, so that no writing process blocks.
    fn drain(&mut self) {
        // At most the capacity of a pipe is read: a program may write without end.
        let mut taken = [0; 1 << 16];
        for pipe in self.0.values_mut().flatten() {
            // An error means that the pipe is empty.
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

    /// A program that, on its way to neutral, writes more than a pipe holds after the launcher's end of the pipe
    /// is closed.
    #[test]
    fn a_program_may_still_write_when_its_launcher_is_dead() {
        let folder = tempfile::tempdir().unwrap();
        let neutral = folder.path().join("neutral");
        let script = "trap 'echo stopping >&2; sh -c \"head -c 200000 /dev/zero && sleep 0.1 && : > $0\"; exit' TERM; \
                      echo ready; while :; do sleep 0.01; done";
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
        // The guard keeps the pipes; the launcher's ends are closed with it.
        let group = program.id() as i32;
        let left = LeftGroups(BTreeMap::from([(group, pipes_of(group))]));
        assert_eq!(left.0[&group].len(), 2);
        (program.stdout, program.stderr) = (None, None);
        left.end(None, Duration::from_secs(20));
        program.wait().unwrap();
        assert!(neutral.exists(), "it was killed by what it wrote");
    }
}
