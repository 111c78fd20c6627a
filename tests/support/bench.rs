//! Access to a running bench from outside: its nodes' processes, and the files that it leaves.

use std::path::PathBuf;

use super::{Running, until};

/// A bench name that is unique among all tests.
pub fn unique(name: &str) -> String {
    format!("test-{name}-{}", std::process::id())
}

/// Process number of a node, once it is ready.
#[track_caller]
pub fn ready(running: &mut Running, node: &str) -> i32 {
    let line = running.wait_for_stderr(&format!("{node} (process "));
    let number = line.split("(process ").nth(1).and_then(|rest| rest.split(')').next());
    number.and_then(|n| n.parse().ok()).unwrap_or_else(|| panic!("{line}"))
}

/// Process numbers of several nodes, which become ready in any order.
#[track_caller]
pub fn all_ready<const N: usize>(running: &mut Running, nodes: [&str; N]) -> [i32; N] {
    let mut pids = [0; N];
    while pids.contains(&0) {
        let line = running.wait_for_stderr(") is ready");
        for (node, pid) in nodes.iter().zip(&mut pids) {
            if let Some((_, number)) = line.split_once(&format!("{node} (process ")) {
                *pid =
                    number.split(')').next().and_then(|n| n.parse().ok()).unwrap_or_else(|| panic!("{line}"));
            }
        }
    }
    pids
}

/// Sends a signal to a node.
pub fn signal(pid: i32, signal: i32) {
    // SAFETY: kill(2) touches no memory of ours; the process is a node of a bench that this test started.
    assert_eq!(unsafe { libc::kill(pid, signal) }, 0, "kill({pid}, {signal})");
}

#[track_caller]
pub fn gone(pid: i32) {
    let alive = || {
        let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
        stat.rsplit(')').next().and_then(|s| s.split_whitespace().next()).is_some_and(|state| state != "Z")
    };
    until(&format!("process {pid} is left behind"), || !alive());
}

/// Files of the bench in the folders of shared memory, its files, locks and sockets.
pub fn residue(bench: &str) -> Vec<PathBuf> {
    // SAFETY: geteuid(2) only reads the process's own user.
    let runtime = format!("/dev/shm/whirlstand-{}", unsafe { libc::geteuid() });
    let root = format!("/tmp/whirlstand.{bench}");
    let of_bench = |folder: &str, begins: &str| -> Vec<PathBuf> {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        entries.filter(|e| e.file_name().to_string_lossy().starts_with(begins)).map(|e| e.path()).collect()
    };
    let mut all = of_bench("/dev/shm", &format!("whirlstand.{bench}~"));
    all.extend(of_bench(&runtime, &format!("{bench}.lock")));
    all.extend(["", "/nodes", "/services"].iter().flat_map(|sub| of_bench(&format!("{root}{sub}"), "")));
    all
}

/// Asserts that nothing of the bench is left in shared memory or its files.
#[track_caller]
pub fn no_residue(name: &str) {
    assert_eq!(residue(&unique(name)), Vec::<PathBuf>::new(), "left behind");
}
