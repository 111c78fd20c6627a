//! A bench in one thread of this process, supervised like one of several processes.

use std::io;
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use whirlstand_msgs::Health;

use super::signals::Signals;
use super::{Continuation, Ending, Event, HealthSource, HealthTable, NodeFailure, Observer, Outcome, TICK};

/// How long a thread that was asked to end may continue to compute. A step takes far less, but work before the
/// first step that does not check the flag, such as the design of a law for many states, can take any time.
const PATIENCE: Duration = Duration::from_secs(3);

/// How the thread ended: the last report of each node, or the failure and whether the user can correct it.
pub(crate) type ThreadEnd = Result<Vec<Health>, (String, bool)>;

/// Runs `body` in a thread of its own, calls `stop` on the first ending signal, and reads `health` meanwhile. A
/// second signal, or a silence of some seconds, abandons the thread; it then ends with the process.
///
/// # Errors
/// When the operating system refuses signals, threads or polling.
pub(crate) fn supervise_thread(
    body: impl FnOnce() -> ThreadEnd + Send + 'static,
    stop: impl Fn(),
    health: &mut dyn HealthSource,
    observer: &mut dyn Observer,
) -> io::Result<Outcome> {
    let mut signals = Signals::take()?;
    let started = Instant::now();
    // The end of the thread closes its side of the pair, which wakes the poll below.
    let (ended, open) = UnixStream::pair()?;
    let thread = std::thread::Builder::new().name("bench".into()).spawn(move || {
        let end = body();
        drop(open);
        end
    })?;
    let mut table = HealthTable::default();
    let mut interrupted = None;
    let mut last = None;
    while !thread.is_finished() && last.is_none_or(|last| Instant::now() < last) {
        let mut fds = [PollFd::new(&signals, PollFlags::IN), PollFd::new(&ended, PollFlags::IN)];
        let timeout = Timespec { tv_sec: 0, tv_nsec: TICK.as_nanos() as i64 };
        match poll(&mut fds, Some(&timeout)) {
            Ok(_) | Err(rustix::io::Errno::INTR) => {}
            Err(e) => return Err(e.into()),
        }
        while let Some(signal) = signals.next() {
            if interrupted.is_none() {
                interrupted = Some(signal);
                last = Some(Instant::now() + PATIENCE);
                observer.event(&Event::Ending(Ending::Interrupted(signal)));
                stop();
            } else {
                last = Some(Instant::now());
            }
        }
        let now = Instant::now();
        while let Some(report) = health.next() {
            table.update(report, now);
        }
        if observer.tick(now, &table) == Continuation::End {
            stop();
        }
    }
    let failed = |how: String, mendable: bool| {
        Ending::Failed(NodeFailure { node: "bench".into(), how, last_lines: Vec::new(), mendable })
    };
    let is_abandoned = interrupted.is_some() && !thread.is_finished();
    let ended = if is_abandoned { Ok(Ok(Vec::new())) } else { thread.join() };
    let ending = match ended {
        Ok(Ok(reports)) => {
            reports.into_iter().for_each(|report| table.update(report, Instant::now()));
            interrupted.map_or(Ending::Complete, Ending::Interrupted)
        }
        Ok(Err((error, mendable))) => failed(format!("failed: {error}"), mendable),
        Err(_) => failed("panicked".into(), false),
    };
    observer.event(&Event::Ending(ending.clone()));
    Ok(Outcome {
        ending,
        restarts: Vec::new(),
        killed_at_end: if is_abandoned { vec!["bench".into()] } else { Vec::new() },
        health: table,
        wall: started.elapsed(),
    })
}
