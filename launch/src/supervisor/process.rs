//! One running process of a node: started in its own group, watched by file descriptors, never left behind.

use std::io::{self, Write};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, Command, ExitStatus, Stdio};

use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open};

use super::console::ConsoleReader;
use super::notify::NotifySocket;
use crate::proc_stat::{HeldProcess, NOTIFY_SOCKET};

/// A program to start.
#[derive(Debug, Clone)]
pub(crate) struct CommandLine {
    /// Program.
    pub program: std::ffi::OsString,
    /// Arguments.
    pub arguments: Vec<std::ffi::OsString>,
    /// Environment variables added to the launcher's own.
    pub env: Vec<(String, String)>,
    /// Text for standard input; `None` gives an empty standard input.
    pub stdin: Option<String>,
}

/// A running process.
#[derive(Debug)]
pub(crate) struct Process {
    child: Child,
    pid: Pid,
    pidfd: OwnedFd,
    pub notify: NotifySocket,
    pub stdout: ConsoleReader,
    pub stderr: ConsoleReader,
}

impl Process {
    /// Starts a process in a group of its own. The kernel asks it to end when the launcher dies: if it were killed
    /// at once, it could not bring its actuators to neutral. [`super::guard`] ends processes that ignore the
    /// request.
    ///
    /// # Errors
    /// When the program cannot be started.
    pub fn start(line: &CommandLine, notify: NotifySocket) -> io::Result<Self> {
        let launcher = std::process::id();
        let mut command = Command::new(&line.program);
        command
            .args(&line.arguments)
            .envs(line.env.iter().map(|(k, v)| (k, v)))
            .env(NOTIFY_SOCKET, notify.path())
            .process_group(0)
            .stdin(if line.stdin.is_some() { Stdio::piped() } else { Stdio::null() })
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        // SAFETY: between fork and exec only prctl(2), getppid(2) and the construction of an error without
        // allocation happen, all of them async-signal-safe.
        unsafe {
            command.pre_exec(move || {
                if libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGTERM) != 0 {
                    return Err(io::Error::last_os_error());
                }
                // The launcher may have died before the preceding line.
                if libc::getppid() as u32 != launcher {
                    return Err(io::Error::from_raw_os_error(libc::ESRCH));
                }
                Ok(())
            });
        }
        let mut child = command.spawn()?;
        let piped = Self::pipes(&mut child);
        let (pid, pidfd, stdout, stderr) = match piped {
            Ok(parts) => parts,
            Err(e) => {
                let _ = child.kill();
                let _ = child.wait();
                return Err(e);
            }
        };
        let mut process = Self { child, pid, pidfd, notify, stdout, stderr };
        process.feed(line.stdin.as_deref())?;
        Ok(process)
    }

    fn pipes(child: &mut Child) -> io::Result<(Pid, OwnedFd, ConsoleReader, ConsoleReader)> {
        let missing = || io::Error::other("a standard stream is not piped");
        let pid = Pid::from_child(child);
        let pidfd = pidfd_open(pid, PidfdFlags::empty())?;
        let stdout = ConsoleReader::new(child.stdout.take().ok_or_else(missing)?.into())?;
        let stderr = ConsoleReader::new(child.stderr.take().ok_or_else(missing)?.into())?;
        Ok((pid, pidfd, stdout, stderr))
    }

    /// Writes the text to standard input. If a process ends without reading it, its exit status reports that.
    fn feed(&mut self, text: Option<&str>) -> io::Result<()> {
        if let (Some(text), Some(mut stdin)) = (text, self.child.stdin.take()) {
            let text = text.to_string();
            // A text longer than the pipe's capacity would block until the child reads it.
            std::thread::Builder::new().spawn(move || {
                let _ = stdin.write_all(text.as_bytes());
            })?;
        }
        Ok(())
    }

    /// Process number.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// A descriptor that becomes readable when the process has ended.
    pub fn ended(&self) -> BorrowedFd<'_> {
        self.pidfd.as_fd()
    }

    /// The exit status, once the process has ended.
    pub fn status(&mut self) -> Option<ExitStatus> {
        self.child.try_wait().ok().flatten()
    }

    /// Sends a signal to the whole group and to the processes that left it (setsid(2)), so that descendants are
    /// reached too.
    pub fn signal(&self, signal: Signal) {
        // A group that has already ended needs no signal.
        let _ = rustix::process::kill_process_group(self.pid, signal);
        let group = self.pid.as_raw_pid();
        HeldProcess::all()
            .filter(|p| p.group != group && p.is_notifier(self.notify.path()))
            .for_each(|p| p.signal(signal));
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.signal(Signal::KILL);
        let _ = self.child.wait();
    }
}

/// How a process ended, as text.
pub(crate) fn ending(status: ExitStatus) -> String {
    match (status.code(), status.signal()) {
        (Some(code), _) => format!("ended with exit code {code}"),
        (None, Some(signal)) => {
            let name = signal_hook::low_level::signal_name(signal).unwrap_or("an unknown signal");
            let why = if signal == libc::SIGBUS { ", most likely because /dev/shm was full" } else { "" };
            format!("was ended by {name} (signal {signal}){why}")
        }
        (None, None) => format!("ended: {status}"),
    }
}
