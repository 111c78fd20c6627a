//! A log in several files: split by size, by duration, or after the disk was full. Every command reads them as one log.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{json, run, spawn};
use serde_json::Value;
use whirlstand_test_harness::{Missing, Outcome};

/// Flies a quadrotor with the settings `more`; returns the folder.
fn flown(dir: &Path, name: &str, more: &[&str]) -> PathBuf {
    let out = dir.join(name);
    let fixed = ["run", "quadrotor", "--mode", "lockstep", "--transport", "inproc", "--out"];
    run(fixed.iter().chain([&out.to_str().unwrap()]).chain(more)).success();
    out
}

fn info(log: &Path) -> Value {
    let end = run(["log", "info", log.to_str().unwrap(), "--json"]).success();
    serde_json::from_str(&end.stdout).unwrap()
}

/// Files of the log that were read, and the number of messages of the true states in them.
fn read(log: &Path) -> (Vec<String>, u64) {
    let info = info(log);
    let name = |file: &Value| Path::new(file["path"].as_str().unwrap()).file_name().unwrap().to_owned();
    let files = info["files"].as_array().unwrap().iter().map(|f| name(f).to_string_lossy().into_owned());
    let topics = info["topics"].as_array().unwrap();
    let truth = topics.iter().find(|topic| topic["name"] == "/truth").unwrap();
    (files.collect(), truth["messages"].as_u64().unwrap())
}

fn files_are_full_at_their_size_and_one_log_together() {
    let dir = tempfile::tempdir().unwrap();
    let whole = flown(dir.path(), "whole", &["--duration", "20"]);
    let parts = flown(dir.path(), "parts", &["--duration", "20", "--set", "recorder.max_size=\"150 kB\""]);
    let (files, steps) = read(&parts);
    assert!(files.len() > 5 && files[..2] == ["log.mcap", "log.2.mcap"], "{files:?}");
    for file in &files {
        // A file may exceed the requested size by a chunk, one poll of the queues and the index.
        let size = std::fs::metadata(parts.join(file)).unwrap().len();
        assert!(size < 300_000, "{file}: {size}");
    }
    assert_eq!((read(&whole).1, steps), (4_000, 4_000));
    let first = parts.join("log.mcap");
    assert_eq!(read(&first), (files.clone(), steps), "the first file stands for all");
    assert_eq!(read(&parts.join("log.3.mcap")).0, ["log.3.mcap"], "a later one for itself");
    let said = run(["log", "info", first.to_str().unwrap()]).success().stdout;
    assert!(said.contains(&format!("{} files are read in order as one log", files.len())), "{said}");
    run(["log", "diff", whole.to_str().unwrap(), parts.to_str().unwrap()]).success();
    let outputs = |out: &Path| json(out.join("summary.json"))["runs"][0]["outputs"].clone();
    assert_eq!(outputs(&whole), outputs(&parts));
}

fn the_oldest_files_go_when_only_so_many_are_kept() {
    let dir = tempfile::tempdir().unwrap();
    let limits = ["--set", "recorder.max_duration=2", "--set", "recorder.segments=3", "--set", "expect={}"];
    let out = flown(dir.path(), "kept", &[&["--duration", "19"], &limits[..]].concat());
    let (files, steps) = read(&out);
    assert_eq!(files.len(), 3, "{files:?}");
    assert!(!out.join("log.mcap").exists() && files[0] != "log.mcap", "{files:?}");
    // Two complete files of two seconds at 200 Hz, and the current one.
    assert!((800..1_300).contains(&steps), "{steps}");
    // The name of the first file, which was deleted, still stands for the whole log; so does the name of the oldest
    // file.
    assert_eq!(read(&out.join("log.mcap")), (files.clone(), steps));
    assert_eq!(read(&out.join(&files[0])), (files, steps));
    let kept = json(out.join("summary.json"));
    assert!((kept["runs"][0]["duration_s"].as_f64().unwrap() - 18.995).abs() < 1e-6, "{kept}");
}

/// Flies on a disk of 6 MB that is full after some two seconds, and is freed a second later.
const FULL_DISK: &str = r#"
set -e
mount -t tmpfs -o size=6m tmpfs "$1"
head -c 5400000 /dev/zero > "$1/filler"
(
    until [ "$(stat -f -c %a "$1")" -lt 2 ]; do sleep 0.02; done
    sleep 1
    rm "$1/filler"
) &
code=0
"$2" run quadrotor --duration 7 --set rate_hz=1000 --set 'expect={}' --out "$1/out" > "$3/said" 2>&1 || code=$?
cp "$1/out/summary.json" "$3"
"$2" log info "$1/out" > "$3/info" 2>&1
wait
exit $code
"#;

fn a_full_disk_is_told_once_and_leaves_a_hole_that_the_verdict_names() -> Outcome {
    let mount = ["-rm", "sh", "-c", "mount -t tmpfs tmpfs /mnt"];
    let possible = Command::new("unshare").args(mount).output();
    if !possible.is_ok_and(|output| output.status.success()) {
        return Err(Missing::beyond_this_machine("no mount namespace", "the kernel refuses `unshare -rm`"));
    }
    let (disk, kept) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let mut command = Command::new("unshare");
    command.args(["-rm", "sh", "-c", FULL_DISK, "sh"]).env("NO_COLOR", "1");
    command.args([disk.path(), Path::new(env!("CARGO_BIN_EXE_whirlstand")), kept.path()]);
    let end = spawn(command).finish();
    let text = |name: &str| std::fs::read_to_string(kept.path().join(name)).unwrap_or_default();
    let said = text("said");
    assert_eq!(end.code(), 1, "{}\n{said}", end.stderr);
    assert_eq!(said.matches("cannot write the log").count(), 1, "told once:\n{said}");
    assert!(said.contains("log.mcap: disk full") && said.contains("continues in a new file"), "{said}");
    assert!(!said.contains("restarting it"), "{said}");
    let summary = json(kept.path().join("summary.json"));
    let problem = summary["runs"][0]["problems"][0].as_str().unwrap().to_string();
    assert!(problem.contains("the log has a gap from") && problem.contains("(disk full)"), "{problem}");
    assert!(summary["verdict"].as_str().unwrap().contains("the log has a gap"), "{summary}");
    assert!(summary["runs"][0]["timing"]["nodes"]["recorder"]["lost"].as_u64().unwrap() > 500, "{summary}");
    assert_eq!(summary["runs"][0]["timing"]["nodes"]["recorder"]["restarts"], 0, "{summary}");
    let duration = summary["runs"][0]["duration_s"].as_f64().unwrap();
    assert!((duration - 6.999).abs() < 1e-6, "the end is in the log: {duration}");
    let info = text("info");
    assert!(info.contains("2 files are read in order as one log"), "{info}");
    assert!(info.contains("the log has a gap from") && info.contains("log.2.mcap"), "{info}");
    Ok(())
}

whirlstand_test_harness::listed!(
    files_are_full_at_their_size_and_one_log_together,
    the_oldest_files_go_when_only_so_many_are_kept,
    a_full_disk_is_told_once_and_leaves_a_hole_that_the_verdict_names,
);
