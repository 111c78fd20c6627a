//! Limits of the environment: full disks, low resource limits, programs with endless output, names that point outside
//! their folder, and signals during a computation.

use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use crate::support::{Finished, HUNG, run, spawn, whirlstand};

/// A short flight that needs neither real time nor shared memory.
const INPROC: [&str; 7] =
    ["run", "quadrotor-lqr", "--transport", "inproc", "--mode", "lockstep", "--duration"];

fn with_limit(mut command: Command, resource: libc::__rlimit_resource_t, limit: u64) -> Finished {
    // SAFETY: setrlimit(2) is async-signal-safe and reads a structure that lives.
    unsafe {
        command.pre_exec(move || {
            let limit = libc::rlimit { rlim_cur: limit, rlim_max: limit };
            match libc::setrlimit(resource, &raw const limit) {
                0 => Ok(()),
                _ => Err(std::io::Error::last_os_error()),
            }
        });
    }
    spawn(command).finish()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn a_full_disk_is_told_and_the_verdict_survives_it() {
    for file in ["summary.json", "report.html"] {
        let dir = tempfile::tempdir().unwrap();
        std::os::unix::fs::symlink("/dev/full", dir.path().join(file)).unwrap();
        let end = run(INPROC.into_iter().chain(["9", "--out", text(dir.path())]));
        assert_eq!(end.code(), 2, "{}\n{}", end.stdout, end.stderr);
        assert!(end.stderr.contains(file) && end.stderr.contains("the disk is full"), "{}", end.stderr);
        assert!(end.stdout.contains("completed") && end.stdout.contains("expected"), "{}", end.stdout);
    }
}

fn low_limits_are_an_error_and_no_abort() {
    let dir = tempfile::tempdir().unwrap();
    for transport in ["iceoryx2", "zenoh", "inproc"] {
        for (resource, limit, words) in [
            (libc::RLIMIT_NOFILE, 8, "files here, but a bench needs"),
            (libc::RLIMIT_NOFILE, 64, "files here, but a bench needs"),
            (libc::RLIMIT_AS, 100 << 20, "MB of memory here"),
        ] {
            let args = ["run", "quadrotor", "--transport", transport, "--no-log", "--out", text(dir.path())];
            let end = with_limit(whirlstand(args), resource, limit);
            assert_eq!(end.code(), 2, "{transport} {limit}\n{}", end.stderr);
            assert!(end.stderr.contains(words), "{transport} {limit}\n{}", end.stderr);
        }
    }
    let record = dir.path().join("long.csv");
    let rows: String = (0..200_000).map(|i| format!("{i},0.1,0.2,0.3,0.4,0.5,0.6\n")).collect();
    std::fs::write(&record, format!("t[ms],u_roll,u_pitch,roll,pitch,roll_rate,pitch_rate\n{rows}")).unwrap();
    let end = with_limit(
        whirlstand(["compare", text(&record), "--vehicle", "quadrotor"]),
        libc::RLIMIT_AS,
        60 << 20,
    );
    assert_eq!(end.code(), 2, "{}", end.stderr);
    assert!(end.stderr.contains("out of memory"), "{}", end.stderr);
}

fn a_program_that_writes_without_end_is_bounded_and_counted() {
    let dir = tempfile::tempdir().unwrap();
    let (file, script) = (dir.path().join("loud.toml"), dir.path().join("loud.sh"));
    // One stream without any line end, and one of lines that clear the screen.
    std::fs::write(&script, "yes | tr -d '\\n' >&2 &\nexec yes \"$(printf '\\033[2Jhello')\"\n").unwrap();
    let bench = "vehicle = 'quadrotor'\nmode = 'lockstep'\nduration_s = 200\ncontroller.law = 'lqr'\n";
    let loud = format!("[nodes.loud]\nexec = ['sh', '{}']\nready = 'start'\n", text(&script));
    std::fs::write(&file, format!("{bench}{loud}")).unwrap();
    let began = Instant::now();
    let out = dir.path().join("out");
    let end = run(["run", text(&file), "--out", text(&out)]).success();
    assert!(began.elapsed() < HUNG / 2, "{:?}", began.elapsed());
    let beginning: String = end.stderr.chars().take(2000).collect();
    assert!(end.stderr.contains("lines dropped"), "{beginning}");
    assert!(end.stderr.contains("\\u{1b}[2Jhello") && !end.stderr.contains('\u{1b}'), "{beginning}");
    let most = 400 * (2 + began.elapsed().as_secs() as usize);
    assert!(end.stderr.lines().count() < most, "{} lines", end.stderr.lines().count());
}

fn names_from_a_file_stay_in_their_folder_and_control_characters_in_the_file() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("evil.toml");
    for name in ["/x/y", "../../x", "..", "a\\u001b[2Jb"] {
        let text = format!("name = \"{name}\"\nvehicle = 'quadrotor'\ncontroller.law = 'lqr'\n");
        std::fs::write(&file, text).unwrap();
        let end = spawn({
            let mut command = whirlstand(["run", file.to_str().unwrap(), "--no-log"]);
            command.current_dir(dir.path());
            command
        })
        .finish();
        assert_eq!(end.code(), 2, "{}", end.stderr);
        assert!(
            end.stderr.contains("evil.toml, line 1") && end.stderr.contains("names a folder"),
            "{}",
            end.stderr
        );
        assert!(!dir.path().join("out").exists());
    }
    let record = dir.path().join("evil.csv");
    std::fs::write(&record, "t,a\u{1b}[2Jb\n0,1\n1,2\n").unwrap();
    let end = run(["compare", text(&record), "--vehicle", "quadrotor"]);
    assert_eq!(end.code(), 2);
    assert!(end.stderr.contains("a\\u{1b}[2Jb") && !end.stderr.contains('\u{1b}'), "{}", end.stderr);
}

fn a_second_signal_ends_what_still_computes() {
    let dir = tempfile::tempdir().unwrap();
    let mut running = spawn(whirlstand(INPROC.into_iter().chain(["1e6", "--out", text(dir.path())])));
    running.wait_for_stderr("steps/s");
    running.signal(libc::SIGTERM);
    running.wait_for_stderr("stopping the bench cleanly");
    let asked = Instant::now();
    // The report on the flight takes a while; a second signal ends the run without waiting for it.
    std::thread::sleep(Duration::from_millis(300));
    running.signal(libc::SIGTERM);
    let end = running.finish();
    assert_eq!(end.code(), 128 + libc::SIGTERM, "{}", end.stderr);
    assert!(asked.elapsed() < Duration::from_secs(3), "{:?}", asked.elapsed());
}

fn sigterm_ends_blind_trials_that_compute() {
    let dir = tempfile::tempdir().unwrap();
    let blind = spawn(whirlstand(["blind", "--trials", "8", "--jobs", "1", "--keep", text(dir.path())]));
    let until = Instant::now() + HUNG;
    let begun = || {
        let trials = std::fs::read_dir(dir.path().join("trials")).into_iter().flatten().flatten();
        trials.map(|t| t.path()).find(|t| t.join("stderr.txt").exists())
    };
    let trial = loop {
        assert!(Instant::now() < until, "no diagnosis has begun");
        match begun() {
            Some(trial) => break trial,
            None => std::thread::sleep(Duration::from_millis(5)),
        }
    };
    blind.signal(libc::SIGTERM);
    let asked = Instant::now();
    let end = blind.finish();
    assert_eq!(end.code(), 130, "{}\n{}", end.stdout, end.stderr);
    assert!(asked.elapsed() < Duration::from_secs(5), "{:?}", asked.elapsed());
    assert!(end.stderr.contains("cover 0 of 8 trials"), "{}", end.stderr);
    assert!(!trial.join("diagnosis.json").exists(), "what had begun is dropped");
}

fn simulate_refuses_what_no_memory_holds_and_what_no_quantity_is() {
    let dir = tempfile::tempdir().unwrap();
    let (input, output) = (dir.path().join("in.csv"), dir.path().join("out.csv"));
    for (text, more, words) in [
        ("t,u_roll,u_pitch\n0,0,0\n600,0,0\n", &["--rate", "1e6"][..], ["in.csv: 600 s", "at most 10000000"]),
        (
            "t,u_roll,u_pitch\n0,0,0\n0.000000001,0,0\n0.000000002,0,0\n1e6,1,1\n",
            &[],
            ["in.csv", "at most 10000000"],
        ),
        ("t,u_roll,u_pitch\n0,0,0\n1,0,1e308\n", &[], ["line 3, column 3 (u_pitch)", "1e308"]),
        ("t,u_roll,u_pitch\n0,0,\n1,0,NaN\n", &[], ["column 3 (u_pitch)", "the column has no values"]),
        ("t,u_roll,u_pitch,x\n0,0,0,1\n1,0,0,1\n", &["--map", "u_roll=x[m]"], ["'u_roll'", "a pure number"]),
        ("t,u_roll,u_pitch,x\n0,0,0,1\n1,0,0,1\n", &["--map", "roll=x[m]"], ["'roll'", "rad is expected"]),
    ] {
        std::fs::write(&input, text).unwrap();
        let began = Instant::now();
        let args = ["simulate", "quadrotor", "--input", self::text(&input), "--output", self::text(&output)];
        let end = run(args.into_iter().chain(more.iter().copied()));
        assert_eq!(end.code(), 2, "{text}\n{}", end.stderr);
        assert!(words.iter().all(|word| end.stderr.contains(word)), "{text}\n{}", end.stderr);
        assert!(began.elapsed() < Duration::from_secs(1), "{text}: {:?}", began.elapsed());
    }
    // `simulate` ignores errors in columns that it does not use.
    std::fs::write(&input, "t,u_roll,u_pitch,roll[m],pitch\n0,0,0,1,\n1,0,0,1,\n").unwrap();
    run(["simulate", "quadrotor", "--input", text(&input), "--output", text(&output)]).success();
    let end = run(["compare", text(&input), "--vehicle", "quadrotor"]);
    assert!(
        end.code() == 2 && end.stderr.contains("'roll'") && end.stderr.contains("is in m"),
        "{}",
        end.stderr
    );
}

whirlstand_test_harness::listed!(
    a_full_disk_is_told_and_the_verdict_survives_it,
    low_limits_are_an_error_and_no_abort,
    a_program_that_writes_without_end_is_bounded_and_counted,
    names_from_a_file_stay_in_their_folder_and_control_characters_in_the_file,
    a_second_signal_ends_what_still_computes,
    sigterm_ends_blind_trials_that_compute,
    simulate_refuses_what_no_memory_holds_and_what_no_quantity_is,
);
