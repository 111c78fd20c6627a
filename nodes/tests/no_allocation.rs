//! A step of the loop allocates nothing: counted, after a warm-up, for plant, estimator and controller together.

mod common;

use allocation_counter::measure;
use whirlstand_nodes::clock::Turn;
use whirlstand_nodes::config::{EstimatorKind, LawKind, SignalChange};
use whirlstand_nodes::inproc::Bench;

#[test]
fn steps_of_every_vehicle_law_and_filter_allocate_nothing() {
    for vehicle in whirlstand_vehicle::builtin_names() {
        for law in [LawKind::Lqr, LawKind::Ppc, LawKind::Smc, LawKind::Manual] {
            for kind in [EstimatorKind::Model, EstimatorKind::Kinematic] {
                let mut config = common::config("allocations", u64::MAX);
                let loaded = whirlstand_vehicle::Vehicle::builtin(vehicle).unwrap();
                let state = loaded.states[0].name.clone();
                config.plant.initial.clear();
                config.vehicle.text = loaded.source_text;
                config.controller.law = law;
                // Whether or not somebody outside may ask for changes.
                let is_open = kind == EstimatorKind::Model;
                (config.plant.inject, config.controller.pilot) = (is_open, is_open);
                config.estimator.kind = kind;
                // Also where the reference changes, and with it the steady state that the law holds.
                config.setpoint = (0..100)
                    .map(|i| SignalChange {
                        at_s: 10.0 + f64::from(i),
                        values: [(state.clone(), 0.01 * f64::from(i % 2))].into(),
                    })
                    .collect();
                let mut bench = Bench::open(&config).unwrap();
                for _ in 0..2000 {
                    bench.round().unwrap();
                }
                let counted = measure(|| {
                    for _ in 0..20_000 {
                        assert_ne!(bench.round().unwrap(), Turn::Ended);
                    }
                });
                assert_eq!(counted.count_total, 0, "{vehicle}, {law:?}, {kind:?}");
            }
        }
    }
}

/// Steps around a change of the law: the design is made elsewhere, and the step that changes allocates nothing.
#[test]
fn a_step_that_changes_the_law_allocates_nothing() {
    use whirlstand_bus::{Bus, BusConfig};
    use whirlstand_msgs::{Command, Finding, FindingStage, Head, Message, flags, text_field};
    use whirlstand_nodes::config::{MirrorConfig, OnFinding};

    let mut config = common::config("law-allocations", u64::MAX);
    // The mirror sees nothing wrong in this flight: its word comes from here.
    config.mirror = Some(MirrorConfig { on_finding: OnFinding::Law });
    let bus = Bus::open(&BusConfig::new(&config.bench, "word", config.transport)).unwrap();
    let (mut words, mut commands) =
        (bus.publisher::<Finding>().unwrap(), bus.subscriber::<Command>(4).unwrap());
    let mut bench = Bench::open(&config).unwrap();
    for _ in 0..2000 {
        bench.round().unwrap();
    }
    let mut last = || {
        let mut last = None;
        while let Some(command) = commands.try_recv().unwrap() {
            last = Some(command);
        }
        last
    };
    let step = last().expect("it flies").head.step;
    let mut word = Finding { number: 1, stage: FindingStage::Law as u32, count: 1, ..Finding::zeroed() };
    word.head = Head { seq: 0, step, stamp_ns: step * config.period_ns };
    (word.effect, word.place) = (text_field("input_delay"), text_field("u_roll"));
    (word.names, word.value[0]) = (text_field("delay_s"), 0.05);
    words.send(&word).unwrap();
    let (mut changed, mut all) = (false, 0);
    for _ in 0..4000 {
        let counted = measure(|| {
            bench.round().unwrap();
        });
        let now = last().is_some_and(|c| c.flags & flags::SUCCEEDED != 0);
        assert!(
            counted.count_total == 0 || now == changed,
            "{} allocations at the change",
            counted.count_total
        );
        all += counted.count_total;
        changed |= now;
    }
    assert!(changed, "the law has changed");
    // A lockstep loop waits for the design, for which the channel makes its waiting place, once.
    assert!(all <= 4, "{all} allocations around it");
}
