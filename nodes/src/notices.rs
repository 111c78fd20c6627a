//! Notices of a node's steps, written by a separate thread, because writing a line allocates, takes the lock
//! of standard error, and blocks where nobody reads it.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Condvar, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use whirlstand_bus::RecvError;
use whirlstand_msgs::{Adjustment, AdjustmentKind, AdjustmentVerdict};

use crate::error::NodeError;
use crate::refusal::{name, refusal};
use crate::worker::Worker;

/// Largest number of waiting notices. Further ones are counted, and the count is reported.
const DEPTH: usize = 64;

/// Longest wait at the end of a node until all notices are written.
const PATIENCE: Duration = Duration::from_secs(1);

/// Notice of a step.
#[derive(Debug)]
pub(crate) enum Notice {
    /// The plant began a new run, and the reaction of this node.
    NewRun { step: u64, then: &'static str },
    /// Measurements are missing since step `last`.
    Gap { step: u64, last: u64 },
    /// Commands are missing: neutral inputs.
    Failsafe { step: u64, misses: u64 },
    /// Commands arrive again.
    FailsafeOver { step: u64 },
    /// Commands are withheld, or no longer, because of a finding of the mirror.
    Caution { step: u64, withholds: bool },
    /// Another law is in charge from this step on.
    InCharge { step: u64, is_first: bool },
    /// Manual control ended after too long a silence.
    LetGo { step: u64 },
    /// Too many laws are being designed.
    DraftLeftOut,
    /// A request from outside was refused; `key` is the launch-file key that allows it.
    Refused { answer: Adjustment, key: &'static str },
    /// A message arrived damaged.
    Damaged(RecvError),
}

struct Notices {
    worker: Worker<Notice>,
    /// Number of notices submitted; `written` of them are written.
    handed: AtomicU64,
    left_out: AtomicU64,
    written: Mutex<u64>,
    more: Condvar,
}

static NOTICES: OnceLock<Notices> = OnceLock::new();

/// Guard of the writing thread; when it is dropped all notices have been written.
pub(crate) struct Writing;

/// Starts the thread of this process, unless it runs already; before a node takes its priority, which the
/// thread must not have.
///
/// # Errors
/// [`NodeError::System`].
pub(crate) fn begin() -> Result<Writing, NodeError> {
    if NOTICES.get().is_some() {
        return Ok(Writing);
    }
    let worker = Worker::start("notices", DEPTH, |notice: Notice| {
        notice.write();
        let notices = NOTICES.wait();
        notices.tell_left_out();
        *notices.written.lock().unwrap_or_else(PoisonError::into_inner) += 1;
        notices.more.notify_all();
    })
    .map_err(|source| NodeError::System { action: "start the thread that writes what steps say", source })?;
    // Of two threads started at once one stays, and the other ends.
    let _ = NOTICES.set(Notices {
        worker,
        handed: AtomicU64::new(0),
        left_out: AtomicU64::new(0),
        written: Mutex::new(0),
        more: Condvar::new(),
    });
    Ok(Writing)
}

/// Submits a notice. Allocates nothing and takes no lock; in a process without the thread it is written
/// directly.
pub(crate) fn say(notice: Notice) {
    let Some(notices) = NOTICES.get() else { return notice.write() };
    let count = if notices.worker.hand(notice).is_ok() { &notices.handed } else { &notices.left_out };
    count.fetch_add(1, Ordering::AcqRel);
}

impl Drop for Writing {
    fn drop(&mut self) {
        let Some(notices) = NOTICES.get() else { return };
        let handed = notices.handed.load(Ordering::Acquire);
        let written = notices.written.lock().unwrap_or_else(PoisonError::into_inner);
        // Without a reader or the thread, a node ends nevertheless.
        let waited = notices.more.wait_timeout_while(written, PATIENCE, |written| *written < handed);
        let (written, waited) = waited.unwrap_or_else(PoisonError::into_inner);
        drop(written);
        if !waited.timed_out() {
            notices.tell_left_out();
        }
    }
}

impl Notices {
    fn tell_left_out(&self) {
        let left_out = self.left_out.swap(0, Ordering::AcqRel);
        if left_out > 0 {
            tracing::warn!(
                "{left_out} step messages were dropped: they came faster than they could be written"
            );
        }
    }
}

impl Notice {
    fn write(self) {
        match self {
            Self::NewRun { step, then } => tracing::warn!(step, "the plant started a new run: {then}"),
            Self::Gap { step, last } => {
                tracing::warn!(step, last, "too many measurements are missing: restarting");
            }
            Self::Failsafe { step, misses } => {
                tracing::warn!(step, misses, "no command in time: FAILSAFE, inputs at neutral");
            }
            Self::FailsafeOver { step } => tracing::warn!(step, "commands have resumed: failsafe ended"),
            Self::Caution { step, withholds: true } => {
                tracing::warn!(
                    step,
                    "the mirror reports that the prediction is wrong: commands are withheld"
                );
            }
            Self::Caution { step, withholds: false } => {
                tracing::warn!(step, "the prediction is right again: commands resume");
            }
            Self::InCharge { step, is_first: true } => tracing::warn!(step, "the first law is active"),
            Self::InCharge { step, is_first: false } => {
                tracing::warn!(step, "the law that the mirror asked for is active");
            }
            Self::LetGo { step } => {
                tracing::warn!(step, "no more messages from the stick: the law is active again");
            }
            Self::DraftLeftOut => tracing::warn!(
                "the law that the mirror asked for is left out: others are still being designed"
            ),
            Self::Refused { answer, key } => write_refused(&answer, key),
            Self::Damaged(error) => tracing::warn!("{error}"),
        }
    }
}

fn write_refused(answer: &Adjustment, key: &str) {
    if let (Some(kind), Some(verdict)) =
        (AdjustmentKind::from_u32(answer.what), AdjustmentVerdict::from_u32(answer.verdict))
    {
        tracing::warn!(
            step = answer.head.step,
            "{} of {} from outside is refused: {}",
            name(kind),
            answer.value,
            refusal(verdict, key)
        );
    }
}
