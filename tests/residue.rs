//! Processes and files left by killed launchers are ended and removed, and nothing else; full shared memory is
//! reported.

use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::bench::{all_ready, gone, residue, signal, unique};
use crate::support::{FAULTS_ALLOWED, Running, json, run, spawn, until, whirlstand};
use serde_json::Value;
use whirlstand_test_harness::{Missing, Outcome};

const NODES: [&str; 4] = ["recorder", "estimator", "controller", "plant"];

// Every run cleans up, so no other test here may start one while one checks what is left.
whirlstand_test_harness::listed_one_at_a_time![
    "what killed benches leave":
    the_next_start_removes_what_five_killed_benches_left,
    clean_lists_then_removes_and_leaves_live_benches_alone,
    keys_of_a_killed_bench_are_listed_and_removed,
    children_of_a_program_go_with_its_node,
    a_program_is_asked_to_end_when_the_launcher_is_killed,
    only_the_user_can_read_what_a_run_creates,
    shared_memory_that_is_full_is_told_of,
];

fn start(name: &str, out: &Path) -> Running {
    let bench = unique(name);
    let mut command = whirlstand(["run", "quadrotor", "--duration", "1000", "--set", FAULTS_ALLOWED]);
    command.args(["--log-level", "debug", "--bench", &bench, "--out"]).arg(out);
    spawn(command)
}

/// The child processes of a process.
fn children(pid: i32) -> Vec<i32> {
    let text = std::fs::read_to_string(format!("/proc/{pid}/task/{pid}/children")).unwrap();
    text.split_whitespace().map(|n| n.parse().unwrap()).collect()
}

/// Starts benches, then kills the launchers together with all that could clean up after them, as the kernel does when
/// memory runs out.
fn kill_all_of(names: &[&str]) {
    let dirs: Vec<_> = names.iter().map(|_| tempfile::tempdir().unwrap()).collect();
    let mut all: Vec<_> = names.iter().zip(&dirs).map(|(name, dir)| start(name, dir.path())).collect();
    all.iter_mut().for_each(|running| _ = all_ready(running, NODES));
    all.into_iter().for_each(kill_with_all);
    for name in names {
        assert!(residue(&unique(name)).len() > 40, "{name} left nothing, so this test shows nothing");
    }
}

/// Kills a launcher with its nodes and its guard.
fn kill_with_all(running: Running) {
    running.signal(libc::SIGSTOP);
    let others = children(running.pid());
    assert_eq!(others.len(), 5, "four nodes and the guard");
    others.iter().for_each(|&pid| signal(pid, libc::SIGKILL));
    running.signal(libc::SIGKILL);
    running.finish();
    others.into_iter().for_each(gone);
}

fn the_next_start_removes_what_five_killed_benches_left() {
    let names = ["killed-1", "killed-2", "killed-3", "killed-4", "killed-5"];
    let left = || names.iter().map(|name| residue(&unique(name)).len()).sum::<usize>();
    let before = left();
    kill_all_of(&names);
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().to_str().unwrap();
    let end = run(["run", "--mode", "lockstep", "--duration", "1", "--set", FAULTS_ALLOWED, "--out", out])
        .success();
    assert!(end.stderr.contains("left behind by killed runs"), "{}", end.stderr);
    names.iter().for_each(|name| assert!(end.stderr.contains(&unique(name)), "{name}: {}", end.stderr));
    assert_eq!(left(), before);
}

fn cleaned(more: &[&str]) -> Value {
    let end = run(["clean", "--json"].iter().chain(more)).success();
    serde_json::from_str(&end.stdout).unwrap()
}

fn entry<'a>(cleaned: &'a Value, name: &str) -> Option<&'a Value> {
    let bench = unique(name);
    cleaned["benches"].as_array().unwrap().iter().find(|b| b["bench"] == bench.as_str())
}

/// What a killed bench left, and what a dry run lists. Any run on this machine may tidy up in between, one of a test
/// program that has just ended too: it is then killed and listed again.
fn listed_undisturbed() -> (Vec<PathBuf>, Value) {
    let attempt = || {
        kill_all_of(&["dirty"]);
        let before = residue(&unique("dirty"));
        let listed = cleaned(&["--dry-run"]);
        (residue(&unique("dirty")) == before).then_some((before, listed))
    };
    (0..3).find_map(|_| attempt()).expect("a dry run changes nothing")
}

fn clean_lists_then_removes_and_leaves_live_benches_alone() {
    kill_all_of(&["dirty"]);
    let dir = tempfile::tempdir().unwrap();
    let mut live = start("alive", dir.path());
    all_ready(&mut live, NODES);
    assert!(residue(&unique("dirty")).is_empty(), "a start tidies up");
    let (before, listed) = listed_undisturbed();
    assert_eq!((&listed["schema"], &listed["dry_run"]), (&"whirlstand.clean.v1".into(), &true.into()));
    let dirty = entry(&listed, "dirty").unwrap_or_else(|| panic!("{listed}"));
    assert_eq!(dirty["removed"], false);
    assert!(dirty["files"].as_u64().unwrap() > 40 && dirty["bytes"].as_u64().unwrap() > 100_000, "{dirty}");
    assert!(dirty["since"].as_str().unwrap().ends_with('Z'), "{dirty}");
    assert_eq!(entry(&listed, "alive"), None, "{listed}");
    assert_eq!(residue(&unique("dirty")), before, "a dry run changes nothing");
    let text = run(["clean", "--dry-run"]).success().stdout;
    assert!(text.contains(&unique("dirty")) && text.contains("MiB") && text.contains("stale"), "{text}");

    assert_eq!(entry(&cleaned(&[]), "dirty").unwrap()["removed"], true);
    assert_eq!(residue(&unique("dirty")), Vec::<PathBuf>::new());
    assert_eq!(entry(&cleaned(&[]), "dirty"), None);
    live.signal(libc::SIGINT);
    let end = live.finish();
    assert_eq!(end.code(), 130, "{}\n{}", end.stdout, end.stderr);
    let summary = json(dir.path().join("summary.json"));
    assert_eq!(summary["timing"]["restarts"], 0, "{summary}");
    assert!(summary["runs"][0]["problems"].as_array().unwrap().is_empty(), "{summary}");
}

fn keys_of_a_killed_bench_are_listed_and_removed() {
    let (dir, runtime) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let bench = unique("with-keys");
    let mut command = whirlstand(["run", "quadrotor", "--transport", "zenoh", "--duration", "1000"]);
    command.args(["--log-level", "debug", "--bench", &bench, "--out"]).arg(dir.path());
    let mut running = spawn(command_in(command, Some(runtime.path())));
    all_ready(&mut running, NODES);
    let keys = runtime.path().join("whirlstand").join(&bench);
    let show = |place| spawn(command_in(whirlstand(["keys", "show", &bench, "--path"]), place)).finish();
    // The lock records where the keys are, so that another shell finds them as well.
    for place in [Some(runtime.path()), None] {
        assert_eq!(Path::new(show(place).success().stdout.trim()), keys.join("observer.json5"));
    }
    kill_with_all(running);
    assert!(keys.join("observer.json5").is_file(), "nothing is left, so this test shows nothing");
    let gone = show(Some(runtime.path()));
    assert!(gone.code() == 2 && gone.stderr.contains("no bench"), "{}", gone.stderr);
    let listed = cleaned(&["--dry-run"]);
    let left = entry(&listed, "with-keys").unwrap_or_else(|| panic!("{listed}"));
    assert!(left["files"].as_u64().unwrap() >= 3, "the lock and the keys: {left}");
    assert_eq!(entry(&cleaned(&[]), "with-keys").unwrap()["removed"], true);
    assert!(!keys.exists() && residue(&bench).is_empty());

    // Keys whose lock was lost with the shared memory, as after a reboot.
    std::fs::create_dir(&keys).unwrap();
    std::fs::write(keys.join("observer.json5"), "").unwrap();
    let clean =
        || spawn(command_in(whirlstand(["clean", "--json"]), Some(runtime.path()))).finish().success();
    let again: Value = serde_json::from_str(&clean().stdout).unwrap();
    assert_eq!(entry(&again, "with-keys").unwrap_or_else(|| panic!("{again}"))["removed"], true);
    assert!(!keys.exists());
}

/// A command in a user session with this runtime folder, or without one.
fn command_in(mut command: Command, runtime: Option<&Path>) -> Command {
    match runtime {
        Some(runtime) => command.env("XDG_RUNTIME_DIR", runtime),
        None => command.env_remove("XDG_RUNTIME_DIR"),
    };
    command
}

/// Reaction of a program to the request to end: it records the request and ends (without starting a process, which
/// would be asked to end as well), or it ignores the request, as its child does.
const ENDS: &str = ": > \"$ASKED\"; exit";
const STUBBORN: &str = "";

/// A bench with a program that starts two children, one outside its process group, and writes the process numbers of
/// all.
fn with_program(dir: &Path, asked_to_end: &str, then: &str, duration: &str) -> (Command, PathBuf, PathBuf) {
    let (numbers, asked) = (dir.join("numbers"), dir.join("asked"));
    let script = format!(
        "ASKED={asked}\ntrap '{asked_to_end}' TERM\nsleep 1000 &\nCHILD=$!\nsetsid sleep 1000 &\n\
         echo $$ $CHILD $! > {numbers}.new\nmv {numbers}.new {numbers}\n{then}\n",
        asked = asked.display(),
        numbers = numbers.display()
    );
    let program = dir.join("program.sh");
    std::fs::write(&program, script).unwrap();
    let file = dir.join("bench.toml");
    let text = format!(
        "vehicle = 'quadrotor'\nduration_s = {duration}\n[controller]\nlaw = 'smc'\n\
         [nodes.helper]\nexec = ['sh', '{}']\nready = 'start'\n",
        program.display()
    );
    std::fs::write(&file, text).unwrap();
    let mut command = whirlstand(["run".as_ref(), file.as_os_str(), "--out".as_ref()]);
    command.arg(dir.join("out"));
    (command, numbers, asked)
}

/// Process numbers of the program and of its children.
fn numbers(path: &Path) -> Vec<i32> {
    until("the program was never started", || path.exists());
    let text = std::fs::read_to_string(path).unwrap();
    text.split_whitespace().map(|n| n.parse().unwrap()).collect()
}

fn children_of_a_program_go_with_its_node() {
    // The program ends when asked to; or it ends before the run does and leaves its child; or it ends only when killed.
    for (asked_to_end, then) in [(ENDS, "wait"), (ENDS, "exit 0"), (STUBBORN, "wait")] {
        let dir = tempfile::tempdir().unwrap();
        let (command, path, _) = with_program(dir.path(), asked_to_end, then, "0.5");
        let running = spawn(command);
        let all = numbers(&path);
        assert_eq!(all.len(), 3);
        let end = running.finish();
        assert!(end.code() <= 1, "{asked_to_end}, {then}: {}\n{}", end.stdout, end.stderr);
        all.into_iter().for_each(gone);
    }
}

fn a_program_is_asked_to_end_when_the_launcher_is_killed() {
    for asked_to_end in [ENDS, STUBBORN] {
        let dir = tempfile::tempdir().unwrap();
        let (command, path, asked) = with_program(dir.path(), asked_to_end, "wait", "1000");
        let running = spawn(command);
        let all = numbers(&path);
        assert_eq!(all.len(), 3);
        running.signal(libc::SIGKILL);
        running.finish();
        all.into_iter().for_each(gone);
        assert_eq!(asked.exists(), asked_to_end == ENDS, "it had time to bring what it moves to neutral");
    }
}

/// Collects files and folders below a path that users other than its owner can read, write or enter.
fn open_to_others(path: &Path, found: &mut Vec<PathBuf>) {
    let Ok(metadata) = path.symlink_metadata() else { return };
    if metadata.permissions().mode() & 0o077 != 0 {
        found.push(path.into());
    } else if metadata.is_dir() {
        std::fs::read_dir(path)
            .into_iter()
            .flatten()
            .flatten()
            .for_each(|e| open_to_others(&e.path(), found));
    }
}

fn only_the_user_can_read_what_a_run_creates() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let bench = unique("modes");
    // The most permissive mask that a shell can have.
    let mut command = Command::new("sh");
    let own = env!("CARGO_BIN_EXE_whirlstand");
    command.args([
        "-c",
        "umask 0; exec \"$@\"",
        "sh",
        own,
        "run",
        "--log-level",
        "debug",
        "--duration",
        "1000",
    ]);
    command.args(["--bench", &bench, "--out"]).arg(&out);
    let mut running = spawn(command);
    all_ready(&mut running, NODES);
    let mut open = Vec::new();
    // The contents of a closed folder are closed, whatever their own modes.
    let shared = residue(&bench).into_iter().filter(|p| !p.starts_with("/tmp"));
    let places = shared.chain([out.clone(), format!("/tmp/whirlstand.{bench}").into()]);
    // SAFETY: geteuid(2) only reads the process's own user.
    let runtime = format!("/dev/shm/whirlstand-{}", unsafe { libc::geteuid() });
    places.chain([runtime.into()]).for_each(|path| open_to_others(&path, &mut open));
    // Of iceoryx2's own folder only the top level counts.
    open.retain(|path| path.parent().is_none_or(|p| !p.starts_with(format!("/tmp/whirlstand.{bench}"))));
    assert_eq!(open, Vec::<PathBuf>::new());
    running.signal(libc::SIGINT);
    assert_eq!(running.finish().code(), 130);
    open_to_others(&out, &mut open);
    assert!(out.join("report.html").is_file() && out.join("summary.json").is_file());
    assert_eq!(open, Vec::<PathBuf>::new());
}

/// A run in a mount namespace of its own, with shared memory of this size.
fn with_shared_memory(size: &str, out: &Path) -> Result<Command, Missing> {
    let small = format!("mount -t tmpfs -o size={size} tmpfs /dev/shm && exec \"$@\"");
    let apart = ["-rm", "sh", "-c", &small, "sh"];
    match Command::new("unshare").args(apart).arg("true").output() {
        Ok(done) if done.status.success() => {}
        Ok(done) => {
            let said = String::from_utf8_lossy(&done.stderr).trim().to_string();
            return Err(Missing::beyond_this_machine("no mount namespaces", said));
        }
        Err(e) => return Err(Missing::installable(format!("no unshare ({e})"), "install util-linux")),
    }
    let mut command = Command::new("unshare");
    command.args(apart).arg(env!("CARGO_BIN_EXE_whirlstand"));
    command.args(["run", "--mode", "lockstep", "--duration", "1", "--set", FAULTS_ALLOWED, "--out"]).arg(out);
    Ok(command)
}

fn shared_memory_that_is_full_is_told_of() -> Outcome {
    let dir = tempfile::tempdir().unwrap();
    for size in ["8k", "600k", "1m", "3m", "6m", "10m", "12m"] {
        let end = spawn(with_shared_memory(size, dir.path())?).finish();
        assert_eq!(end.code(), 2, "{size}: {}\n{}", end.stdout, end.stderr);
        let said = end.stdout + &end.stderr;
        assert!(!said.contains("SIGBUS"), "{size}: {said}");
        for word in ["shared memory is full", "needs", "MiB free of", "--shm-size", "whirlstand clean"] {
            assert!(said.contains(word), "{size}: {word:?} is missing in:\n{said}");
        }
    }
    spawn(with_shared_memory("64m", dir.path())?).finish().success();
    Ok(())
}
