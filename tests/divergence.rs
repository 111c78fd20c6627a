//! When a simulated vehicle leaves its model, the run ends and counts as failed.

use std::path::Path;

use crate::support::{json, run};
use serde_json::Value;

/// A spring with a negative cubic stiffness: roll grows until the model has no finite result.
const SPRING: &str =
    "\n[[effects]]\neffect = \"cubic_stiffness\"\nwhere = \"roll->roll_rate\"\ncoefficient = -1e6\n";

/// Flies a bench that diverges; returns its output and log info.
fn diverges(dir: &Path, name: &str, text: &str, mode: &str, transport: &str) -> (String, Value) {
    let (launch, out) = (dir.join(format!("{name}.toml")), dir.join(name));
    std::fs::write(&launch, text).unwrap();
    let (launch, out_arg) = (launch.to_str().unwrap(), out.to_str().unwrap());
    let end = run(["run", launch, "--mode", mode, "--transport", transport, "--out", out_arg]);
    assert_eq!(end.code(), 1, "{name}: {}\n{}", end.stdout, end.stderr);
    assert!(!end.stderr.contains("restarting it"), "{name}: {}", end.stderr);
    let info = run(["log", "info", out.join("log.mcap").to_str().unwrap(), "--json"]).success();
    let summary = json(out.join("summary.json"));
    assert!(summary["runs"][0]["ended"]["how"] == "failed", "{name}: {}", summary["runs"][0]["ended"]);
    (format!("{}\n{}", end.stdout, end.stderr), serde_json::from_str(&info.stdout).unwrap())
}

/// Message count of a topic.
fn messages(info: &Value, topic: &str) -> u64 {
    let topics = info["topics"].as_array().unwrap();
    topics.iter().find(|t| t["name"].as_str().unwrap().ends_with(topic)).unwrap()["messages"]
        .as_u64()
        .unwrap()
}

fn a_state_that_has_no_value_ends_the_run_at_that_step() {
    let dir = tempfile::tempdir().unwrap();
    let text = format!(
        "vehicle = \"quadrotor\"\nrate_hz = 200.0\nduration_s = 4.0\n[plant]\ninitial = {{ roll = \"0.2 rad\" }}\n\
         [controller]\nlaw = \"lqr\"\n{SPRING}"
    );
    let mut steps = Vec::new();
    for (mode, transport) in
        [("lockstep", "iceoryx2"), ("lockstep", "zenoh"), ("lockstep", "inproc"), ("realtime", "iceoryx2")]
    {
        let name = format!("{mode}-{transport}");
        let (said, info) = diverges(dir.path(), &name, &text, mode, transport);
        assert!(said.contains("left its model at step") && said.contains("roll"), "{name}: {said}");
        let (truths, commands) = (messages(&info, "truth"), messages(&info, "command"));
        assert!(truths > 1 && truths < 200 && commands + 1 >= truths, "{name}: {truths}, {commands}: {said}");
        if mode == "lockstep" {
            steps.push(truths);
        }
    }
    assert!(steps.windows(2).all(|s| s[0] == s[1]), "the same step over every transport: {steps:?}");
}

fn a_bound_of_the_file_ends_the_run_where_a_state_passes_it() {
    let dir = tempfile::tempdir().unwrap();
    let shown = run(["vehicle", "show", "quadrotor"]).success().stdout;
    let state = "{ name = \"roll\", unit = \"deg\"";
    assert_eq!(shown.matches(state).count(), 1, "{shown}");
    let bounded = shown.replace(state, &format!("{state}, bound = \"2 deg\""));
    std::fs::write(dir.path().join("vehicle.toml"), bounded).unwrap();
    let text = "vehicle = \"vehicle.toml\"\nrate_hz = 200.0\nduration_s = 4.0\n[controller]\nlaw = \"lqr\"\n\
                [[setpoint]]\nat_s = 1.0\nroll = \"5 deg\"\n";
    let (said, info) = diverges(dir.path(), "bounded", text, "lockstep", "inproc");
    assert!(said.contains("roll is 3.") && said.contains("its bound is 3.4907e-2"), "{said}");
    let truths = messages(&info, "truth");
    assert!((200..400).contains(&truths), "shortly after the step at 1 s: {truths}");
}

whirlstand_test_harness::listed!(
    a_state_that_has_no_value_ends_the_run_at_that_step,
    a_bound_of_the_file_ends_the_run_where_a_state_passes_it,
);
