//! Progress of a running bench: one live line on a terminal, elsewhere a line from time to time.

use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use whirlstand_msgs::NodeState;
use whirlstand_nodes::config::NodeConfig;

use super::start::PeriodicTimer;
use super::waits::Waits;
use crate::live::Looker;
use crate::supervisor::{Continuation, Ending, Event, HealthTable, Observer};

/// Time between two lines without a terminal.
const QUIET_LINE: Duration = Duration::from_secs(5);

/// Shows the progress of one run on standard error.
pub(crate) struct Progress {
    bar: ProgressBar,
    period_s: f64,
    restarts: u32,
    /// Step of the plant and wall-clock time at the last measurement of the speed.
    last: Option<(u64, Instant)>,
    steps_per_s: f64,
    quiet: Option<PeriodicTimer>,
    failsafe: bool,
    waits: Waits,
    /// Collects the messages of the run for the live page.
    looker: Option<Looker>,
}

impl Progress {
    /// Begins to show progress; with `shown` false only warnings are shown.
    pub fn new(config: &NodeConfig, shown: bool) -> Self {
        let bar = if shown { ProgressBar::new(config.steps) } else { ProgressBar::hidden() };
        let style = ProgressStyle::with_template("{bar:24.cyan/dim} {percent:>3}%  {msg}");
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
        let quiet = (shown && bar.is_hidden()).then(|| PeriodicTimer::new(QUIET_LINE, Instant::now()));
        Self {
            bar,
            period_s: config.period_ns as f64 * 1e-9,
            restarts: 0,
            last: None,
            steps_per_s: 0.0,
            quiet,
            failsafe: false,
            waits: Waits::default(),
            looker: None,
        }
    }

    /// Adds the collection for the live page, which runs until the nodes have ended.
    pub fn with(self, looker: Option<Looker>) -> Self {
        Self { looker, ..self }
    }

    /// Removes the live line.
    pub fn finish(self) {
        self.bar.finish_and_clear();
    }

    fn say(&self, line: &str) {
        self.bar.suspend(|| crate::style::say(line));
    }

    fn status(&mut self, now: Instant, health: &HealthTable) -> Option<(u64, String)> {
        let plant = health.get("plant")?;
        let step = plant.latest.head.step;
        match self.last {
            Some((before, at)) if now.duration_since(at) < Duration::from_millis(400) => {
                self.steps_per_s = if self.steps_per_s > 0.0 || step == before {
                    self.steps_per_s
                } else {
                    (step.saturating_sub(before)) as f64 / now.duration_since(at).as_secs_f64().max(1e-3)
                };
            }
            Some((before, at)) => {
                self.steps_per_s = step.saturating_sub(before) as f64 / now.duration_since(at).as_secs_f64();
                self.last = Some((step, now));
            }
            None => self.last = Some((step, now)),
        }
        let counts = plant.counts();
        let t = format!("t {:7.2} s", step as f64 * self.period_s);
        if let Some(waits) = self.waits.text(now) {
            return Some((step, format!("{t}  {waits}")));
        }
        let state = match NodeState::from_u32(plant.latest.state) {
            Some(NodeState::Failsafe) => "  FAILSAFE",
            Some(NodeState::Starting) => "  waiting for the other nodes",
            Some(NodeState::Disarmed) => "  not armed",
            Some(NodeState::Manual) => "  in the pilot's hands",
            _ => "",
        };
        let text = format!(
            "{t}  {:>9.0} steps/s  misses {}  lost {}  restarts {}{state}",
            self.steps_per_s,
            counts.deadline_misses,
            health.lost(),
            self.restarts,
        );
        Some((step, text))
    }
}

impl Observer for Progress {
    fn line(&mut self, node: &str, line: &str) {
        self.say(&format!("[{node}] {line}"));
    }

    fn event(&mut self, event: &Event) {
        match event {
            Event::Started { node, pid } => {
                self.waits.forget(node);
                tracing::debug!("{node} runs as process {pid}");
            }
            Event::Ready { node, pid } => tracing::debug!("{node} (process {pid}) is ready"),
            Event::Status { node, text } => {
                self.waits.hear(node, text, Instant::now());
                if !text.is_empty() {
                    tracing::info!("{node}: {text}");
                }
            }
            Event::Restarted { node, how, attempt, allowed } => {
                self.restarts += 1;
                self.say(&format!("{node} {how}; restarting it (restart {attempt} of {allowed})"));
            }
            Event::KilledAtEnd { node, after } => {
                self.say(&format!("{node} did not stop within {} s and was killed", after.as_secs_f64()));
            }
            Event::Ending(Ending::Interrupted(signal)) => {
                let name = signal_hook::low_level::signal_name(*signal).unwrap_or("a signal");
                self.say(&format!("{name}: stopping the bench cleanly (a second signal kills it)"));
            }
            Event::Ending(_) => {}
        }
    }

    fn closed(&mut self) {
        self.looker = None;
    }

    fn tick(&mut self, now: Instant, health: &HealthTable) -> Continuation {
        let Some((step, text)) = self.status(now, health) else { return Continuation::GoOn };
        let failsafe = health.state("plant") == Some(NodeState::Failsafe);
        if failsafe != std::mem::replace(&mut self.failsafe, failsafe) {
            let t = step as f64 * self.period_s;
            self.say(&match failsafe {
                true => format!("the plant entered failsafe (inputs neutral) at {t:.2} s"),
                false => format!("the plant left failsafe at {t:.2} s"),
            });
        }
        if self.quiet.as_mut().is_some_and(|q| q.is_due(now)) {
            self.say(&text);
        }
        self.bar.set_position(step);
        self.bar.set_message(text);
        Continuation::GoOn
    }
}
