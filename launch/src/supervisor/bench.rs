//! The event loop over all nodes of a bench.

use std::io;
use std::os::fd::AsFd;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use whirlstand_msgs::Health;

use super::node::{Node, Phase, duration_text};
use super::notify::Notice;
use super::signals::Signals;
use super::{
    BenchSpec, Continuation, Ending, Event, Guard, HealthSource, HealthTable, Observer, Outcome, StopStage,
    TICK,
};

/// Delay of the launcher's own loop that shows that the launcher was stopped or starved; a silence of nodes
/// then has no meaning.
const STARVED: Duration = Duration::from_secs(1);

/// Runs the nodes of a bench to their end.
///
/// No process is left behind: every return path kills the processes that are still alive, and `guard` does so when
/// the launcher itself is killed.
///
/// # Errors
/// When the operating system refuses signals, sockets or polling; a failing node is not an error but an
/// [`Outcome`].
pub(crate) fn supervise(
    spec: BenchSpec,
    guard: Option<Guard>,
    health: &mut dyn HealthSource,
    observer: &mut dyn Observer,
) -> io::Result<Outcome> {
    let signals = Signals::take()?;
    let started = Instant::now();
    let nodes = spec.nodes.iter().cloned().map(Node::new).collect();
    let mut bench = Bench {
        spec,
        nodes,
        guard,
        signals,
        health,
        observer,
        table: HealthTable::default(),
        ending: None,
        stage: StopStage::First,
        killed_at_end: Vec::new(),
        updated: started,
        not_silent_before: started,
        strange_health: false,
    };
    loop {
        bench.start_waiting(Instant::now());
        if bench.is_over() {
            break;
        }
        bench.wait()?;
        bench.update(Instant::now());
    }
    Ok(Outcome {
        ending: bench.ending.unwrap_or(Ending::Complete),
        restarts: bench
            .nodes
            .iter()
            .filter(|n| n.restarts > 0)
            .map(|n| (n.spec.name.clone(), n.restarts))
            .collect(),
        killed_at_end: bench.killed_at_end,
        health: bench.table,
        wall: started.elapsed(),
    })
}

struct Bench<'a> {
    spec: BenchSpec,
    // The nodes are dropped before their guard is dismissed.
    nodes: Vec<Node>,
    guard: Option<Guard>,
    signals: Signals,
    health: &'a mut dyn HealthSource,
    observer: &'a mut dyn Observer,
    table: HealthTable,
    /// How the run ends; set once it is ending.
    ending: Option<Ending>,
    /// Nodes of this stage and of earlier ones have been asked to end.
    stage: StopStage,
    killed_at_end: Vec<String>,
    updated: Instant,
    /// Earliest time from which silence of a node counts.
    not_silent_before: Instant,
    /// Whether a `Health` that no node of the bench sent has been reported to the user.
    strange_health: bool,
}

impl Bench<'_> {
    fn is_over(&self) -> bool {
        self.ending.is_some() && self.nodes.iter().all(|n| !n.is_alive())
    }

    /// Starts the waiting nodes. Over a network they are started one after the other, because each is given the
    /// addresses of the others.
    fn start_waiting(&mut self, now: Instant) {
        for i in 0..self.nodes.len() {
            if self.ending.is_some() {
                return;
            }
            if self.nodes[i].phase != Phase::Waiting {
                continue;
            }
            if self.spec.exchange_locators && self.nodes.iter().any(|n| matches!(n.phase, Phase::Starting(_)))
            {
                return;
            }
            let connect = if self.spec.exchange_locators { self.locators() } else { Vec::new() };
            let node = &mut self.nodes[i];
            let name = node.spec.name.clone();
            match node.start(&self.spec.folder, &connect, now) {
                Ok(pid) => {
                    if let Some(guard) = &mut self.guard {
                        guard.watch(pid);
                    }
                    self.observer.event(&Event::Started { node: name, pid });
                    if self.nodes[i].phase == Phase::Starting(None) {
                        self.ready(i, now);
                    }
                }
                Err(e) => {
                    let program = node.spec.command.program.to_string_lossy().into_owned();
                    let failure = node.failure(format!("could not be started: {program}: {e}"), true);
                    self.end(Ending::Failed(failure), now);
                }
            }
        }
    }

    fn locators(&self) -> Vec<String> {
        let mut all = self.health.locators();
        all.extend(self.nodes.iter().filter(|n| n.is_alive()).flat_map(|n| n.locators.iter().cloned()));
        all
    }

    /// Sleeps until an event occurs, at most one [`TICK`].
    fn wait(&self) -> io::Result<()> {
        let now = Instant::now();
        let deadline = self.nodes.iter().filter_map(Node::deadline).min();
        let longest = deadline.map_or(TICK, |d| d.saturating_duration_since(now).min(TICK));
        let mut fds = vec![PollFd::new(&self.signals, PollFlags::IN)];
        for process in self.nodes.iter().filter_map(|n| n.process.as_ref()) {
            fds.push(PollFd::from_borrowed_fd(process.ended(), PollFlags::IN));
            fds.push(PollFd::from_borrowed_fd(process.notify.as_fd(), PollFlags::IN));
            // A closed pipe stays readable forever, so it is not polled.
            for console in [&process.stdout, &process.stderr] {
                if console.is_open() {
                    fds.push(PollFd::from_borrowed_fd(console.as_fd(), PollFlags::IN));
                }
            }
        }
        let timeout = Timespec { tv_sec: longest.as_secs() as i64, tv_nsec: longest.subsec_nanos().into() };
        match poll(&mut fds, Some(&timeout)) {
            Ok(_) | Err(rustix::io::Errno::INTR) => Ok(()),
            Err(e) => Err(e.into()),
        }
    }

    fn update(&mut self, now: Instant) {
        if now.duration_since(self.updated) > STARVED {
            self.not_silent_before = now;
        }
        self.updated = now;
        while let Some(signal) = self.signals.next() {
            self.interrupted(signal, now);
        }
        while let Some(health) = self.health.next() {
            self.hear(health, now);
        }
        for i in 0..self.nodes.len() {
            for notice in self.nodes[i].notices() {
                match notice {
                    Notice::Ready if matches!(self.nodes[i].phase, Phase::Starting(_)) => self.ready(i, now),
                    Notice::Status(text) => {
                        self.observer.event(&Event::Status { node: self.nodes[i].spec.name.clone(), text });
                    }
                    Notice::Ready | Notice::Locator(_) => {}
                }
            }
            self.repeat_lines(i, now, false);
            self.bury(i, now);
            self.check_deadlines(i, now);
        }
        self.next_stage(now);
        if self.observer.tick(now, &self.table) == Continuation::End {
            self.end(Ending::Complete, now);
        }
    }

    /// Takes in a `Health` report if it comes from the node that it names: a report in another's name could
    /// have that node killed.
    fn hear(&mut self, health: Health, now: Instant) {
        let name = health.node_name();
        let own = match self.nodes.iter().find(|n| n.spec.name == name) {
            Some(node) => node.is_own(&health),
            None => self.spec.external.iter().any(|external| external == name),
        };
        if own {
            self.table.update(health, now);
        } else if !std::mem::replace(&mut self.strange_health, true) {
            tracing::warn!(
                "a Health message named '{name}' came from process {}, which is not that node: it and all others \
                 like it are ignored",
                health.pid
            );
        }
    }

    fn ready(&mut self, i: usize, now: Instant) {
        let node = &mut self.nodes[i];
        node.phase = Phase::Running;
        node.ready_since = Some(now);
        let event = Event::Ready { node: node.spec.name.clone(), pid: node.pid() };
        self.observer.event(&event);
        if self.spec.exchange_locators {
            self.health.reachable(&self.locators());
        }
    }

    fn repeat_lines(&mut self, i: usize, now: Instant, ended: bool) {
        for line in self.nodes[i].lines(now, ended) {
            self.observer.line(&self.nodes[i].spec.name, &line);
        }
    }

    /// Handles a signal: the first one ends the run in order, the second one at once.
    fn interrupted(&mut self, signal: i32, now: Instant) {
        if self.ending.is_none() {
            self.end(Ending::Interrupted(signal), now);
            return;
        }
        for node in &mut self.nodes {
            node.kill("was killed by a second signal to the launcher".into());
        }
    }

    /// Handles the end of a process.
    fn bury(&mut self, i: usize, now: Instant) {
        let Some(end) = self.nodes[i].reap() else { return };
        self.repeat_lines(i, now, true);
        let pid = self.nodes[i].pid();
        self.nodes[i].release();
        if let Some(guard) = &mut self.guard {
            guard.forget(pid);
        }
        let asked = matches!(self.nodes[i].phase, Phase::Stopping(_));
        let node = &mut self.nodes[i];
        node.phase = Phase::Ended;
        if !end.well {
            self.health.node_died();
        }
        if self.ending.is_some() {
            // The observer has already been told of the nodes that had to be killed.
            if asked && !end.well && !self.killed_at_end.contains(&self.nodes[i].spec.name) {
                let node = &self.nodes[i];
                tracing::warn!("{} {} after it was asked to end", node.spec.name, end.how);
            }
            return;
        }
        if end.well && node.spec.ends_run {
            self.end(Ending::Complete, now);
        } else if end.well && !node.spec.needed {
            tracing::info!("{} is done", node.spec.name);
        } else if !end.before_ready && !end.last && node.restarts < node.spec.max_restarts {
            node.restarts += 1;
            node.phase = Phase::Waiting;
            let event = Event::Restarted {
                node: node.spec.name.clone(),
                how: end.how,
                attempt: node.restarts,
                allowed: node.spec.max_restarts,
            };
            self.observer.event(&event);
        } else {
            let how = match node.restarts {
                0 => end.how,
                n => format!("{}, after {n} restarts", end.how),
            };
            let failure = node.failure(how, end.mendable);
            self.end(Ending::Failed(failure), now);
        }
    }

    fn check_deadlines(&mut self, i: usize, now: Instant) {
        let silent = self.silence(i, now);
        let node = &mut self.nodes[i];
        if node.is_condemned() || !node.is_alive() {
            return;
        }
        match node.phase {
            Phase::Starting(Some(limit)) if now >= limit => {
                let waited = match node.spec.readiness {
                    super::Readiness::Notify(limit) => duration_text(limit),
                    super::Readiness::Start => duration_text(Duration::ZERO),
                };
                node.kill(format!(
                    "was not ready within {waited} (a program that does not send READY=1 to NOTIFY_SOCKET needs \
                     `ready = \"start\"` in the launch file)"
                ));
            }
            Phase::Running if silent > node.spec.hang_timeout => {
                node.kill(format!(
                    "hung: no Health for {}, it was killed",
                    duration_text(node.spec.hang_timeout)
                ));
            }
            Phase::Stopping(limit) if now >= limit => {
                let event =
                    Event::KilledAtEnd { node: node.spec.name.clone(), after: node.spec.stop_timeout };
                node.kill(format!(
                    "was killed {} after it was asked to end",
                    duration_text(node.spec.stop_timeout)
                ));
                self.killed_at_end.push(node.spec.name.clone());
                self.observer.event(&event);
            }
            _ => {}
        }
    }

    /// Time for which a running node has sent no `Health`; zero for programs that never send it.
    fn silence(&self, i: usize, now: Instant) -> Duration {
        let node = &self.nodes[i];
        let latest =
            self.table.get(&node.spec.name).filter(|h| h.latest.pid == node.pid()).map(|h| h.received_at);
        if latest.is_none() && !node.spec.publishes_health {
            return Duration::ZERO;
        }
        let last = latest.max(node.ready_since).unwrap_or(now).max(self.not_silent_before);
        now.saturating_duration_since(last)
    }

    fn end(&mut self, ending: Ending, now: Instant) {
        if self.ending.is_some() {
            return;
        }
        self.observer.event(&Event::Ending(ending.clone()));
        self.ending = Some(ending);
        self.stage = StopStage::First;
        self.ask_stage(now);
    }

    fn ask_stage(&mut self, now: Instant) {
        for node in self.nodes.iter_mut().filter(|n| n.spec.stop_stage <= self.stage) {
            node.ask_to_end(now);
        }
    }

    /// Goes to the next stage when all nodes of the stages so far have ended.
    fn next_stage(&mut self, now: Instant) {
        while self.ending.is_some() {
            let waiting = self.nodes.iter().any(|n| n.spec.stop_stage <= self.stage && n.is_alive());
            self.stage = match self.stage {
                _ if waiting => return,
                StopStage::First => StopStage::Second,
                StopStage::Second => StopStage::Last,
                StopStage::Last => return,
            };
            self.ask_stage(now);
        }
    }
}
