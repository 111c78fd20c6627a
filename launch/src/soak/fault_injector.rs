//! Injects faults into a bench at random times and observes its recovery.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use whirlstand_bus::{Bus, OpenError, Subscriber};
use whirlstand_msgs::{Truth, flags};
use whirlstand_nodes::config::{NodeConfig, Role};
use whirlstand_vehicle::Stream;

use super::fault::{FORGED, FaultKind, Ongoing};
use crate::supervisor::{Continuation, Ending, Event, HealthTable, Observer};

/// Number of consecutive commands in time that make a recovery.
pub(super) const CALM_STEPS: u64 = 50;

/// Longest time from a fault to the recovery; a longer one counts as a hang.
const HANG: Duration = Duration::from_secs(30);

/// Time between a recovery and the next fault.
const REST_S: (f64, f64) = (0.05, 0.8);

/// Queue length for the plant's truth, between two reads by the launcher.
const TRUTH_DEPTH: usize = 1024;

/// One fault and its consequences.
#[derive(Debug, Clone, Serialize)]
pub(super) struct InjectedFault {
    /// Name of the node, or `bench`.
    pub node: String,
    /// Wall-clock time of the run, s.
    pub at_s: f64,
    /// Time from the fault until the node was ready again, s; null for a node that was not restarted.
    pub restart_s: Option<f64>,
    /// Time from the fault, or from the end of a lasting fault, until the loop had recovered, s; null when it
    /// did not recover.
    pub recovery_s: Option<f64>,
    /// Amount of the fault: messages sent, bytes of the disk taken, processors kept busy; 1 for a fault without a
    /// measure.
    pub dealt: u64,
    /// Steps that held an old command before the failsafe; null when there was no failsafe.
    pub held_before_failsafe: Option<u64>,
    /// What went wrong; `None` when the bench recovered.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub problem: Option<String>,
}

enum Phase {
    /// The bench is recovering from its start, or from a fault.
    Recovering { since: Instant },
    /// The bench flies; the next fault comes at the time `until`.
    Resting { until: Instant },
    /// A fault has begun but has no effect yet: a sender has to connect first.
    Beginning { until: Instant, fault: Box<dyn Ongoing> },
    /// A fault lasts until this time.
    Lasting { until: Instant, fault: Box<dyn Ongoing> },
    /// All faults are done, or the bench did not recover from one.
    Done,
}

/// Observes a run and injects faults into it.
pub(super) struct FaultInjector {
    kind: FaultKind,
    /// Duration of a lasting fault.
    lasting: Duration,
    misses_to_failsafe: u64,
    random: Stream,
    /// Targets of the faults that are still to come, in random order, the next one last.
    to_do: Vec<String>,
    pids: BTreeMap<String, u32>,
    truth: Option<Subscriber<Truth>>,
    phase: Phase,
    started: Instant,
    /// Number of consecutive steps that applied a command in time, and of those that held an old one.
    calm: u64,
    held: u64,
    ready_again: bool,
    /// Number of messages that the recorder had written when a fault ended.
    written: u64,
    /// Number of forged messages that reached the launcher.
    pub forged: u64,
    bar: ProgressBar,
    pub faults: Vec<InjectedFault>,
}

impl FaultInjector {
    /// Plans `rounds` faults of a kind for each of its targets, in random order.
    pub fn new(
        config: &NodeConfig,
        nodes: &[String],
        kind: FaultKind,
        lasting: Duration,
        (rounds, seed): (u32, u64),
    ) -> Self {
        let mut random = Stream::new(seed, "soak");
        let targets = kind.targets(nodes);
        let mut to_do: Vec<String> = (0..rounds).flat_map(|_| targets.iter().cloned()).collect();
        // Fisher-Yates shuffle.
        for i in (1..to_do.len()).rev() {
            to_do.swap(i, (random.uniform() * (i + 1) as f64) as usize);
        }
        let bar = ProgressBar::new(to_do.len() as u64);
        let style = ProgressStyle::with_template("{bar:24.cyan/dim} {pos}/{len} faults  {elapsed}  {msg}");
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
        let now = Instant::now();
        Self {
            kind,
            lasting,
            misses_to_failsafe: config.plant.misses_to_failsafe.into(),
            random,
            to_do,
            pids: BTreeMap::new(),
            truth: None,
            phase: Phase::Recovering { since: now },
            started: now,
            calm: 0,
            held: 0,
            ready_again: true,
            written: 0,
            forged: 0,
            bar,
            faults: Vec::new(),
        }
    }

    /// Reads the truth that the plant has published since the last call.
    fn receive(&mut self) {
        let Some(truth) = &mut self.truth else { return };
        while let Ok(Some(step)) = truth.try_recv() {
            if step.x[0] == FORGED {
                self.forged += 1;
                continue;
            }
            let failsafe = step.flags & flags::FAILSAFE != 0;
            if !failsafe && step.flags & flags::HELD == 0 {
                self.calm += 1;
                self.held = 0;
                continue;
            }
            self.calm = 0;
            if !failsafe {
                self.held += 1;
                continue;
            }
            if let Some(fault) = self.faults.last_mut().filter(|f| f.held_before_failsafe.is_none()) {
                fault.held_before_failsafe = Some(self.held);
                if self.held > self.misses_to_failsafe {
                    let (held, allowed) = (self.held, self.misses_to_failsafe);
                    fault.problem = Some(format!(
                        "{held} steps held an old command before the failsafe, {allowed} are allowed"
                    ));
                }
            }
        }
    }

    fn inject(&mut self, now: Instant) {
        let Some(node) = self.to_do.pop() else {
            self.phase = Phase::Done;
            return;
        };
        let pid = self.pids.get(&node).copied();
        self.calm = 0;
        self.held = 0;
        self.bar.set_message(node.clone());
        self.faults.push(InjectedFault {
            node,
            at_s: now.duration_since(self.started).as_secs_f64(),
            restart_s: None,
            recovery_s: None,
            dealt: 1,
            held_before_failsafe: None,
            problem: None,
        });
        self.phase = match self.kind.begin(pid) {
            Ok(Some(fault)) => Phase::Beginning { until: now + HANG, fault },
            Ok(None) => {
                self.ready_again = false;
                Phase::Recovering { since: now }
            }
            Err(e) => self.give_up(format!("the fault could not be injected: {e}")),
        };
    }

    /// Ends a lasting fault.
    fn take_back(&mut self, fault: Box<dyn Ongoing>, health: &HealthTable) {
        let dealt = fault.dealt();
        drop(fault);
        // Steps during the fault, and during its end, are no recovery.
        self.receive();
        if let Some(last) = self.faults.last_mut() {
            last.dealt = dealt;
        }
        self.calm = 0;
        self.written = written(health);
        self.phase = match dealt {
            0 => self.give_up("the fault was not carried out".into()),
            _ => Phase::Recovering { since: Instant::now() },
        };
    }

    /// Records why the bench did not recover from the last fault, which ends the soak.
    fn give_up(&mut self, problem: String) -> Phase {
        if let Some(fault) = self.faults.last_mut() {
            fault.problem = Some(problem);
        }
        Phase::Done
    }

    fn check_recovery(&mut self, now: Instant, since: Instant, health: &HealthTable) {
        let logs = !self.kind.stops_the_log() || written(health) > self.written;
        if self.calm >= CALM_STEPS && self.ready_again && logs {
            if let Some(fault) = self.faults.last_mut() {
                fault.recovery_s = Some(now.duration_since(since).as_secs_f64());
                self.bar.inc(1);
            }
            let rest = REST_S.0 + (REST_S.1 - REST_S.0) * self.random.uniform();
            self.phase = Phase::Resting { until: now + Duration::from_secs_f64(rest) };
        } else if now.duration_since(since) > HANG {
            self.phase = self.give_up(format!("the loop had not recovered after {} s", HANG.as_secs()));
        }
    }

    /// Number of planned faults that were not injected.
    pub fn left(&self) -> usize {
        self.to_do.len()
    }
}

/// Number of messages that the recorder has reported as written.
fn written(health: &HealthTable) -> u64 {
    health.get(Role::Recorder.name()).map_or(0, |recorder| recorder.counts().steps)
}

impl Observer for FaultInjector {
    fn line(&mut self, node: &str, line: &str) {
        self.bar.suspend(|| crate::style::say(&format!("[{node}] {line}")));
    }

    fn event(&mut self, event: &Event) {
        match event {
            Event::Ready { node, pid } => {
                self.pids.insert(node.clone(), *pid);
                let at = self.started.elapsed().as_secs_f64();
                if let Some(fault) = self.faults.last_mut().filter(|f| f.node == *node && !self.ready_again) {
                    fault.restart_s = Some(at - fault.at_s);
                    self.ready_again = true;
                }
            }
            Event::Restarted { node, .. } => {
                // A node that is stopped for longer than its `Health` may be silent is killed and restarted.
                self.ready_again = false;
                self.pids.remove(node);
            }
            Event::Ending(Ending::Failed(failure)) => {
                if let Some(fault) = self.faults.last_mut() {
                    fault.problem = Some(format!("{} {}", failure.node, failure.how));
                }
                self.phase = Phase::Done;
            }
            _ => {}
        }
    }

    fn tick(&mut self, now: Instant, health: &HealthTable) -> Continuation {
        self.receive();
        match std::mem::replace(&mut self.phase, Phase::Done) {
            Phase::Recovering { since } => {
                self.phase = Phase::Recovering { since };
                self.check_recovery(now, since, health);
            }
            Phase::Resting { until } if now >= until && self.ready_again => self.inject(now),
            Phase::Beginning { fault, .. } if fault.dealt() > 0 => {
                self.phase = Phase::Lasting { until: now + self.lasting, fault };
            }
            Phase::Beginning { until, fault } if now >= until => self.take_back(fault, health),
            Phase::Lasting { until, fault } if now >= until => self.take_back(fault, health),
            Phase::Done => {
                self.bar.finish_and_clear();
                return Continuation::End;
            }
            unchanged => self.phase = unchanged,
        }
        Continuation::GoOn
    }

    fn opened(&mut self, bus: &Bus) -> Result<(), OpenError> {
        self.truth = Some(bus.subscriber(TRUTH_DEPTH)?);
        Ok(())
    }
}
