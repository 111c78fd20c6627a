//! The CRSF bridge and an SBUS pilot as a whole process, over pseudo-terminals, against a transmitter module and a receiver
//! written from the published layouts alone.

mod support;

use std::path::Path;
use std::process::Command;

use serde_json::Value;
use support::{json, spawn, whirlstand};

/// Roll and throttle channels that were seen in a phase.
fn seen(report: &Value, phase: usize) -> Vec<(i64, i64)> {
    let list = report["phases"][phase].as_array().unwrap();
    list.iter().map(|v| (v[0].as_i64().unwrap(), v[1].as_i64().unwrap())).collect()
}

#[test]
fn the_pilot_arms_takes_over_and_a_lost_link_is_neutral() {
    let dir = tempfile::tempdir().unwrap();
    let (module, receiver) = (dir.path().join("module"), dir.path().join("receiver"));
    let report = dir.path().join("report.json");
    let phases = serde_json::json!([
        [4.0, {"arm": false, "automatic": true}],
        [2.0, {"arm": true, "automatic": true}],
        [1.5, {"arm": true, "automatic": false, "roll": 1700}],
        [1.5, {"arm": true, "automatic": true}],
        [4.0, {"arm": true, "automatic": true, "telemetry": false}],
        [1.5, {"arm": true, "automatic": false, "failsafe": true, "telemetry": false}],
    ]);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bridge/radio.py");
    let mut radio = Command::new("python3");
    radio.arg(script).args([&module, &receiver, &report]).arg(phases.to_string());
    let radio = spawn(radio);
    let file = dir.path().join("crsf.toml");
    let text = format!(
        r#"
vehicle = "quadrotor"
rate_hz = 100.0
duration_s = 60.0
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
        module.display(),
        receiver.display()
    );
    std::fs::write(&file, text).unwrap();
    let out = dir.path().join("out");
    let bench = spawn(whirlstand(["run", file.to_str().unwrap(), "--out", out.to_str().unwrap()]));
    radio.finish().success();
    bench.signal(libc::SIGINT);
    let end = bench.finish();
    let report = json(&report);
    assert_eq!(report["faults"].as_array().unwrap().len(), 0, "{}\n{}", report["faults"], end.stderr);
    assert!(report["frames"].as_u64().unwrap() > 300, "{report}");
    assert!(seen(&report, 0).iter().all(|s| *s == (1500, 1000)), "disarmed: {report}\n{}", end.stderr);
    let automatic = seen(&report, 1);
    assert!(automatic.iter().any(|s| (s.0 - 1500).abs() > 20), "automatic: {report}\n{}", end.stderr);
    assert!(automatic.iter().all(|s| (1000..=2000).contains(&s.0) && (s.1 - 1200).abs() <= 1), "{report}");
    let near = |v: (i64, i64), want: (i64, i64)| (v.0 - want.0).abs() <= 1 && (v.1 - want.1).abs() <= 1;
    assert!(seen(&report, 2).iter().all(|s| near(*s, (1700, 1200))), "manual: {report}");
    assert!(seen(&report, 3).iter().any(|s| (s.0 - 1500).abs() > 20), "automatic again: {report}");
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
}
