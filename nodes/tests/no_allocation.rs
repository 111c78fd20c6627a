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
