//! Betaflight itself, as software in the loop, flies the example as its manual says. WHIRLSTAND_BETAFLIGHT_SITL names its
//! program; without it this test is ignored, because Betaflight is not ours to ship and takes minutes to build.

mod support;

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use support::{HUNG, Running, json, run, spawn};
use whirlstand_test_harness::{Missing, Outcome, betaflight_sitl};

/// What its manual page has the user type.
const SETTINGS: [&str; 3] =
    ["aux 0 0 0 1700 2100 0 0", "aux 1 1 1 1700 2100 0 0", "set acc_calibration = 0,0,0,1"];

/// The program, in a folder of its own for its settings.
fn betaflight(folder: &Path) -> Result<Running, Missing> {
    let mut command = Command::new(betaflight_sitl()?);
    command.current_dir(folder);
    Ok(spawn(command))
}

/// Types a line into its command line, and reads on to the next prompt, or to the end.
fn ask(link: &mut TcpStream, line: &str) {
    link.write_all(format!("{line}\n").as_bytes()).unwrap();
    let (mut heard, mut byte) = (Vec::new(), [0]);
    while !heard.ends_with(b"\n# ") && link.read(&mut byte).is_ok_and(|n| n > 0) {
        heard.push(byte[0]);
    }
}

/// Sets it up and starts it anew.
fn set_up(folder: &Path) -> Result<Running, Missing> {
    let first = betaflight(folder)?;
    let until = Instant::now() + HUNG;
    let mut link = loop {
        match TcpStream::connect("127.0.0.1:5761") {
            Ok(link) => break link,
            Err(e) => assert!(Instant::now() < until, "no command line: {e}"),
        }
    };
    link.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    ask(&mut link, "#");
    SETTINGS.iter().for_each(|line| ask(&mut link, line));
    ask(&mut link, "save");
    // It ends where a board would reboot.
    first.finish();
    betaflight(folder)
}

fn betaflight_follows_each_axis_and_holds_the_attitude_against_gusts() -> Outcome {
    let dir = tempfile::tempdir().unwrap();
    let autopilot = set_up(dir.path())?;
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/betaflight/flight.toml");
    let example = example.to_str().unwrap();
    let check = run(["bridge", "check", "controller", "--launch", example, "--arm"]);
    assert_eq!(check.code(), 0, "{}{}", check.stdout, check.stderr);
    assert_eq!(check.stdout.matches("they push back").count(), 6, "{}", check.stdout);
    drop(autopilot);

    let _autopilot = betaflight(dir.path())?;
    let out = dir.path().join("out");
    // Deadlines of a busy test machine are not what is tested.
    let ended = run(["run", example, "--out", out.to_str().unwrap()]).success();
    let outputs = &json(out.join("summary.json"))["runs"][0]["outputs"];
    for axis in ["roll", "pitch"] {
        let peak = outputs[axis]["peak"].as_f64().unwrap();
        assert!((0.02..0.35).contains(&peak), "{axis}: {outputs}\n{}", ended.stderr);
        assert_eq!(outputs[axis]["recovered"], true, "{axis}: {outputs}\n{}", ended.stderr);
    }
    Ok(())
}

whirlstand_test_harness::tests!(betaflight_follows_each_axis_and_holds_the_attitude_against_gusts);
