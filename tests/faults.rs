//! Nodes that are killed or stand still, at random times, again and again: the bench survives and says so.

mod support;

use std::time::Duration;

use serde_json::Value;
use support::{Finished, json, spawn, whirlstand};
use whirlstand_test_harness::undisturbed;

/// Twenty faults of a few seconds each.
const LIMIT: Duration = Duration::from_secs(240);

fn soak(fault: &str, more: &[&str]) -> (Finished, Value) {
    let dir = tempfile::tempdir().unwrap();
    let result = dir.path().join("soak.json");
    let args = ["soak", "--fault", fault, "--rounds", "5", "--json", result.to_str().unwrap()];
    let end = spawn(whirlstand(args.iter().chain(more))).finish_within(LIMIT);
    assert_eq!(end.code(), 0, "{}\n{}", end.stdout, end.stderr);
    (end, json(result))
}

/// Every fault of every node was followed by a recovery. A node that gives commands and was away for longer than the
/// plant's patience was missed, and the plant held its last command no longer than stated.
#[track_caller]
fn assert_survived(result: &Value) {
    assert_eq!(result["ok"], true, "{result}");
    let nodes = result["nodes"].as_array().expect("nodes");
    assert_eq!(nodes.len(), 4, "{result}");
    for node in nodes {
        assert_eq!((&node["faults"], &node["recovered"]), (&5.into(), &5.into()), "{node}");
    }
    let patience_s = if result["mode"] == "lockstep" { 0.4 } else { 0.1 };
    let allowed = result["misses_to_failsafe"].as_u64().expect("a limit");
    for fault in result["faults"].as_array().expect("faults") {
        // A node that was only stopped is away for the whole stop.
        let away_s = fault["restart_s"].as_f64().unwrap_or(2.0);
        let commands = ["estimator", "controller"].iter().any(|n| fault["node"] == *n);
        match fault["held_before_failsafe"].as_u64() {
            Some(held) => assert!(held < allowed, "{fault}"),
            None => assert!(!commands || away_s < patience_s, "no failsafe: {fault}"),
        }
    }
}

#[test]
fn every_node_can_be_killed_over_shared_memory() {
    undisturbed(|| {
        assert_survived(&soak("kill", &["--seed", "11"]).1);
    });
}

#[test]
fn every_node_can_be_killed_over_zenoh() {
    undisturbed(|| {
        assert_survived(&soak("kill", &["--seed", "12", "--transport", "zenoh"]).1);
    });
}

#[test]
fn every_node_can_be_killed_in_lockstep() {
    undisturbed(|| {
        assert_survived(&soak("kill", &["--seed", "13", "--mode", "lockstep"]).1);
    });
}

#[test]
fn every_node_can_stand_still_for_two_seconds() {
    undisturbed(|| {
        assert_survived(&soak("stop", &["--seed", "14", "--stop-for", "2"]).1);
    });
}
