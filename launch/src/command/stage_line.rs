//! Progress of a long command: the stage, its share done and the time left. Shown as a live line on a terminal,
//! elsewhere as a line from time to time.

use std::io::IsTerminal;
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use indicatif::ProgressBar;
use whirlstand_ident::watch::Stage;

/// A command that ends sooner shows no progress.
const SILENT: Duration = Duration::from_secs(2);
/// Time between two lines without a terminal, so that a log is not flooded.
const BETWEEN_LINES: Duration = Duration::from_secs(10);

/// The stage that was reported last.
struct Told {
    what: String,
    detail: String,
    /// Share of the stage that is done, 0 to 1.
    share: Option<f64>,
}

/// Shows the progress of a command that takes longer than two seconds.
pub(crate) struct StageLine {
    stages: Sender<Option<Told>>,
    drawn: JoinHandle<()>,
}

impl StageLine {
    /// For a command that ends no later than the deadline.
    pub fn new(command: &'static str, deadline: Option<Instant>) -> Self {
        let (stages, told) = mpsc::channel();
        let drawn = std::thread::spawn(move || draw(command, &told, deadline));
        Self { stages, drawn }
    }

    /// A function that reports the current stage, from any thread.
    pub fn listener(&self) -> impl Fn(Stage<'_>) + Send + Sync + 'static {
        let stages = self.stages.clone();
        // Nothing is drawn any more once the command is done.
        move |Stage { what, detail, share }| {
            drop(stages.send(Some(Told { what: what.into(), detail: detail.into(), share })));
        }
    }

    /// Removes the line.
    pub fn finish(self) {
        drop(self.stages.send(None));
        // Nothing depends on whether the line was drawn.
        drop(self.drawn.join());
    }
}

/// The stage that is shown, and its start.
struct Shown {
    begun: Instant,
    told: Told,
    stage_begun: Instant,
    deadline: Option<Instant>,
}

impl Shown {
    fn hear(&mut self, told: Told) {
        if told.what != self.told.what {
            self.stage_begun = Instant::now();
        }
        self.told = told;
    }

    /// Stage, detail, share, time so far, and time left: of this stage at its rate so far, and until the deadline.
    fn text(&self) -> String {
        let mut text = self.told.what.clone();
        if !self.told.detail.is_empty() {
            text.push_str(&format!(": {}", self.told.detail));
        }
        let running = self.stage_begun.elapsed().as_secs_f64();
        if let Some(share) = self.told.share {
            text.push_str(&format!(", {:.0} %", 100.0 * share));
            if share > 0.0 {
                text.push_str(&format!(", {:.0} s left in this stage", running * (1.0 - share) / share));
            }
        }
        text.push_str(&format!("; {:.0} s so far", self.begun.elapsed().as_secs_f64()));
        if let Some(deadline) = self.deadline {
            let left = deadline.saturating_duration_since(Instant::now()).as_secs_f64();
            text.push_str(&format!(", {left:.0} s left of the budget"));
        }
        text
    }
}

fn draw(command: &str, told: &mpsc::Receiver<Option<Told>>, deadline: Option<Instant>) {
    let now = Instant::now();
    let told_first = Told { what: "reads".into(), detail: String::new(), share: None };
    let mut shown = Shown { begun: now, told: told_first, stage_begun: now, deadline };
    let bar = std::io::stderr().is_terminal().then(ProgressBar::new_spinner);
    let mut next_line = now + SILENT;
    loop {
        match told.recv_timeout(next_line.saturating_duration_since(Instant::now())) {
            Ok(Some(next)) => shown.hear(next),
            Ok(None) | Err(RecvTimeoutError::Disconnected) => break,
            Err(RecvTimeoutError::Timeout) => {}
        }
        if Instant::now() < next_line {
            continue;
        }
        match &bar {
            Some(bar) => {
                bar.set_message(shown.text());
                bar.tick();
                next_line = Instant::now() + Duration::from_millis(100);
            }
            None => {
                crate::style::say(&format!("{command} {}", shown.text()));
                next_line = Instant::now() + BETWEEN_LINES;
            }
        }
    }
    if let Some(bar) = bar {
        bar.finish_and_clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stage_share_and_time_are_told() {
        let now = Instant::now();
        let told = |what: &str, detail: &str, share| Told { what: what.into(), detail: detail.into(), share };
        let mut shown = Shown {
            begun: now - Duration::from_secs(12),
            told: told("", "", None),
            stage_begun: now,
            deadline: Some(now + Duration::from_secs(3600)),
        };
        shown.hear(told("looks for a cause", "", Some(0.0)));
        shown.stage_begun = now - Duration::from_secs(6);
        shown.hear(told("looks for a cause", "", Some(0.25)));
        let text = shown.text();
        assert!(
            text.starts_with("looks for a cause, 25 %, 18 s left in this stage; 12 s so far, 3"),
            "{text}"
        );
        // The time of a stage continues while its detail changes.
        shown.hear(told("looks for a cause", "the best so far 7", Some(0.5)));
        let text = shown.text();
        assert!(
            text.starts_with("looks for a cause: the best so far 7, 50 %, 6 s left in this stage"),
            "{text}"
        );
    }
}
