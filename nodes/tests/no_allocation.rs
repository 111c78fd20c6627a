//! A step of the loop allocates nothing: counted, after a warm-up, for plant, estimator and controller together.

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use whirlstand_nodes::clock::Turn;
use whirlstand_nodes::config::{EstimatorKind, LawKind, SignalChange};
use whirlstand_nodes::inproc::Bench;

struct Counting;

thread_local! {
    // Per thread, so that the test harness's own threads do not count.
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

// SAFETY: every call goes to the system allocator as it came; counting touches a plain thread-local number.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|n| n.set(n.get() + 1));
        // SAFETY: the caller's obligations are the system allocator's.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's obligations are the system allocator's.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        ALLOCATIONS.with(|n| n.set(n.get() + 1));
        // SAFETY: the caller's obligations are the system allocator's.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

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
                let before = ALLOCATIONS.with(Cell::get);
                for _ in 0..20_000 {
                    assert_ne!(bench.round().unwrap(), Turn::Ended);
                }
                let allocations = ALLOCATIONS.with(Cell::get) - before;
                assert_eq!(allocations, 0, "{vehicle}, {law:?}, {kind:?}");
            }
        }
    }
}
