//! A step of the loop allocates nothing and writes no log line: counted, after a warm-up, for plant, estimator and controller
//! together, with somebody who takes log lines.

mod common;

use std::cell::Cell;
use std::fmt::{Debug, Write};
use std::sync::{Mutex, MutexGuard, PoisonError};

use allocation_counter::measure;
use tracing::field::{Field, Visit};
use whirlstand_nodes::clock::Turn;
use whirlstand_nodes::config::{EstimatorKind, LawKind, SignalChange};
use whirlstand_nodes::inproc::Bench;

/// Counts the lines that each thread writes, and keeps them. It takes every line, as the launcher's does.
struct Lines;

static WRITTEN: Mutex<String> = Mutex::new(String::new());

thread_local! {
    static OWN: Cell<usize> = const { Cell::new(0) };
}

fn written() -> MutexGuard<'static, String> {
    WRITTEN.lock().unwrap_or_else(PoisonError::into_inner)
}

impl tracing::Subscriber for Lines {
    fn enabled(&self, _: &tracing::Metadata<'_>) -> bool {
        true
    }
    fn new_span(&self, _: &tracing::span::Attributes<'_>) -> tracing::span::Id {
        tracing::span::Id::from_u64(1)
    }
    fn event(&self, event: &tracing::Event<'_>) {
        struct Text<'a>(&'a mut String);
        impl Visit for Text<'_> {
            fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
                write!(self.0, "{field}: {value:?}; ").unwrap();
            }
        }
        if !event.metadata().target().starts_with("whirlstand") {
            return;
        }
        OWN.set(OWN.get() + 1);
        event.record(&mut Text(&mut written()));
    }
    fn record(&self, _: &tracing::span::Id, _: &tracing::span::Record<'_>) {}
    fn record_follows_from(&self, _: &tracing::span::Id, _: &tracing::span::Id) {}
    fn enter(&self, _: &tracing::span::Id) {}
    fn exit(&self, _: &tracing::span::Id) {}
}

/// From here on log lines are counted.
fn take_lines() {
    // The other test may have done it.
    let _ = tracing::subscriber::set_global_default(Lines);
    OWN.set(0);
}

/// How many lines this thread wrote itself.
fn own_lines() -> usize {
    OWN.get()
}

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
                take_lines();
                let counted = measure(|| {
                    for _ in 0..20_000 {
                        assert_ne!(bench.round().unwrap(), Turn::Ended);
                    }
                });
                assert_eq!((counted.count_total, own_lines()), (0, 0), "{vehicle}, {law:?}, {kind:?}");
            }
        }
    }
}

/// Steps around a change of the law: the design is made elsewhere, and the step that changes allocates nothing and has another
/// thread say so.
#[test]
fn a_step_that_changes_the_law_allocates_nothing_and_writes_no_line() {
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
    take_lines();
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
    assert_eq!(own_lines(), 0, "a step wrote a line itself");
    // What was said is written when the bench is gone.
    drop(bench);
    let lines = written().clone();
    assert!(lines.contains("the law that the mirror asked for is active"), "{lines}");
}

/// What the loop has to say of a failsafe and of damaged messages, as well.
#[test]
fn a_step_that_goes_to_failsafe_writes_no_line() {
    use whirlstand_bus::{Bus, BusConfig};
    use whirlstand_msgs::{Finding, FindingStage, Message};
    use whirlstand_nodes::config::{MirrorConfig, OnFinding};

    let mut config = common::config("failsafe-lines", u64::MAX);
    config.mirror = Some(MirrorConfig { on_finding: OnFinding::Failsafe });
    let bus = Bus::open(&BusConfig::new(&config.bench, "word", config.transport)).unwrap();
    let mut words = bus.publisher::<Finding>().unwrap();
    let mut bench = Bench::open(&config).unwrap();
    let mut fly = || (0..1000).for_each(|_| assert_ne!(bench.round().unwrap(), Turn::Ended));
    fly();
    take_lines();
    for stage in [FindingStage::Wrong, FindingStage::Over] {
        words.send(&Finding { stage: stage as u32, ..Finding::zeroed() }).unwrap();
        fly();
    }
    assert_eq!(own_lines(), 0, "a step wrote a line itself");
    drop(bench);
    let lines = written().clone();
    for said in ["commands are withheld", "commands resume", "FAILSAFE, inputs at neutral", "failsafe ended"]
    {
        assert!(lines.contains(said), "{said} is not among: {lines}");
    }
}
