//! One line on a terminal that says what a long command is doing.

use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use indicatif::ProgressBar;

/// A command that is done sooner says nothing.
const SILENT: Duration = Duration::from_secs(2);

/// Says what is being done, once it takes longer than two seconds.
pub(super) struct StageLine {
    stages: Sender<Option<String>>,
    drawn: JoinHandle<()>,
}

impl StageLine {
    pub fn new() -> Self {
        let (stages, told) = mpsc::channel();
        let drawn = std::thread::spawn(move || draw(&told));
        Self { stages, drawn }
    }

    /// Tells it what is being done, from any thread.
    pub fn listener(&self) -> impl Fn(&str) + Send + Sync + 'static {
        let stages = self.stages.clone();
        // Nobody draws any more once the command is done.
        move |stage| drop(stages.send(Some(stage.to_string())))
    }

    /// Takes the line away.
    pub fn finish(self) {
        drop(self.stages.send(None));
        // Nothing depends on whether the line was drawn.
        drop(self.drawn.join());
    }
}

fn draw(told: &mpsc::Receiver<Option<String>>) {
    let shown_from = Instant::now() + SILENT;
    let mut stage = String::new();
    loop {
        match told.recv_timeout(shown_from.saturating_duration_since(Instant::now())) {
            Ok(Some(next)) => stage = next,
            Ok(None) | Err(RecvTimeoutError::Disconnected) => return,
            Err(RecvTimeoutError::Timeout) => break,
        }
    }
    let bar = ProgressBar::new_spinner();
    bar.enable_steady_tick(Duration::from_millis(100));
    bar.set_message(stage);
    while let Ok(Some(next)) = told.recv() {
        bar.set_message(next);
    }
    bar.finish_and_clear();
}
