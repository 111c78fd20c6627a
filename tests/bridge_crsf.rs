//! The CRSF bridge and an SBUS pilot as a whole process, over pseudo-terminals, against a transmitter module and a receiver
//! written from the published layouts alone.

mod support;

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::{Value, json as value};
use support::{json, said, spawn, spawn_listening, whirlstand};
use whirlstand_test_harness::undisturbed;

/// The module's line, the receiver's line, and the report of both.
struct Place {
    dir: tempfile::TempDir,
    module: PathBuf,
    receiver: PathBuf,
    report: PathBuf,
}

impl Place {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let [module, receiver, report] = ["module", "receiver", "report.json"].map(|n| dir.path().join(n));
        Self { dir, module, receiver, report }
    }

    fn radio(&self, script: &str) -> Command {
        let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bridge/radio.py");
        // Where there is the tests' own Python, it has another reader of the same frames.
        let mut radio =
            Command::new(std::env::var_os("WHIRLSTAND_PYTHON").unwrap_or_else(|| "python3".into()));
        radio.arg(program).args([&self.module, &self.receiver, &self.report]).arg(script);
        radio
    }

    fn launch(&self) -> String {
        let file = self.dir.path().join("crsf.toml");
        let text = format!(
            r#"
vehicle = "quadrotor"
rate_hz = 100.0
duration_s = 100.0
[controller]
law = "lqr"
[nodes.plant]
bridge = "crsf"
[bridge.safety]
stale_s = 1.0                 # a busy test machine is not what is tested
command_timeout_s = 5.0
max_innovation = 1e9          # what flies here is a wave that obeys nobody
[bridge.crsf]
link = "serial://{}:420000"
[bridge.pilot]
source = "sbus"
link = "serial://{}:100000:8E2"
"#,
            self.module.display(),
            self.receiver.display()
        );
        std::fs::write(&file, text).unwrap();
        file.display().to_string()
    }
}

/// Roll and throttle channels that were seen in a phase.
fn seen(report: &Value, phase: usize) -> Vec<(i64, i64)> {
    let list = report["phases"][phase].as_array().unwrap();
    list.iter().map(|v| (v[0].as_i64().unwrap(), v[1].as_i64().unwrap())).collect()
}

#[test]
fn the_pilot_arms_takes_over_and_a_lost_link_is_neutral() {
    undisturbed(|| {
        let place = Place::new();
        let phases = value!([
            ["disarmed", {"arm": false, "automatic": true}],
            ["automatic", {"arm": null, "automatic": true}],
            ["manual", {"arm": true, "automatic": false, "roll": 1700}],
            ["automatic", {"arm": true, "automatic": true}],
            ["neutral", {"arm": true, "automatic": true, "telemetry": false}],
            ["disarmed", {"arm": true, "automatic": false, "failsafe": true, "telemetry": false}],
        ]);
        let radio = spawn(place.radio(&phases.to_string()));
        let out = place.dir.path().join("out");
        let bench = spawn(whirlstand(["run", &place.launch(), "--out", out.to_str().unwrap()]));
        radio.finish().success();
        bench.signal(libc::SIGINT);
        let end = bench.finish();
        let report = json(&place.report);
        assert_eq!(report["faults"].as_array().unwrap().len(), 0, "{}\n{}", report["faults"], end.stderr);
        assert!(report["frames"].as_u64().unwrap() >= 300, "{report}");
        if std::env::var_os("CI").is_some_and(|ci| !ci.is_empty()) {
            assert_eq!(report["judged"], report["frames"], "no crsf-parser: install tests/requirements.txt");
        }
        assert!(seen(&report, 0).iter().all(|s| *s == (1500, 1000)), "disarmed: {report}\n{}", end.stderr);
        let automatic = seen(&report, 1);
        assert!(!automatic.is_empty(), "automatic: {report}\n{}", end.stderr);
        assert!(
            automatic.iter().all(|s| (1000..=2000).contains(&s.0) && (s.1 - 1200).abs() <= 1),
            "{report}"
        );
        let near = |v: (i64, i64), want: (i64, i64)| (v.0 - want.0).abs() <= 1 && (v.1 - want.1).abs() <= 1;
        assert!(seen(&report, 2).iter().all(|s| near(*s, (1700, 1200))), "manual: {report}");
        assert!(!seen(&report, 3).is_empty(), "automatic again: {report}");
        assert!(seen(&report, 4).iter().all(|s| near(*s, (1500, 1200))), "telemetry lost: {report}");
        assert!(seen(&report, 5).iter().all(|s| near(*s, (1500, 1000))), "pilot lost: {report}");
        for words in [
            "the controller is in charge",
            "the pilot is in charge",
            "attitude is stale",
            "the pilot's stick is not heard",
        ] {
            assert!(end.stderr.contains(words), "{words}: {}", end.stderr);
        }
    });
}

#[test]
fn the_check_says_which_axis_of_the_telemetry_is_turned() {
    undisturbed(|| {
        let place = Place::new();
        let launch = place.launch();
        let check = whirlstand(["bridge", "check", "plant", "--launch", &launch, "--timeout", "30"]);
        let (radio, check) = spawn_listening(place.radio("by hand"), check);
        let checked = check.finish();
        radio.signal(libc::SIGTERM);
        radio.finish().success();
        let said = said(&place.report);
        assert_eq!(checked.code(), 1, "{said:?}\n{}", checked.stderr);
        for words in [
            ["ok", "0 messages damaged, 0 lost"],
            ["WRONG", "roll: the sign is turned; set bridge.measured.roll.scale = -1"],
            ["ok", "pitch: +"],
            ["ok", "yaw: +"],
            ["not checked", "channel 1: the vehicle does not tell its channels"],
            ["not checked", "channel 1: which way it turns the vehicle"],
        ] {
            assert!(said.iter().any(|l| words.iter().all(|w| l.contains(w))), "{words:?}: {said:#?}");
        }
        assert_eq!(json(&place.report)["faults"], value!([]));
    });
}
