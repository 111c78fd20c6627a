use whirlstand_msgs::{Message, text_field};
use whirlstand_vehicle::Vehicle;

use super::*;
use crate::config::{ControllerConfig, LawKind, MirrorConfig, OnFinding, VehicleSource};

const PERIOD_NS: u64 = 5_000_000;

fn laws() -> Laws {
    let vehicle = Vehicle::builtin("quadrotor").unwrap();
    let text = serde_json::json!({
        "bench": "laws", "transport": "inproc", "mode": "lockstep", "period_ns": PERIOD_NS, "steps": 10_000, "seed": 1,
        "vehicle": VehicleSource { origin: "quadrotor".into(), text: vehicle.source_text },
        "peers": [], "start_timeout_s": 5.0, "telemetry": false,
        "controller": ControllerConfig::new(LawKind::Lqr),
        "mirror": MirrorConfig { on_finding: OnFinding::Law },
    });
    let config: NodeConfig = serde_json::from_value(text).unwrap();
    let setup = Setup::new(&config).unwrap();
    Laws::new(&config, &setup)
}

fn found(stage: FindingStage, at_s: f64, since_s: f64, factor: f64) -> Finding {
    let step = (at_s * 1e9) as u64 / PERIOD_NS;
    let mut finding =
        Finding { number: 1, since_ns: (since_s * 1e9) as u64, stage: stage as u32, ..Finding::zeroed() };
    (finding.head.step, finding.head.stamp_ns) = (step, step * PERIOD_NS);
    (finding.effect, finding.place) = (text_field("input_gain"), text_field("u_roll"));
    (finding.names, finding.count, finding.probability) = (text_field("factor"), 1, 0.99);
    (finding.value[0], finding.low[0], finding.high[0]) = (factor, factor - 0.02, factor + 0.02);
    finding
}

/// Advances from one time to another; returns the findings with their times.
fn turn(laws: &mut Laws, from_s: f64, to_s: f64) -> Vec<(f64, FindingStage, f64)> {
    let steps = (from_s / 0.005).round() as u64..(to_s / 0.005).round() as u64;
    let said = steps.filter_map(|step| {
        let said = laws.turn(Head { seq: 0, step, stamp_ns: step * PERIOD_NS }).unwrap()?;
        assert_eq!(said.head.step, step);
        Some((step as f64 * 0.005, FindingStage::from_u32(said.stage).unwrap(), said.value[0]))
    });
    said.collect()
}

fn late(stage: FindingStage, at_s: f64, delay_s: f64) -> Finding {
    let mut finding = found(stage, at_s, 8.0, delay_s);
    (finding.effect, finding.names) = (text_field("input_delay"), text_field("delay_s"));
    (finding.low[0], finding.high[0]) = (delay_s - 0.01, delay_s + 0.01);
    finding
}

#[test]
fn a_law_flies_once_its_cause_has_stood_and_comes_back_when_that_is_over() {
    let mut laws = laws();
    laws.hear(&late(FindingStage::Wrong, 8.1, 0.0));
    assert!(turn(&mut laws, 8.1, 9.0).is_empty(), "nothing is known yet");
    laws.hear(&late(FindingStage::Named, 9.0, 0.2));
    // Twice the second that it took to name it, and half a second for the evaluation.
    let said = turn(&mut laws, 9.0, 30.0);
    assert_eq!(said, [(10.5, FindingStage::Law, 0.2)]);
    // Within the interval, the law stays.
    laws.hear(&late(FindingStage::Revised, 30.0, 0.205));
    assert!(turn(&mut laws, 30.0, 50.0).is_empty());
    // Not sooner than ten seconds after the last change.
    laws.hear(&late(FindingStage::Over, 50.0, 0.2));
    let said = turn(&mut laws, 50.0, 90.0);
    assert!(matches!(said[..], [(at, FindingStage::FirstLaw, _)] if at >= 20.5), "{said:?}");
}

#[test]
fn names_that_come_and_go_change_no_law() {
    let mut laws = laws();
    for k in 0..10u32 {
        let at = 10.0 + 3.0 * f64::from(k);
        laws.hear(&found(FindingStage::Named, at, at - 2.0, 0.5));
        assert!(turn(&mut laws, at, at + 1.5).is_empty());
        laws.hear(&found(FindingStage::Withdrawn, at + 1.5, at - 2.0, 0.5));
        assert!(turn(&mut laws, at + 1.5, at + 3.0).is_empty());
    }
}

#[test]
fn a_law_that_is_no_better_is_asked_for_once() {
    let mut laws = laws();
    laws.hear(&found(FindingStage::Named, 9.0, 8.0, 1.0));
    assert!(turn(&mut laws, 9.0, 12.0).is_empty(), "a gain of one is no change");
    assert!(laws.refused.is_some() && laws.job.is_none());
    let mut nothing = found(FindingStage::Named, 40.0, 39.0, 0.02);
    nothing.effect = text_field("vibration");
    laws.hear(&nothing);
    assert!(turn(&mut laws, 40.0, 45.0).is_empty(), "no law is designed for it");
    assert_eq!(text_of(&laws.refused.unwrap().effect), "vibration");
}

#[test]
fn a_judgement_that_takes_long_is_waited_for_in_lockstep_without_standing_still() {
    for waits in [true, false] {
        let mut laws = Laws { waits, ..laws() };
        let (end, ended) = std::sync::mpsc::channel();
        let work = move || {
            ended.recv().unwrap();
            Err("too slow".into())
        };
        laws.job =
            Some(Job { cause: late(FindingStage::Named, 9.0, 0.2), due: 100, thread: thread::spawn(work) });
        assert!(!laws.is_late(99));
        assert_eq!(laws.is_late(100), waits);
        end.send(()).unwrap();
        while !laws.job.as_ref().unwrap().thread.is_finished() {
            thread::yield_now();
        }
        assert!(!laws.is_late(100));
    }
}
