//! Processes of one measurement.

use std::io::{Read, Write};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use super::member::MemberReport;
use super::{BenchError, Member, Options};

/// Longest time until a member ends after it should.
const PATIENCE: Duration = Duration::from_secs(30);

/// Period of checks whether a member has ended.
const POLL_PERIOD: Duration = Duration::from_millis(5);

/// Running members; those still running when it is dropped are killed.
pub(super) struct Fleet {
    members: Vec<(String, Child)>,
}

impl Fleet {
    pub(super) fn start(
        options: &Options,
        members: impl IntoIterator<Item = (String, Member)>,
    ) -> Result<Self, BenchError> {
        let mut fleet = Self { members: Vec::new() };
        for (who, member) in members {
            let child = start(options, &member)
                .map_err(|source| BenchError::Process { what: format!("cannot start {who}"), source })?;
            fleet.members.push((who, child));
        }
        Ok(fleet)
    }

    /// Waits, unless a member ends early, which is a failure.
    pub(super) fn watch(&mut self, time: Duration) -> Result<(), BenchError> {
        let until = Instant::now() + time;
        while Instant::now() < until {
            if let Some(at) = self.members.iter_mut().position(|(_, c)| !matches!(c.try_wait(), Ok(None))) {
                let (who, child) = self.members.remove(at);
                member_report(&who, child)?;
                return Err(BenchError::Member { who, why: "it ended too early".into() });
            }
            std::thread::sleep(POLL_PERIOD);
        }
        Ok(())
    }

    /// Asks a member to terminate.
    pub(super) fn stop(&mut self, who: &str) {
        for (_, child) in self.members.iter().filter(|(name, _)| name == who) {
            // SAFETY: kill takes no pointer; the process is a child that was not waited for, so its number is its own.
            unsafe { libc::kill(child.id() as libc::pid_t, libc::SIGTERM) };
        }
    }

    /// Waits for a member's end and returns its report.
    pub(super) fn finish(&mut self, who: &str) -> Result<MemberReport, BenchError> {
        self.finish_within(who, PATIENCE)
    }

    /// Waits as [`Self::finish`], for a member that ends by itself within `time`.
    pub(super) fn finish_within(&mut self, who: &str, time: Duration) -> Result<MemberReport, BenchError> {
        let at = self.members.iter().position(|(name, _)| name == who).ok_or_else(|| BenchError::Member {
            who: who.into(),
            why: "it was not started, or is over".into(),
        })?;
        let until = Instant::now() + time;
        while matches!(self.members[at].1.try_wait(), Ok(None)) {
            if Instant::now() > until {
                let why = format!("it did not end within {} s", time.as_secs_f64());
                return Err(BenchError::Member { who: who.into(), why });
            }
            std::thread::sleep(POLL_PERIOD);
        }
        let (who, child) = self.members.remove(at);
        member_report(&who, child)
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        for (_, child) in &mut self.members {
            // It may have ended by itself already; it is gone afterwards in any case.
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

fn start(options: &Options, member: &Member) -> std::io::Result<Child> {
    let (program, arguments) = options
        .member
        .split_first()
        .ok_or_else(|| std::io::Error::other("no program was given that runs members"))?;
    let mut child = Command::new(program)
        .args(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()?;
    if let Some(mut stdin) = child.stdin.take() {
        stdin.write_all(&serde_json::to_vec(member)?)?;
    }
    Ok(child)
}

fn member_report(who: &str, mut child: Child) -> Result<MemberReport, BenchError> {
    let failed = |why: String| BenchError::Member { who: who.into(), why };
    let status = child.wait().map_err(|e| failed(e.to_string()))?;
    let (mut out, mut err) = (String::new(), String::new());
    if let Some(mut pipe) = child.stdout.take() {
        pipe.read_to_string(&mut out).map_err(|e| failed(e.to_string()))?;
    }
    if let Some(mut pipe) = child.stderr.take() {
        pipe.read_to_string(&mut err).map_err(|e| failed(e.to_string()))?;
    }
    if !status.success() {
        return Err(failed(format!("{status}: {}", err.trim())));
    }
    serde_json::from_str(&out).map_err(|e| failed(format!("it said \"{}\": {e}", out.trim())))
}
