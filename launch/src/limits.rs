//! Checks, before a bench starts, the limits of the operating system without which it cannot run.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

use crate::error::Failure;

/// Open files that a process of a bench needs: each topic of each peer takes shared memory or a connection.
const LEAST_FILES: u64 = 256;

/// Open files that a process of a bench requests, where the hard limit allows it.
const ENOUGH_FILES: u64 = 4096;

/// Address space that a process of a bench needs, bytes: stacks of its threads, shared memory, and its log in the report.
const LEAST_MEMORY: u64 = 512 << 20;

/// Raises the limit of open files as far as this process may, and checks whether a bench can run.
///
/// # Errors
/// When it cannot, with what to change. Without this check the bench would fail during the run, each time at
/// a different place.
pub(crate) fn check_for_bench() -> Result<(), Failure> {
    let files = getrlimit(Resource::Nofile);
    if let (Some(current), maximum) = (files.current, files.maximum.unwrap_or(ENOUGH_FILES))
        && current < ENOUGH_FILES.min(maximum)
    {
        let raised = Rlimit { current: Some(ENOUGH_FILES.min(maximum)), maximum: files.maximum };
        // If this is refused, the present limit may still be enough.
        let _ = setrlimit(Resource::Nofile, raised);
    }
    let files = getrlimit(Resource::Nofile).current;
    verdict(files, getrlimit(Resource::As).current).map_or(Ok(()), |why| Err(Failure::Mend(why)))
}

/// Reason why a bench cannot run under these limits; `None` in an argument means no limit.
fn verdict(files: Option<u64>, memory: Option<u64>) -> Option<String> {
    if let Some(files) = files.filter(|n| *n < LEAST_FILES) {
        return Some(format!(
            "a process may open only {files} files here, but a bench needs {LEAST_FILES}: raise the limit (ulimit \
             -n {LEAST_FILES})"
        ));
    }
    let memory = memory.filter(|n| *n < LEAST_MEMORY)?;
    Some(format!(
        "a process may use only {} MB of memory here, but a bench needs {}: raise the limit (ulimit -v {})",
        memory >> 20,
        LEAST_MEMORY >> 20,
        LEAST_MEMORY >> 10
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_too_little_is_told_with_what_is_enough() {
        assert_eq!(verdict(None, None), None);
        assert_eq!(verdict(Some(LEAST_FILES), Some(LEAST_MEMORY)), None);
        assert!(verdict(Some(32), None).unwrap().contains("only 32 files here, but a bench needs 256"));
        assert!(
            verdict(None, Some(100 << 20))
                .unwrap()
                .contains("only 100 MB of memory here, but a bench needs 512")
        );
    }
}
