//! A flight behind a bridge in which the controller was not in charge throughout is not a success: it ends with exit code 1
//! and names the broken limit, with and without a log.

use std::path::Path;
use std::process::Command;

use crate::support::bridged::Bridged;
use crate::support::flight::{free_tcp, free_udp};
use crate::support::{Finished, Running, json, run, spawn, whirlstand};
use serde_json::{Value, json as value};
use whirlstand_test_harness::{Missing, Outcome, python};

/// Further arguments of a run, whose limits are the strict ones either way.
const WITH_AND_WITHOUT_LOG: [&[&str]; 2] = [&[], &["--no-log"]];

/// The autopilot of a real vehicle behind MAVLink, and the bench that flies it.
struct Vehicle {
    dir: tempfile::TempDir,
    autopilot: Running,
    bench: Running,
}

impl Vehicle {
    /// Takes off; `more` are arguments of the autopilot, `rest` those of the bench, `pilot` is appended to the launch file.
    fn take_off(more: &[&str], pilot: &str, rest: &[&str]) -> Result<Self, Missing> {
        let python = python()?;
        let dir = tempfile::tempdir().unwrap();
        let port = free_udp();
        let bridged = Bridged {
            bridge: "mavlink",
            vehicle: "quadrotor",
            rate_hz: 100,
            duration_s: 6,
            safety: if pilot.is_empty() { "arm = \"autopilot\"\nstale_s = 1.0" } else { "stale_s = 1.0" },
            link: format!("udpin://127.0.0.1:{port}"),
            more: pilot,
        };
        let launch = bridged.write(dir.path()).display().to_string();
        let mut autopilot = Command::new(python);
        autopilot.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bridge/autopilot.py"));
        autopilot.args(["--rate", "100", "--link", &format!("udpout:127.0.0.1:{port}")]).args(more);
        autopilot.arg("--report").arg(dir.path().join("autopilot.json"));
        let autopilot = spawn(autopilot);
        let out = dir.path().join("out").display().to_string();
        let bench = spawn(whirlstand(["run", &launch, "--out", &out].iter().chain(rest)));
        Ok(Self { dir, autopilot, bench })
    }

    /// Waits for the end of the bench; returns its output, and the figures of the run.
    fn land(self) -> (Finished, Value) {
        let end = self.bench.finish();
        self.autopilot.signal(libc::SIGTERM);
        self.autopilot.finish();
        let run = json(self.dir.path().join("out/summary.json"))["runs"][0].clone();
        assert_eq!(run["ended"]["how"], "complete", "{}", end.stderr);
        (end, run)
    }
}

/// Asserts exit code 1, and that the limit of this key is reported as broken, with a value above 0.
#[track_caller]
fn breaks(end: &Finished, run: &Value, key: &str) {
    assert_eq!(end.code(), 1, "{}\n{}", end.stdout, end.stderr);
    let expect = run["expect"].as_array().unwrap();
    let broken = expect.iter().find(|e| e["key"] == key).unwrap();
    assert!(broken["found"].as_f64().is_some_and(|found| found > 0.0), "{broken}\n{}", end.stderr);
    assert!(end.stdout.contains(&format!("{key} is ")), "{}", end.stdout);
}

fn a_vehicle_that_is_flown_throughout_is_a_success() -> Outcome {
    for rest in WITH_AND_WITHOUT_LOG {
        // The limits of who is in charge remain; what a busy machine costs is not tested here.
        let busy = "expect={max_failsafe_share=0.5, max_refused_commands=1e9, max_rejected=1e9}";
        let rest = [rest, &["--set", busy]].concat();
        let (end, run) = Vehicle::take_off(&[], "", &rest)?.land();
        assert_eq!(end.code(), 0, "{rest:?}\n{}\n{}", end.stdout, end.stderr);
        let shares = (&run["timing"]["disarmed_share"], &run["timing"]["pilot_share"]);
        assert_eq!(shares, (&value!(0.0), &value!(0.0)), "{rest:?}");
        assert!(end.stderr.contains(" under lqr, "), "{}", end.stderr);
        assert_eq!(run["law"], "lqr");
    }
    Ok(())
}

fn a_vehicle_that_disarms_in_flight_fails_the_run() -> Outcome {
    let events = value!([{"when": "moved", "do": "disarm"}]).to_string();
    for rest in WITH_AND_WITHOUT_LOG {
        let (end, run) = Vehicle::take_off(&["--events", &events], "", rest)?.land();
        breaks(&end, &run, "max_disarmed_share");
    }
    Ok(())
}

fn a_vehicle_that_nobody_arms_fails_the_run() -> Outcome {
    for rest in WITH_AND_WITHOUT_LOG {
        let (end, run) = Vehicle::take_off(&["--arm-after", "1e9"], "", rest)?.land();
        breaks(&end, &run, "max_disarmed_share");
        assert_eq!(run["timing"]["disarmed_share"], 1.0, "{rest:?}");
    }
    Ok(())
}

fn a_vehicle_whose_autopilot_is_killed_fails_the_run() -> Outcome {
    for rest in WITH_AND_WITHOUT_LOG {
        let mut vehicle = Vehicle::take_off(&[], "", rest)?;
        vehicle.bench.wait_for_stderr("the controller is in charge");
        vehicle.autopilot.signal(libc::SIGKILL);
        let (end, run) = vehicle.land();
        breaks(&end, &run, "max_failsafe_share");
    }
    Ok(())
}

fn a_pilot_who_takes_over_fails_the_run() -> Outcome {
    // The radio's arm switch arms; the pilot takes over until the end.
    let phases = value!([
        ["disarmed", {"arm": false, "automatic": true, "frames": 50}],
        ["flown", {"arm": null, "automatic": true, "frames": 100}],
        ["manual", {"arm": true, "automatic": false, "frames": 100_000}],
    ]);
    for rest in WITH_AND_WITHOUT_LOG {
        let more = ["--pilot", &phases.to_string()];
        let (end, run) = Vehicle::take_off(&more, "[bridge.pilot]\nsource = \"mavlink\"", rest)?.land();
        breaks(&end, &run, "max_pilot_share");
    }
    Ok(())
}

/// Flies 10 s in lockstep with a stand-in for PX4 that is not a node of the bench.
fn px4(how: &[&str], rest: &[&str]) -> Result<(Finished, Value), Missing> {
    let dir = tempfile::tempdir().unwrap();
    let report = dir.path().join("report.json");
    let out = dir.path().join("out").display().to_string();
    let port = free_tcp().to_string();
    let mut autopilot = Command::new(python()?);
    autopilot.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/autopilots/px4.py"));
    let autopilot = spawn({
        autopilot.arg(&port).arg(&report).args(how);
        autopilot
    });
    let link = format!("bridge.px4.link=tcpin://127.0.0.1:{port}");
    let settings = ["nodes.controller.bridge=px4-hil", &link, "setpoint=[]", "expect={}"];
    let settings = settings.iter().flat_map(|set| ["--set", set]);
    let args = ["run", "quadrotor", "--duration", "10", "--mode", "lockstep", "--out", &out];
    let end = run(args.into_iter().chain(settings).chain(rest.iter().copied()));
    autopilot.finish();
    assert_eq!(json(&report)["faults"], value!([]), "{}", end.stderr);
    let run = json(dir.path().join("out/summary.json"))["runs"][0].clone();
    assert_eq!(run["ended"]["how"], "complete", "{}", end.stderr);
    Ok((end, run))
}

fn an_autopilot_that_flies_throughout_is_a_success_under_its_own_law() -> Outcome {
    for rest in WITH_AND_WITHOUT_LOG {
        let (end, run) = px4(&[], rest)?;
        assert_eq!(end.code(), 0, "{rest:?}\n{}\n{}", end.stdout, end.stderr);
        assert_eq!(run["timing"]["disarmed_share"], 0.0, "{rest:?}");
        assert!(end.stderr.contains(" under PX4, "), "{}", end.stderr);
        assert!(!end.stderr.contains("under smc"), "{}", end.stderr);
        assert_eq!(run["law"], "PX4");
    }
    Ok(())
}

fn an_autopilot_that_disarms_in_flight_fails_the_run() -> Outcome {
    for rest in WITH_AND_WITHOUT_LOG {
        let (end, run) = px4(&["--disarm-after", "1200"], rest)?;
        breaks(&end, &run, "max_disarmed_share");
    }
    Ok(())
}

fn an_autopilot_that_is_never_armed_fails_a_run_that_does_not_wait_for_it() -> Outcome {
    for rest in WITH_AND_WITHOUT_LOG {
        let rest = [rest, &["--set", "bridge.flight.begin=linked"]].concat();
        let (end, run) = px4(&["--disarmed"], &rest)?;
        breaks(&end, &run, "max_disarmed_share");
        assert_eq!(run["timing"]["disarmed_share"], 1.0, "{rest:?}");
    }
    Ok(())
}

fn an_autopilot_that_is_killed_in_flight_fails_the_run() -> Outcome {
    for rest in WITH_AND_WITHOUT_LOG {
        let (end, run) = px4(&["--die-after", "1200"], rest)?;
        breaks(&end, &run, "max_failsafe_share");
        assert!(run["timing"]["failsafe_at_end"].as_u64() > Some(100), "{}", run["timing"]);
    }
    Ok(())
}

whirlstand_test_harness::listed!(
    a_vehicle_that_is_flown_throughout_is_a_success,
    a_vehicle_that_disarms_in_flight_fails_the_run,
    a_vehicle_that_nobody_arms_fails_the_run,
    a_vehicle_whose_autopilot_is_killed_fails_the_run,
    a_pilot_who_takes_over_fails_the_run,
    an_autopilot_that_flies_throughout_is_a_success_under_its_own_law,
    an_autopilot_that_disarms_in_flight_fails_the_run,
    an_autopilot_that_is_never_armed_fails_a_run_that_does_not_wait_for_it,
    an_autopilot_that_is_killed_in_flight_fails_the_run
);
