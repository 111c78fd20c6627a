//! A long search shows its progress, and can be ended early by Ctrl-C or by a budget of time. The results found by
//! then are reported.

use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use signal_hook::consts::{SIGINT, SIGTERM};
use whirlstand_ident::watch::Watch;

use super::stage_line::StageLine;
use super::{INTERRUPTED, PARTIAL};
use crate::error::Failure;

/// The progress line of a long search, and the reason for its early end.
pub(super) struct EarlyEnd {
    line: StageLine,
    stop: Arc<AtomicBool>,
}

impl EarlyEnd {
    /// For a command with a budget of time in seconds that begins now. SIGINT and SIGTERM end the search; a second
    /// signal ends the program.
    ///
    /// # Errors
    /// [`Failure::Run`] when signals cannot be handled.
    pub fn new(command: &'static str, budget: Option<f64>) -> Result<(Self, Watch), Failure> {
        let deadline = budget.map(|s| Instant::now() + Duration::from_secs_f64(s));
        let line = StageLine::new(command, deadline);
        let listener = line.listener();
        let stop = Arc::new(AtomicBool::new(false));
        for signal in [SIGINT, SIGTERM] {
            // The order matters: a signal ends the program only if one came before it.
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

    /// Removes the progress line, because the search is over.
    pub fn finish(self) -> Ended {
        self.line.finish();
        Ended { stop: self.stop }
    }
}

/// A search that has ended.
pub(super) struct Ended {
    stop: Arc<AtomicBool>,
}

impl Ended {
    /// The exit code of a complete or `partial` answer. It also prints the reason for an early end.
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
