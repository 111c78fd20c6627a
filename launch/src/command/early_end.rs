//! A long search shows what it does, and may be ended with what is known by then: by Ctrl-C, or by a budget of time.

use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use signal_hook::consts::{SIGINT, SIGTERM};
use whirlstand_ident::watch::Watch;

use super::stage_line::StageLine;
use super::{INTERRUPTED, PARTIAL};
use crate::error::Failure;

/// The line of a long search, and what ended it.
pub(super) struct EarlyEnd {
    line: StageLine,
    stop: Arc<AtomicBool>,
}

impl EarlyEnd {
    /// For a command with a budget of time in seconds, from now on. SIGINT and SIGTERM end the search; a second one ends the
    /// program.
    ///
    /// # Errors
    /// [`Failure::Run`] when signals cannot be handled.
    pub fn new(command: &'static str, budget: Option<f64>) -> Result<(Self, Watch), Failure> {
        let deadline = budget.map(|s| Instant::now() + Duration::from_secs_f64(s));
        let line = StageLine::new(command, deadline);
        let listener = line.listener();
        let stop = Arc::new(AtomicBool::new(false));
        for signal in [SIGINT, SIGTERM] {
            // In this order: a signal ends the program only if one came before it.
            let exit = i32::from(INTERRUPTED);
            signal_hook::flag::register_conditional_shutdown(signal, exit, Arc::clone(&stop))
                .map_err(Failure::run)?;
            signal_hook::flag::register(signal, Arc::clone(&stop)).map_err(Failure::run)?;
        }
        let mut watch = Watch::new(Arc::clone(&stop), listener);
        if let Some(deadline) = deadline {
            watch = watch.until(deadline);
        }
        Ok((Self { line, stop }, watch))
    }

    /// Takes the line away: the search is over.
    pub fn finish(self) -> Ended {
        self.line.finish();
        Ended { stop: self.stop }
    }
}

/// A search that is over.
pub(super) struct Ended {
    stop: Arc<AtomicBool>,
}

impl Ended {
    /// The exit code of an answer that is whole or partial; says what ended the search.
    pub fn exit_code(&self, partial: bool) -> ExitCode {
        if !partial {
            return ExitCode::SUCCESS;
        }
        if self.stop.load(Ordering::Relaxed) {
            crate::style::say("interrupted: these are the results so far");
            return ExitCode::from(INTERRUPTED);
        }
        crate::style::say("the time budget is used up: these are the results so far");
        ExitCode::from(PARTIAL)
    }
}
