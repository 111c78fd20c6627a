//! Runs `whirlstand` as a user would: real processes with a deadline, killed as a group when they hang.

// Every test file compiles this module for itself and uses its own part of it.
#![allow(dead_code, reason = "shared by test files that each use a part")]

pub mod bench;
pub mod bridged;
pub mod devtools;
pub mod flight;
pub mod flood;
pub mod foreign;
pub mod gusts;
pub mod mavlink;
pub mod mirrored;
pub mod page;
pub mod radio;
pub mod relay;
pub mod terminal;

use std::io::{BufRead, BufReader, Read};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use serde_json::Value;
use terminal::{Screen, Terminal};
use wait_timeout::ChildExt;

/// Longest time that one run may take before it counts as hung.
pub const HUNG: Duration = Duration::from_secs(120);

/// Setting for `--set` that allows the failsafe and misses of a run with injected faults, or with a slow
/// foreign program.
pub const FAULTS_ALLOWED: &str = "expect={max_failsafe_share=1, max_disarmed_share=1, max_pilot_share=1, max_failsafe_at_end=1e9, max_refused_commands=1e9, \
                                  max_rejected=1e9, max_restarts=1e9}";

/// Pause between two looks at something whose change no event tells. Looking all the time would take a processor from what
/// is waited for.
const LOOK: Duration = Duration::from_millis(5);

/// Looks until `holds` returns true, at most [`HUNG`].
#[track_caller]
pub fn until(failure: &str, mut holds: impl FnMut() -> bool) {
    let limit = Instant::now() + HUNG;
    while !holds() {
        assert!(Instant::now() < limit, "{failure}");
        std::thread::sleep(LOOK);
    }
}

/// Result of a finished command.
#[derive(Debug)]
pub struct Finished {
    pub status: ExitStatus,
    pub stdout: String,
    pub stderr: String,
}

impl Finished {
    /// Exit code; a signal counts as 128 + its number, as in a shell.
    pub fn code(&self) -> i32 {
        self.status.code().unwrap_or_else(|| 128 + self.status.signal().unwrap_or(0))
    }

    /// This result, after checking that the command ended well.
    #[track_caller]
    pub fn success(self) -> Self {
        assert_eq!(self.code(), 0, "stdout:\n{}\nstderr:\n{}", self.stdout, self.stderr);
        self
    }
}

/// Runs a call that fails with an error that the user can correct; the message must contain all of `words`.
#[track_caller]
pub fn refused(args: &[&str], words: &[&str]) {
    let result = run(args);
    assert_eq!(result.code(), 2, "{args:?}\n{}\n{}", result.stdout, result.stderr);
    for word in words {
        assert!(result.stderr.contains(word), "{args:?}: {word:?} is missing in:\n{}", result.stderr);
    }
    assert!(!result.stderr.contains("panicked"), "{}", result.stderr);
}

/// A running command in a process group of its own; when it is dropped, the whole group is killed.
pub struct Running {
    child: Child,
    stdout: Receiver<String>,
    stderr: Receiver<String>,
    /// Lines of standard error as they arrive.
    pub stderr_lines: Receiver<String>,
    shown: String,
}

impl Running {
    pub fn pid(&self) -> i32 {
        self.child.id() as i32
    }

    /// Sends a signal to the command alone, not to its children.
    pub fn signal(&self, signal: i32) {
        // SAFETY: kill(2) on a child that is not yet reaped touches no memory of ours.
        let result = unsafe { libc::kill(self.pid(), signal) };
        assert_eq!(result, 0, "kill({}, {signal})", self.pid());
    }

    /// Waits until the command has installed its handlers, after which a signal ends its search. It registers
    /// SIGTERM last: bit 14 of the mask of caught signals in proc_pid_status(5).
    #[track_caller]
    pub fn wait_for_handlers(&self) {
        until("a process handles no SIGTERM", || {
            let status =
                std::fs::read_to_string(format!("/proc/{}/status", self.pid())).expect("a running process");
            let caught = status.lines().find_map(|l| l.strip_prefix("SigCgt:")).expect("a mask");
            let caught = u64::from_str_radix(caught.trim(), 16).expect("hexadecimal");
            caught & (1 << (libc::SIGTERM - 1)) != 0
        });
    }

    /// Whether the command still runs.
    pub fn is_alive(&mut self) -> bool {
        self.child.try_wait().expect("ask for the end of the command").is_none()
    }

    /// Waits for a line of standard error that contains `text`. Fails with the lines so far when the command ends
    /// or hangs.
    #[track_caller]
    pub fn wait_for_stderr(&mut self, text: &str) -> String {
        self.wait_for_stderr_of(&[text])
    }

    /// As [`Running::wait_for_stderr`], for a line that contains any of `texts`.
    #[track_caller]
    pub fn wait_for_stderr_of(&mut self, texts: &[&str]) -> String {
        let until = Instant::now() + HUNG;
        while let Ok(line) = self.stderr_lines.recv_timeout(until.saturating_duration_since(Instant::now())) {
            let found = texts.iter().any(|text| line.contains(text));
            self.shown.push_str(&line);
            self.shown.push('\n');
            if found {
                return line;
            }
        }
        panic!("no line with {texts:?} in:\n{}", self.shown);
    }

    /// Waits for the end, at most [`HUNG`].
    #[track_caller]
    pub fn finish(self) -> Finished {
        self.finish_within(HUNG)
    }

    #[track_caller]
    pub fn finish_within(mut self, limit: Duration) -> Finished {
        let status = self.child.wait_timeout(limit).expect("wait for the command");
        let Some(status) = status else {
            self.kill_group();
            let (out, err) = (self.stdout.recv().unwrap_or_default(), self.stderr.recv().unwrap_or_default());
            panic!("hung for {limit:?} and was killed\nstdout:\n{out}\nstderr:\n{err}");
        };
        Finished {
            status,
            stdout: self.stdout.recv_timeout(HUNG).expect("standard output closes"),
            stderr: self.stderr.recv_timeout(HUNG).expect("standard error closes"),
        }
    }

    fn kill_group(&mut self) {
        // SAFETY: kill(2) touches no memory of ours; the group is the one that `spawn` made for this child.
        unsafe { libc::kill(-self.pid(), libc::SIGKILL) };
        let _ = self.child.wait();
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.kill_group();
        if std::thread::panicking() {
            // The output of another command often explains why one command waited in vain.
            let said: Vec<String> = self.stderr_lines.try_iter().collect();
            eprintln!("process {} had said:\n{}{}", self.pid(), self.shown, said.join("\n"));
        }
    }
}

/// The `whirlstand` command with arguments.
pub fn whirlstand<S: AsRef<std::ffi::OsStr>>(args: impl IntoIterator<Item = S>) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_whirlstand"));
    command.args(args).env("NO_COLOR", "1");
    command
}

/// Starts a command in its own process group, with both outputs collected.
#[track_caller]
pub fn spawn(command: Command) -> Running {
    start(command, Stdio::null(), Stdio::piped(), None)
}

/// Starts two commands, with the output of the second as the standard input of the first.
#[track_caller]
pub fn spawn_listening(listener: Command, speaker: Command) -> (Running, Running) {
    let mut listener = start(listener, Stdio::piped(), Stdio::piped(), None);
    let words = listener.child.stdin.take().expect("piped");
    (listener, start(speaker, Stdio::null(), words.into(), None))
}

/// As [`spawn_listening`], with the second command on a terminal, where somebody types `typed`: its standard error
/// is what the terminal shows.
#[track_caller]
pub fn spawn_listening_to_terminal(listener: Command, speaker: Command, typed: &str) -> (Running, Running) {
    let mut listener = start(listener, Stdio::piped(), Stdio::piped(), None);
    let words = listener.child.stdin.take().expect("piped");
    let Terminal { screen, stdin, stderr } = Terminal::typed(typed);
    (listener, start(speaker, stdin, words.into(), Some((screen, stderr))))
}

/// Starts a command; `terminal` is its standard error and what it shows, a pipe when absent.
#[track_caller]
fn start(mut command: Command, stdin: Stdio, stdout: Stdio, terminal: Option<(Screen, Stdio)>) -> Running {
    let (screen, stderr) = terminal.map_or((None, Stdio::piped()), |(screen, stderr)| (Some(screen), stderr));
    let mut child = command
        .process_group(0)
        .stdin(stdin)
        .stdout(stdout)
        .stderr(stderr)
        .spawn()
        .unwrap_or_else(|e| panic!("{command:?} does not start: {e}"));
    let (out_tx, stdout) = channel();
    let (err_tx, stderr) = channel();
    let (line_tx, stderr_lines) = channel();
    let out = child.stdout.take();
    std::thread::spawn(move || {
        let mut text = Vec::new();
        let _ = out.map(|mut out| out.read_to_end(&mut text));
        let _ = out_tx.send(String::from_utf8_lossy(&text).into_owned());
    });
    // The terminal ends when no process has it open any more.
    drop(command);
    let err: Box<dyn Read + Send> = match screen {
        Some(screen) => Box::new(screen),
        None => Box::new(child.stderr.take().expect("piped")),
    };
    let err = BufReader::new(err);
    std::thread::spawn(move || {
        let mut text = String::new();
        for line in err.lines().map_while(Result::ok) {
            text.push_str(&line);
            text.push('\n');
            let _ = line_tx.send(line);
        }
        let _ = err_tx.send(text);
    });
    Running { child, stdout, stderr, stderr_lines, shown: String::new() }
}

/// Runs `whirlstand` to its end.
#[track_caller]
pub fn run<S: AsRef<std::ffi::OsStr>>(args: impl IntoIterator<Item = S>) -> Finished {
    spawn(whirlstand(args)).finish()
}

/// Reads a JSON file.
#[track_caller]
pub fn json(path: impl AsRef<Path>) -> Value {
    let path = path.as_ref();
    let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Lines that a stand-in read from its standard input, according to its report.
#[track_caller]
pub fn said(report: &Path) -> Vec<String> {
    let report = json(report);
    let lines = report["said"].as_array().unwrap_or_else(|| panic!("nothing heard: {report}"));
    lines.iter().filter_map(|l| l.as_str().map(String::from)).collect()
}
